"""`ztpm cell`: begun, drafted, checked, signed and shown; the signed file is the one that a gateway takes.

Nothing else is signed.
"""

import json
import time
import tomllib

import pytest
from capabilities.statements.observation import Box, Sphere
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Tier
from docs import generate
from pep.pit.files.world_file import checked
from typer.testing import CliRunner

from capabilities.keys import keys
from capabilities.statements import cell
from ztpm.cli import app

PASSPHRASE = "correct horse battery staple"
KEY = keys.generate()
SIGNER = keys.b64u(keys.public_raw(KEY))
DRAFT = """
name = "bench-3"
author = "alice"
audience = "http://127.0.0.1:8800/mcp"
tool = "robotiq_2f85"
payload_g = 250
sensors = ["camera-1", "camera-2"]

[workspace]
low_um = [-900_000, -900_000, -100_000]
high_um = [900_000, 900_000, 1_200_000]

[[objects]]
name = "table"
kind = "rigid"
shape = { form = "box", center_um = [0, 0, -60_000], half_um = [500_000, 500_000, 50_000] }

[[zones]]
name = "press"
shape = { form = "sphere", center_um = [0, 500_000, 200_000], radius_um = 100_000 }

[[zones]]
name = "store"
tier = 4
shape = { form = "sphere", center_um = [0, -500_000, 200_000], radius_um = 100_000 }

[[contacts]]
object = "table"
by = "tool"

[[contacts]]
object = "part-1"
by = "tool"
observed = true

[[outputs]]
number = 3
name = "lamp"
tier = 1
"""


def run(*arguments, passphrase=PASSPHRASE):
    result = CliRunner().invoke(app, ["cell", *map(str, arguments), "--json"], env={"ZTPM_PASSPHRASE": passphrase})
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


@pytest.fixture
def desk(tmp_path):
    key = tmp_path / "alice.key"
    key.write_bytes(keys.to_pem(KEY, PASSPHRASE.encode()))
    key.chmod(0o600)
    (tmp_path / "draft.toml").write_text(DRAFT)
    return tmp_path


def sign(desk, *options, **named):
    return run("sign", desk / "draft.toml", "--key", desk / "alice.key", "--out", desk / "cell.jws", *options, **named)


def test_what_is_signed_is_what_stands_in_the_draft(desk):
    status, said = sign(desk, "--days", "30")
    assert (status, said["ok"], said["signer_key"]) == (0, True, SIGNER)
    stated = cell.open((desk / "cell.jws").read_text().strip(), {keys.public_raw(KEY)}, CAPS)
    assert stated.not_after - stated.not_before == 30 * 86_400
    assert stated.not_before <= time.time() < stated.not_after
    assert (stated.author, stated.payload_g, stated.sensors) == ("alice", 250, ("camera-1", "camera-2"))
    assert stated.objects[0].shape == Box((0, 0, -60_000), (500_000, 500_000, 50_000), (1_000_000, 0, 0, 0))
    assert stated.zones[0] == cell.Zone("press", None, Sphere((0, 500_000, 200_000), 100_000))
    assert stated.zones[1].tier is Tier.SAFETY_CRITICAL
    assert stated.contacts == (cell.Contact("table", "tool", False), cell.Contact("part-1", "tool", True))
    assert stated.outputs == (cell.Output(3, "lamp", Tier.REVERSIBLE),)
    status, shown = run("show", desk / "cell.jws", "--signer", SIGNER)
    assert (status, shown["cell"]) == (0, json.loads(json.dumps(cell.to_claims(stated))))


def test_what_is_left_out_is_unknown_or_not_there(desk):
    kept = DRAFT.split("[workspace]")[0].replace("payload_g = 250\n", "")
    (desk / "draft.toml").write_text(kept)
    assert sign(desk)[0] == 0
    shown = run("show", desk / "cell.jws", "--signer", SIGNER)[1]["cell"]
    assert (shown["payload_g"], shown["workspace"], shown["objects"], shown["outputs"]) == (None, None, [], [])


