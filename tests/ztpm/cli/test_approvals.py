"""`ztpm approvals`: the shown text is the bound one, and every end has its status and code."""

import json
from types import SimpleNamespace

import pytest
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity, Unit
from tests.capabilities.statements.people.test_pictures import SHOWN as SHOWN_PICTURE
from ztpm.base.layout import new_key

from capabilities.keys import keys
from capabilities.statements.people import ask, picture
from ztpm_idp.client import ClientError, person_answers

pytestmark = pytest.mark.long

ID, DIGEST = "0123456789abcdef" * 2, "ab" * 32
SHOWN = {
    "ask_id": ID,
    "nonce": "1" * 32,
    "pep": "cell-1",
    "audience": "http://127.77.0.9:8800/mcp",
    "issuer": "http://127.77.0.9:8700/ztpm",
    "sponsor": "alice",
    "token_id": "A" * 22,
    "agent": "mover",
    "agent_key": "k" * 43,
    "object": "ur3e",
    "operation": "move_joint",
    "values": [{"name": "q0", "unit": "urad", "value": -600_000}],
    "request_digest": "11" * 32,
    "start_urad": [1, 2, 3, 4, 5, 6],
    "model_digest": "22" * 32,
    "policy_digest": "33" * 32,
    "scene_digest": "44" * 32,
    "tier": 3,
    "index_milli": 2_345,
    "reasons": ["TIER_NEEDS_APPROVAL"],
    "contributors": [
        {
            "kind": "person",
            "link": "wrist_3",
            "object": "p1",
            "index_milli": 2_345,
            "clearance_um": 312_000,
            "speed_um_s": 240_000,
            "source": "camera-1",
        }
    ],
    "perception": "fresh",
    "perception_age_ms": 40,
    "approvers": 1,
    "opening_id": "",
    "asked_at": 1_700_000_000,
    "expires_at": 1_700_000_060,
    "mandate_id": "",
    "facts": [],
    "picture_digest": "55" * 32,
}
ASKED = {"ask": "text", "shown": SHOWN, "ask_digest": DIGEST, "state": "open", "votes": [], "expires_at": 1_700_000_060}


def test_the_double_shows_an_ask_of_the_real_form():
    """The double of the commands has every member of a signed ask, and no other."""
    assert tuple(SHOWN) == ask.NAMES
    stated = {**SHOWN, "tier": Tier(3), "values": (Quantity("q0", Unit.MICRORADIAN, -600_000),)}
    stated["contributors"] = tuple(ask.Contributor(**c) for c in SHOWN["contributors"])
    stated["facts"] = tuple(SHOWN["facts"])
    stated["start_urad"], stated["reasons"] = tuple(SHOWN["start_urad"]), tuple(SHOWN["reasons"])
    assert str(Unit.MICRORADIAN) == SHOWN["values"][0]["unit"]
    ask.sign(ask.Ask(**stated), keys.generate())


PICTURE = picture.write(SHOWN_PICTURE)


@pytest.mark.clause("PSK-8")
def test_show_tells_the_sentence_and_code_of_the_page_and_draws_the_motion(run, who, double, tmp_path):
    double.answers = {"approval": ASKED, "picture": PICTURE}
    file = tmp_path / "ask.html"
    told = run("approvals", "show", ID, *who, "--picture", str(file))
    assert told.status == 0, told.err
    assert "The wrist passes p1 at 312 mm, 0.24 m/s." in told.out
    assert DIGEST[:8] in told.out
    html = file.read_text()
    assert "The wrist passes p1 at 312 mm" in html
    assert json.loads(html.split('id="picture">')[1].split("</script>")[0]) == json.loads(PICTURE)
    assert run("approvals", "show", ID, *who, "--json").json["code"] == DIGEST[:8]


