"""`ztpm cell sign` and `ztpm cell show`: the signed file is the one that a tool server takes.

Nothing else is signed.
"""

import json
import time

import pytest
from capabilities.statements.observation import Box, Sphere
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Tier
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
        ("tier = 4", "tier = 5", "'store' in zones[1].tier: "),
        ('kind = "rigid"', 'colour = "red"', "'table' in objects[0]"),
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