BAD = {
    "not TOML": ("x = ", "DRAFT_MALFORMED"),
    "nested beyond every stack": ("x = " + "[" * 50_000, "DRAFT_MALFORMED"),
    "an unknown member": ("colour = 1\n" + DRAFT, "DRAFT_MALFORMED"),
    "a member is missing": (DRAFT.replace('author = "alice"\n', ""), "DRAFT_MALFORMED"),
    "its own end": ("not_after = 1\n" + DRAFT, "DRAFT_MALFORMED"),
    "a fraction": (DRAFT.replace("payload_g = 250", "payload_g = 250.5"), "DRAFT_MALFORMED"),
    "not a number": (DRAFT.replace("payload_g = 250", "payload_g = nan"), "DRAFT_MALFORMED"),
    "a date": (DRAFT.replace("payload_g = 250", "payload_g = 1979-05-27"), "DRAFT_MALFORMED"),
    "no list": (DRAFT.split("[workspace]")[0] + "zones = 3\n", "DRAFT_MALFORMED"),
    "no table": (DRAFT.split("[workspace]")[0] + "zones = [3]\n", "DRAFT_MALFORMED"),
    "no sensor": (DRAFT.replace('["camera-1", "camera-2"]', "[]"), "DRAFT_MALFORMED"),
    "a name twice": (DRAFT.replace('"store"', '"press"'), "DRAFT_MALFORMED"),
    "a tier that is none": (DRAFT.replace("tier = 4", "tier = 5"), "DRAFT_MALFORMED"),
    "a contact with nothing": (DRAFT.replace('object = "table"', 'object = "chair"'), "CONTACT_WITH_NOTHING"),
    "a workspace beside the base": (DRAFT.replace("[-900_000, -900_000, -100_000]", "[100_000, 100_000, 100_000]"), "BASE_OUTSIDE_WORKSPACE"),
    "a zone out of reach": (DRAFT.replace("500_000, 200_000", "50_000_000, 200_000"), "OUT_OF_REACH"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_draft_is_not_signed(desk, name):
    text, code = BAD[name]
    (desk / "draft.toml").write_text(text)
    status, said = sign(desk)
    assert (status, said["code"]) == (2, code)
    assert not (desk / "cell.jws").exists()


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("tier = 4", "tier = 5", "cell.zones.1.tier: 'store': "),
        ('kind = "rigid"', 'colour = "red"', "cell.objects.0.colour: 'table': "),
        ("[[contacts]]\nobject", "[contacts]\nobject", "not TOML: "),
    ],
)
def test_a_fault_of_a_draft_names_the_object(desk, old, new, named):
    (desk / "draft.toml").write_text(DRAFT.replace(old, new, 1))
    assert f"{desk}/draft.toml: {named}" in sign(desk)[1]["detail"]


def test_nothing_is_signed_with_a_key_that_cannot_be_had(desk):
    status, said = sign(desk, passphrase="another one altogether")
    assert (status, said["code"]) == (2, "PASSPHRASE_WRONG")
    (desk / "alice.key").chmod(0o644)
    assert sign(desk)[0] == 2
    (desk / "alice.key").unlink()
    assert sign(desk)[0] == 2
    assert not (desk / "cell.jws").exists()


def test_a_cell_file_that_exists_is_left_as_it_is(desk):
    (desk / "cell.jws").write_text("mine")
    assert (sign(desk)[0], sign(desk)[1]["code"]) == (2, "EXISTS")
    assert (desk / "cell.jws").read_text() == "mine"


@pytest.mark.parametrize(
    ("change", "status", "code"),
    [
        (lambda signed: signed[:-5] + b"AAAA\n", 3, "STATEMENT_UNTRUSTED"),
        (lambda signed: b"hello", 3, "STATEMENT_MALFORMED"),
        (lambda signed: "\u00e4".encode(), 3, "STATEMENT_MALFORMED"),
        (lambda signed: b"\xe4", 2, "UNREADABLE"),
    ],
)
def test_a_file_that_does_not_verify_is_not_shown(desk, change, status, code):
    sign(desk)
    (desk / "cell.jws").write_bytes(change((desk / "cell.jws").read_bytes()))
    ended, said = run("show", desk / "cell.jws", "--signer", SIGNER)
    assert (ended, said["code"], "cell" in said) == (status, code, False)