@pytest.mark.parametrize(
    ("answer", "place", "code"),
    [
        ("", "ask.html", "NO_PICTURE"),
        (PICTURE, "none/ask.html", "UNWRITABLE"),
        (ClientError("ASK_PICTURE_DIFFERS", 200), "ask.html", "ASK_PICTURE_DIFFERS"),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_told(run, who, double, tmp_path, answer, place, code):
    double.answers = {"approval": ASKED, "picture": answer}
    told = run("approvals", "show", ID, *who, "--picture", str(tmp_path / place))
    assert told.status != 0
    assert code in told.err
    assert list(tmp_path.glob("**/*.html")) == []


def test_only_the_picture_that_the_ask_names_is_taken():
    stated = {**SHOWN, "picture_digest": picture.digest_of(PICTURE)}
    named = person_answers.ShownAsk(SimpleNamespace(**stated), DIGEST)
    assert person_answers.pictured(named, PICTURE) == PICTURE
    for text in (PICTURE + " ", "", "{}"):
        with pytest.raises(ClientError) as raised:
            person_answers.pictured(named, text)
        assert raised.value.code == "ASK_PICTURE_DIFFERS"
    odd = person_answers.ShownAsk(SimpleNamespace(**{**stated, "picture_digest": picture.digest_of("{}")}), DIGEST)
    with pytest.raises(ClientError) as raised:
        person_answers.pictured(odd, "{}")
    assert raised.value.code == "ANSWER_MALFORMED"


@pytest.fixture
def who(cell):
    return ("--data", cell.root, "--as", "bob")


COMMANDS = {
    "list": (["list"], "approvals", []),
    "show": (["show", ID], "approval", ASKED),
    "approve": (["approve", ID, "--yes"], "approve", {"ask_id": ID, "state": "granted"}),
    "deny": (["deny", ID], "deny", {"ask_id": ID, "state": "denied"}),
    "withdraw": (["withdraw", ID], "withdraw", {"ask_id": ID, "state": "withdrawn"}),
    "open": (["open", "--agent", "mover", "--operation", "move_joint"], "open_tier_4", "f" * 32),
    "openings": (["openings"], "openings", []),
    "close": (["close", ID, "--reason", "done"], "close_opening", None),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_help(run, command):
    told = run("approvals", command, "--help")
    assert told.status == 0
    assert "--as" in told.out and "--json" in told.out


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("flags", [(), ("--json",)])
def test_done(run, who, double, command, flags):
    arguments, method, answer = COMMANDS[command]
    double.answers = {"approval": ASKED, method: answer}
    told = run("approvals", *arguments, *who, *flags)
    assert told.status == 0, told.err
    assert double.asked[-1][0] == method
    if flags:
        assert told.json["ok"] is True


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("error", "status"),
    [
        (ClientError("ASK_UNKNOWN", 404), 3),
        (ClientError("NOT_PERMITTED", 403, "an agent approves nothing"), 3),
        (ClientError("ASK_ANSWERED", 409), 3),
        (ClientError("CALLER_UNKNOWN", 401), 3),
        (ClientError("UNREACHABLE", 0, "ConnectError"), 1),
        (ClientError("STORE_UNAVAILABLE", 503), 1),
        (ClientError("ANSWER_MALFORMED", 200), 1),
    ],
)
def test_refused(run, who, double, command, error, status):
    arguments, method, _ = COMMANDS[command]
    double.answers = {"approval": ASKED, method: error}
    told = run("approvals", *arguments, *who)
    assert (told.status, told.err.partition(":")[0]) == (status, error.code)
    told = run("approvals", *arguments, *who, "--json")
    assert (told.status, told.json["ok"], told.json["code"]) == (status, False, error.code)


@pytest.mark.parametrize("command", COMMANDS)
def test_usage(run, who, cell, tmp_path, monkeypatch, double, command):
    arguments, *_ = COMMANDS[command]

    def code(*options):
        told = run("approvals", *arguments, *options, "--json")
        assert told.status == 2
        return told.json["code"]

    assert code("--data", cell.root, "--as", "mallory") == "OPERATOR_UNKNOWN"
    assert code("--data", cell.root, "--as", "../cell/pep") == "NAME_MALFORMED"
    assert code("--data", tmp_path, "--as", "bob") == "NOT_A_CELL"
    key = cell.operator_key("bob")
    assert code("--as", "bob", "--key", key) == "WHICH_KEY"
    remote = ("--as", "bob", "--issuer", "http://127.0.0.1:1/ztpm", *["--audience", "x"] * (command == "open"))
    assert code(*remote) == "WHICH_KEY"
    assert code("--data", cell.root, *remote, "--key", key) == "WHICH_KEY"
    readable = tmp_path / "bob.key"
    readable.write_bytes(key.read_bytes())
    readable.chmod(0o644)
    assert code(*remote, "--key", readable) == "KEYS_UNREADABLE"
    monkeypatch.setenv("ZTPM_PASSPHRASE", "not the passphrase")
    assert code("--data", cell.root, "--as", "bob") == "PASSPHRASE_WRONG"
    monkeypatch.delenv("ZTPM_PASSPHRASE")
    assert code("--data", cell.root, "--as", "bob") == "PASSPHRASE_MISSING"
    assert run("approvals", *arguments).status == 2  # nobody is named
    assert double.asked == []


@pytest.mark.parametrize("command", ["show", "approve", "deny", "withdraw", "close"])
def test_ids_are_checked_before_anything_is_opened(run, who, double, command):
    arguments = [a if a != ID else "../" + ID for a in COMMANDS[command][0]]
    told = run("approvals", *arguments, *who, "--json")
    assert (told.status, told.json["code"], double.asked) == (2, "ID_MALFORMED", [])


def test_show_shows_every_member_that_the_vote_binds(run, who, double):
    double.answers = {"approval": ASKED}
    told = run("approvals", "show", ID, *who)
    for member in SHOWN:
        assert member in told.out
    for shown in (
        "mover",
        "move_joint",
        "q0 = -600000 urad",
        "2.345",
        "312 mm",
        "240 mm/s",
        "camera-1",
        "TIER_NEEDS_APPROVAL",
        DIGEST,
        "11" * 32,
    ):
        assert shown in told.out
    assert run("approvals", "show", ID, *who, "--json").json["shown"] == SHOWN


def test_facts_of_sensors_are_shown_with_state_and_age(run, who, double):
    facts = (
        ask.AskedFact("zone-a/people", "fresh", Unit.COUNT, 3, 120, True),
        ask.AskedFact("tank/level", "missing", Unit.PERMILLE, None, None, False),
    )
    shown = SHOWN | {"facts": [person_answers._plain(fact) for fact in facts]}
    double.answers = {"approval": ASKED | {"shown": shown}}
    told = run("approvals", "show", ID, *who)
    assert "zone-a/people = 3 count, fresh, 120 ms old, raises the tier" in told.out
    assert "tank/level = unknown, missing" in told.out
    assert run("approvals", "show", ID, *who, "--json").json["shown"]["facts"][0]["unit"] == "count"


def test_what_an_agent_wrote_does_not_speak_to_the_terminal(run, who, double):
    double.answers = {"approval": {**ASKED, "shown": {**SHOWN, "agent": "mover\x1b[2J[red]x[/]"}}}
    out = run("approvals", "show", ID, *who).out
    assert "\x1b" not in out and "[red]x[/]" in out


def test_names_that_look_alike_are_shown_apart(run, who, double):
    names = ["mover", "m\u043ever", "mover\u3164", "mover\ufe0f"]
    rows = [{"ask_id": ID, "agent": name, "object": "ur3e", "operation": "open"} for name in names]
    double.answers = {"approvals": rows}
    told = run("approvals", "list", *who).out
    assert "m⟨U+043E⟩ver" in told and "mover⟨U+3164⟩" in told and "mover⟨U+FE0F⟩" in told
    double.answers = {"approval": {**ASKED, "shown": {**SHOWN, "agent": names[1]}}}
    assert "m⟨U+043E⟩ver" in run("approvals", "show", ID, *who).out


def test_words_are_shown_in_quotes_and_letter_by_letter(run, who, double):
    values = [
        {"name": "query", "kind": "text", "value": "a\" = 1 urad"}, {"name": "tags", "kind": "[text]", "value": ["p\u0430y"]},
        {"name": "bleed", "kind": "flag", "value": True},
    ]  # fmt: skip
    double.answers = {"approval": {**ASKED, "shown": {**SHOWN, "values": values}}}
    out = run("approvals", "show", ID, *who).out
    for shown in (r'query = "a\" = 1 urad" text', r'tags = ["p\u0430y"] [text]', "bleed = true flag"):
        assert shown in out


def test_approve_shows_asks_and_binds_what_was_shown(run, who, double):
    double.answers = {"approval": ASKED, "approve": {"state": "granted"}}
    told = run(
        "approvals", "approve", ID, *who, "--uses", 2, "--minutes", 1, "--seconds", 30, "--sees-clear", answer="y\n"
    )
    assert told.status == 0
    assert DIGEST in told.out
    assert double.asked == [
        ("approval", (ID,), {}),
        ("approve", (ID,), {"uses": 2, "lifetime_s": 90, "sees_clear": True, "shown": DIGEST}),
    ]


@pytest.mark.parametrize("answer", ["n\n", "\n"])
def test_what_is_not_confirmed_is_not_signed(run, who, double, answer):
    double.answers = {"approval": ASKED}
    told = run("approvals", "approve", ID, *who, answer=answer)
    assert (told.status, [name for name, *_ in double.asked]) == (1, ["approval"])
    assert "NOT_CONFIRMED" in told.err
    told = run("approvals", "approve", ID, *who, "--json")
    assert (told.status, told.json["code"]) == (2, "USAGE")


def test_defaults_are_those_of_the_design(run, who, double):
    double.answers = {"approval": ASKED, "approve": {"state": "granted"}, "open_tier_4": "f" * 32}
    run("approvals", "approve", ID, *who, "--yes")
    assert double.asked[-1][2] == {"uses": 1, "lifetime_s": 120, "sees_clear": False, "shown": DIGEST}
    run("approvals", "open", "--agent", "mover", "--operation", "move_joint", *who)
    assert double.asked[-1][2] == {
        "audience": "http://127.77.0.9:8800/mcp", "agent": "mover", "object": "ur3e", "operation": "move_joint", "uses": 1,
        "lifetime_s": 600, "reason": "",
    }  # fmt: skip


def test_one_of_two_is_status_4(run, who, double):
    double.answers = {"approval": ASKED, "approve": {"ask_id": ID, "state": "open"}}
    assert run("approvals", "approve", ID, *who, "--yes").status == 4
    told = run("approvals", "approve", ID, *who, "--yes", "--json")
    assert (told.status, told.json["state"]) == (4, "open")


@pytest.mark.parametrize(
    "options", [("--uses", 0), ("--uses", 101), ("--minutes", 61), ("--seconds", 3601), ("--uses", "nan")]
)
def test_bounds_of_options(run, who, double, options):
    assert run("approvals", "approve", ID, *who, "--yes", *options).status == 2
    assert double.asked == []


def test_an_hour_is_the_longest(run, who, double):
    told = run("approvals", "approve", ID, *who, "--yes", "--minutes", 60, "--seconds", 1, "--json")
    assert (told.status, told.json["code"], double.asked) == (2, "TOO_LONG", [])


def test_a_key_of_ones_own(run, double, tmp_path):
    key = new_key(tmp_path / "dave.key", b"a passphrase for tests")
    double.answers = {"approvals": [SHOWN | {"votes": 0, "state": "open"}]}
    issuer = "http://127.0.0.1:8700/ztpm"
    told = run("approvals", "list", "--as", "dave", "--issuer", issuer, "--key", tmp_path / "dave.key")
    assert (told.status, double.id, double.issuer) == (0, "dave", issuer)
    assert keys.public_raw(double.key) == keys.public_raw(key)
    assert ID in told.out and "2.345" in told.out