def test_neither_by_another_key_nor_out_of_force(desk):
    sign(desk)
    other = keys.b64u(keys.public_raw(keys.generate()))
    assert run("show", desk / "cell.jws", "--signer", other)[1]["code"] == "STATEMENT_UNTRUSTED"
    assert run("show", desk / "cell.jws", "--signer", "AAAA")[0] == 2
    stated = cell.open((desk / "cell.jws").read_text().strip(), {keys.public_raw(KEY)}, CAPS)
    from msgspec.structs import replace

    (desk / "old.jws").write_text(cell.sign(replace(stated, not_before=0, not_after=86_400), KEY))
    ended, said = run("show", desk / "old.jws", "--signer", SIGNER)
    assert (ended, said["code"]) == (3, "EXPIRED")


# ---- begun, drafted, checked


EXAMPLES = generate.SCHEMAS.parent / "examples"


def said(*arguments):
    """Exit status, standard output and standard error of a command without --json."""
    result = CliRunner().invoke(app, ["cell", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.parametrize("robot", ["ur3e", "ur5e", "ur10e", "ur16e"])
def test_a_new_draft_is_without_fault_for_its_robot(desk, robot):
    assert said("new", "--robot", robot, "--tool", "robotiq_hande", "--out", desk / "new.toml")[0] == 0
    found = checked(tomllib.loads((desk / "new.toml").read_text()))
    assert (found.faults, found.remarks, found.situation.robot) == ((), (), robot)
    assert run("check", desk / "new.toml") == (
        0,
        {"ok": True, "use": "draft of a cell file", "faults": [], "warnings": []},
    )


def test_a_new_draft_is_not_written_over_a_file_nor_for_an_arm_that_is_none(desk):
    assert said("new", "--out", desk / "draft.toml")[0] == 2
    assert (desk / "draft.toml").read_text() == DRAFT
    assert said("new", "--robot", "ur4e")[0] == 2
    assert said("new", "--tool", "claw")[0] == 2
    assert said("new")[1].startswith("#")


def test_what_is_seen_becomes_a_draft(desk):
    status, text, beside = said("draft", EXAMPLES / "convex.scene.json")
    value = tomllib.loads(text)
    assert status == 0
    assert [each["name"] for each in value["cell"]["objects"]] == ["table", "ramp", "gem"]
    assert "(1)" in beside
    assert checked(value).faults == ()
    scene = desk / "scene.json"
    shape = {"type": "sphere", "center_m": [0.4, 0.4, 0.1], "radius_m": 0.05}
    scene.write_text(json.dumps({"objects": [{"id": "cup", "kind": "fragile", "shape": shape}]}))
    added = tomllib.loads(said("draft", scene, "--cell", desk / "draft.toml")[1])
    assert [each["name"] for each in added["cell"]["objects"]] == ["table", "cup"]
    assert (added["cell"]["name"], added["cell"]["payload_kg"]) == ("bench-3", 0.25)
    assert said("draft", desk / "draft.toml")[0] == 2, "nothing is seen there"


def test_a_check_tells_every_fault_with_a_code_and_every_warning(desk):
    bad = (
        DRAFT.replace('kind = "rigid"', 'kind = "rigd"').replace("tier = 4", "tier = 9").replace("payload_g", "payload")
    )
    (desk / "draft.toml").write_text(bad)
    status, told = run("check", desk / "draft.toml")
    assert (status, told["ok"], told["code"]) == (2, False, "DRAFT_MALFORMED")
    assert [each["place"] for each in told["faults"]] == ["cell.objects.0.kind", "cell.zones.1.tier", "cell.payload"]
    assert all(each["next"] for each in told["faults"])
    (desk / "draft.toml").write_text(DRAFT.replace("[0, 500_000, 200_000]", "[0, 1_500_000, 200_000]"))
    status, told = run("check", desk / "draft.toml")
    assert (status, [(each["code"], each["name"]) for each in told["warnings"]]) == (
        0,
        [("ZONE_OUTSIDE_WORKSPACE", "press")],
    )
    assert run("check", desk / "draft.toml", "--strict")[0] == 1
    assert "ZONE_OUTSIDE_WORKSPACE" in said("check", desk / "draft.toml")[1]


def test_a_name_that_deceives_is_shown_by_its_letters(desk):
    (desk / "draft.toml").write_text(DRAFT.replace('name = "press"', 'name = "pr\u0435ss\u202e"'))
    status, _, beside = said("check", desk / "draft.toml")
    assert status == 2
    assert "U+0435" in beside
    assert "\u202e" not in beside


def test_scenes_are_checked_as_scenes(desk):
    for file in sorted(EXAMPLES.glob("*.scene.json")):
        assert run("check", file) == (0, {"ok": True, "use": "scene of a question", "faults": [], "warnings": []})
    scene = json.loads((EXAMPLES / "c1-glass.scene.json").read_text())
    scene["view"]["objects"][0]["id"] = "table"
    (desk / "scene.json").write_text(json.dumps(scene))
    status, told = run("check", desk / "scene.json")
    assert (status, told["use"], told["faults"][0]["place"]) == (2, "scene of a question", "scene.view.objects.0")


# ---- shown


def test_what_is_shown_is_what_is_signed_again(desk):
    sign(desk)
    status, text, beside = said("show", desk / "cell.jws", "--signer", SIGNER)
    assert (status, "alice" in beside) == (0, True)
    (desk / "again.toml").write_text(text)
    assert said("show", desk / "again.toml")[1] == text
    assert run("sign", desk / "again.toml", "--key", desk / "alice.key", "--out", desk / "again.jws")[0] == 0
    assert said("show", desk / "again.jws", "--signer", SIGNER)[1] == text
    assert said("show", desk / "draft.toml")[1] == text, "an old draft is shown in the words of today"
    value = run("show", desk / "cell.jws", "--signer", SIGNER)[1]["file"]
    (desk / "again.json").write_text(json.dumps(value))
    assert said("show", desk / "again.json")[1] == text


def test_a_robot_is_shown_of_a_draft_and_is_not_signed(desk):
    new = said("new", "--robot", "ur5e")[1].replace('"alice"', '"carol"')
    (desk / "new.toml").write_text(new)
    assert 'robot = "ur5e"' in said("show", desk / "new.toml")[1]
    assert run("sign", desk / "new.toml", "--key", desk / "alice.key", "--out", desk / "new.jws")[0] == 0
    assert "robot =" not in said("show", desk / "new.jws", "--signer", SIGNER)[1]


def test_a_cell_is_drawn_without_a_motion(desk):
    sign(desk)
    for source, more in ((desk / "draft.toml", ()), (desk / "cell.jws", ("--signer", SIGNER))):
        assert said("show", source, *more, "--picture", desk / "cell.html")[0] == 0
        text = (desk / "cell.html").read_text()
        assert all(name in text for name in ("bench-3", "press", "store", "table"))
        (desk / "cell.html").unlink()
    assert said("show", EXAMPLES / "c2-person.scene.json", "--robot", "ur10e", "--picture", desk / "scene.html")[0] == 0
    assert "anna" in (desk / "scene.html").read_text()
    assert said("show", desk / "draft.toml", "--picture", desk / "cell.gif")[0] == 2
    assert said("show", desk / "draft.toml", "--picture", desk / "no" / "cell.html")[0] == 2
    assert said("show", desk / "draft.toml", "--robot", "ur4e", "--picture", desk / "cell.html")[0] == 2


def test_a_scene_is_not_signed(desk):
    scene = EXAMPLES / "c1-glass.scene.json"
    status, told = run("sign", scene, "--key", desk / "alice.key", "--out", desk / "cell.jws")
    assert (status, told["code"]) == (2, "DRAFT_MALFORMED")
    assert "view" in {each["place"] for each in told["faults"]}
    assert not (desk / "cell.jws").exists()
