"""The cell's configuration is read strictly, and refused by the name of what is wrong with it."""

import asyncio
import itertools
import json
import subprocess
import sys
import time
from dataclasses import replace

import httpx2
import pytest
from capabilities.values.scope import Tier
from msgspec import structs
from pep.base.errors import ConfigError, PepFault
from pep.pit.robot.calibration import own_kinematics
from pep.rtde.robot.state_receiver import JointState
from tests.pep.rtde.packages import package
from tests.pep.kit import AUDIENCE, issuer_keys, survey
from tests.pep.pit.robot.test_calibration import ARMS, spelled
from typer.testing import CliRunner
from ztpm.point.cell_config import read_cell, read_key, read_policies, read_robot, read_trust
from ztpm.point.gateway_config import GatewayConfig, read_gateway_config

from capabilities.keys import keys
from capabilities.statements import cell, checkpoint, observation
from pep.pit import (
    CALIBRATED_UNCERTAINTY_M,
    NOMINAL_UNCERTAINTY_M,
    Calibration,
    CellParameters,
    MoveJ,
    Robot,
    Sphere,
    StaticZone,
    SurveyError,
    SurveyFault,
    assess,
    surveyed,
)
from ztpm.cli import app as cli
from ztpm.point import cell_config, gateway_server, robot_point

pytestmark = pytest.mark.long

SURVEYOR = keys.generate()
SIGNER = keys.b64u(keys.public_raw(SURVEYOR))
GOOD = {
    "audience": '"http://127.0.0.1:8800/mcp"',
    "host": '"127.0.0.1"',
    "port": "8800",
    "pep_id": '"cell-1"',
    "issuer": '"http://127.0.0.1:8898/ztpm"',
    "trust_file": '"/nonexistent/trust.json"',
    "pep_key_file": '"/nonexistent/pep.key"',
    "journal_file": '"/nonexistent/journal"',
    "state_dir": '"/nonexistent"',
    "robot_host": '"127.0.0.1"',
    "perception_port": "8801",
    "policy": '"paper-default"',
    "defer_timeout_s": "60",
    "cell_file": '"/nonexistent/cell.jws"',
    "cell_signer_key": f'"{SIGNER}"',
    "url": '"http://127.0.0.1:8802/leases"',
    "calls_url": '"http://127.0.0.1:8802/calls"',
    "listen_host": '"127.0.0.2"',
    "carriage_port": "8803",
}


def toml(cell="", **changes):
    rows = {**GOOD, **changes}
    return "\n".join(f"{k} = {v}" for k, v in rows.items() if v is not None) + f"\n[cell]\n{cell}\n"


def refused(text, key):
    with pytest.raises(ConfigError) as raised:
        GatewayConfig.from_toml(text)
    assert raised.value.code is PepFault.CONFIG_INVALID
    assert raised.value.detail.startswith(key)


def test_the_good_one():
    config = GatewayConfig.from_toml(toml())
    assert (config.port, config.policy, config.cell.stop_deceleration_rad_s2) == (8800, "paper-default", 8.0)


@pytest.mark.parametrize("key", GOOD)
def test_nothing_may_be_missing_or_of_another_type(key):
    refused(toml(**{key: None}), key)
    refused(toml(**{key: "[]"}), key)
    refused(toml(**{key: "true"}), key)
    refused(toml(**{key: '""'}), key)


BAD = {
    "unknown": (toml() + "\n[extra]\nx = 1\n", "extra"),
    "no_cell": ("\n".join(f"{k} = {v}" for k, v in GOOD.items()), "cell"),
    "not_toml": ("audience = ", "not TOML"),
    "twice": (f"port = 1\n{toml()}", "not TOML"),
    "remote_http_audience": (toml(audience='"http://robot.example/mcp"'), "audience"),
    "remote_http_issuer": (toml(issuer='"http://idp.example/ztpm"'), "issuer"),
    "no_path": (toml(issuer='"http://127.0.0.1:8898"'), "issuer"),
    "ftp": (toml(audience='"ftp://127.0.0.1/mcp"'), "audience"),
    "query": (toml(audience='"http://127.0.0.1:8800/mcp?x=1"'), "audience"),
    "listens_everywhere": (toml(host='"0.0.0.0"'), "host"),
    "leases_at_the_stop": (toml(url='"http://127.0.0.1:8802/stop"'), "url"),
    "calls_at_the_stop": (toml(calls_url='"http://127.0.0.1:8802/stop"'), "url"),
    "port_zero": (toml(port="0"), "port"),
    "port_large": (toml(port="65536"), "port"),
    "timeout_zero": (toml(defer_timeout_s="0"), "defer_timeout_s"),
    "cell_key": (toml(cell="gravity = 1.0"), "cell"),
    "cell_nan": (toml(cell="stop_deceleration_rad_s2 = nan"), "cell"),
    "cell_too_hard": (toml(cell="stop_deceleration_rad_s2 = 41.0"), "cell"),
    "cell_zero": (toml(cell="stop_deceleration_rad_s2 = 0.0"), "cell"),
    "cell_tool": (toml(cell='tool = "none"'), "cell: tool"),
    "cell_payload": (toml(cell="payload_kg = 0.0"), "cell: payload_kg"),
    "cell_objects": (toml(cell="objects = []"), "cell: objects"),
    "cell_zones": (toml(cell="zones = []"), "cell: zones"),
    "cell_contacts": (toml(cell="contacts = []"), "cell: contacts"),
    "cell_workspace": (toml(cell="[cell.workspace]\nlow_m = [-1, -1, -1]\nhigh_m = [1, 1, 1]"), "cell: workspace"),
    "calibration_empty": (toml(calibration_file='""'), "calibration_file"),
    "calibration_no_text": (toml(calibration_file="1"), "calibration_file"),
    "signer_no_key": (toml(cell_signer_key='"AAAA"'), "cell_signer_key"),
    "signer_not_base64url": (toml(cell_signer_key=f'"{SIGNER}="'), "cell_signer_key"),
    "signer_of_small_order": (toml(cell_signer_key=f'"{keys.b64u(bytes(32))}"'), "cell_signer_key"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_ones(name):
    refused(*BAD[name])


@pytest.fixture
def files(tmp_path, monkeypatch):
    _, trust = issuer_keys()
    (tmp_path / "trust.json").write_bytes(trust.to_json())
    key_file = tmp_path / "pep.key"
    key_file.write_bytes(keys.to_pem(keys.generate(), b"secret words"))
    key_file.chmod(0o600)
    monkeypatch.setenv("ZTPM_PASSPHRASE", "secret words")
    config = GatewayConfig.from_toml(
        toml(trust_file=f'"{tmp_path}/trust.json"', pep_key_file=f'"{key_file}"', issuer=f'"{trust.issuer}"')
    )
    return config, key_file


def test_key_and_trust_are_read(files):
    config, _ = files
    assert read_trust(config).issuer == config.issuer
    read_key(config)
    assert read_policies(config).name == "paper-default"


def test_a_key_that_others_can_read(files):
    config, key_file = files
    key_file.chmod(0o640)
    with pytest.raises(ConfigError):
        read_key(config)


@pytest.mark.parametrize("passphrase", ["", "wrong"])
def test_a_wrong_or_missing_passphrase(files, monkeypatch, passphrase):
    monkeypatch.setenv("ZTPM_PASSPHRASE", passphrase)
    with pytest.raises(ConfigError):
        read_key(files[0])


def test_trust_of_another_issuer(files):
    config, _ = files
    object.__setattr__(config, "issuer", "http://127.0.0.1:1/other")
    with pytest.raises(ConfigError):
        read_trust(config)


def test_a_missing_file_or_policy(files, tmp_path):
    with pytest.raises(ConfigError):
        read_gateway_config(tmp_path / "none.toml")
    object.__setattr__(files[0], "policy", str(tmp_path / "none.toml"))
    with pytest.raises(ConfigError):
        read_policies(files[0])


def test_the_process_says_what_is_wrong_and_ends(tmp_path):
    path = tmp_path / "gateway.toml"
    path.write_text(toml(port="0"))
    ended = subprocess.run(
        [sys.executable, "-m", "ztpm.point.gateway_server", "--config", str(path)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith(f"CONFIG_INVALID: {path}: port") and ended.stderr.count("\n") == 1


def test_loopback():
    assert [cell_config.is_loopback(h) for h in ("127.3.2.1", "::1", "localhost", "10.0.0.1", "0.0.0.0", "x")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip


def test_every_stop_is_as_hard_as_the_cell_says(files, tmp_path, monkeypatch):
    config, _ = files
    object.__setattr__(config, "cell", CellParameters(stop_deceleration_rad_s2=5.0))
    object.__setattr__(config, "journal_file", tmp_path / "journal.ndjson")
    object.__setattr__(config, "state_dir", tmp_path)
    sent, equipped = [], []

    class Arm:
        def __init__(self, host, clock):
            assert host == config.robot_host
            self.told = None

        def read(self):
            return JointState((0.0,) * 6, (0.0,) * 6, 7, 1)

        def newest(self):
            return package(self.read(), stamp_s=next(stamps))

    class Lines:
        """Tools' words to the arm."""

        up = True

        def __init__(self, ports, *, fitted, **_):
            assert ports.deceleration == 5.0
            equipped.append(fitted())
            self.deceleration = ports.deceleration

        def stop(self):
            sent.append(self.deceleration)

        def switch(self, command):
            return False

        def end(self):
            pass

    stamps = itertools.count(1.0)
    monkeypatch.setattr(gateway_server, "OwnLines", Lines)
    monkeypatch.setattr(robot_point, "StateReceiver", Arm)

    async def scenario():
        async with httpx2.AsyncClient() as http:
            server = gateway_server.GatewayServer(
                config,
                survey=survey(time.time()),
                trust=read_trust(config),
                key=read_key(config),
                policies=read_policies(config),
                http=http,
            )
            await server.close()
            server.gate.close()
            server.journal.close()

    asyncio.run(scenario())
    assert sent == [5.0]
    (fitted,) = equipped
    assert (fitted.payload_kg, list(fitted.centre_m)) == (1.0, [0.0, 0.0, 0.058])
    assert fitted.tcp_m_rad == (0.0, 0.0, 0.1767, 0.0, 0.0, 0.0)


# -- the signed cell file


NOW = 1_900_000_000
UPRIGHT = (1_000_000, 0, 0, 0)


def box(center, half):
    return observation.Box(center, half, UPRIGHT)


def hull(half_um, radius_um):
    """A cube of corners about the base."""
    return observation.Convex(tuple(itertools.product((-half_um, half_um), repeat=3)), radius_um)


def ball(center, radius):
    return observation.Sphere(center, radius)


def signed(tmp_path, text=None, *, key=SURVEYOR, at=NOW, **changes):
    """The cell that the server starts with when this file lies there."""
    path = tmp_path / "cell.jws"
    stated = survey(NOW, audience="http://127.0.0.1:8800/mcp")
    written = cell.sign(structs.replace(stated, **changes), key) if text is None else text
    path.write_bytes(written if isinstance(written, bytes) else written.encode())
    return read_cell(GatewayConfig.from_toml(toml(cell_file=f'"{path}"')), at=at)


def test_a_signed_cell_file_is_taken(tmp_path):
    stated = signed(tmp_path)
    assert (stated.author, stated.sensors) == ("carol", ("camera-1",))
    parameters = surveyed(stated, CellParameters(objects=(), stop_deceleration_rad_s2=5.0))
    assert (parameters.stop_deceleration_rad_s2, parameters.tool, parameters.payload_kg) == (5.0, "robotiq_2f85", 0.0)
    assert [o.name for o in parameters.objects] == ["table"]
    assert [(z.name, z.tier) for z in parameters.zones] == [("fixture", 4), ("charger", None)]
    assert {(c.object, c.by) for c in parameters.contacts} == {
        ("table", "tool"),
        ("table", "payload"),
        ("part-1", "tool"),
    }
    assert parameters.workspace.high_m == (1.0, 1.0, 1.2)
    assert surveyed(structs.replace(stated, payload_g=None), CellParameters()).payload_kg is None


# -- the arm's own kinematics


FOREIGN = "calib_13312600673477018527"
"""A real UR3e, 2 mm and more from nominal in many poses."""


def calibrated_config(tmp_path, text=None, cell=""):
    path = tmp_path / "arm.yaml"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return GatewayConfig.from_toml(toml(cell, calibration_file=f'"{path}"'))


def test_an_arm_without_a_calibration_is_nominal_and_known_less_well():
    config = GatewayConfig.from_toml(toml())
    assert (config.calibration_file, config.cell.robot_uncertainty_m) == (None, NOMINAL_UNCERTAINTY_M)
    assert read_robot(config, tool="robotiq_2f85").model_digest == Robot.load("ur3e").model_digest


def test_an_arm_with_its_calibration_is_that_arm_and_known_better(tmp_path):
    text = spelled(ARMS[FOREIGN], FOREIGN)
    config = calibrated_config(tmp_path, text)
    assert config.cell.robot_uncertainty_m == CALIBRATED_UNCERTAINTY_M < NOMINAL_UNCERTAINTY_M
    robot = read_robot(config, tool="robotiq_2f85")
    own = Calibration.from_yaml(text)
    assert own_kinematics(robot.model) == own.sha256
    assert robot.model_digest == Robot.load("ur3e", calibration=own).model_digest != Robot.load("ur3e").model_digest
    stated = calibrated_config(tmp_path, text, cell="robot_uncertainty_m = 0.02")
    assert stated.cell.robot_uncertainty_m == 0.02


BROKEN = {
    "missing": (None, "FileNotFoundError"),
    "empty": ("", None),
    "no_yaml": ("kinematics: [", None),
    "binary": (b"\xff" * 40, "UnicodeDecodeError"),
    "huge": ("#" * 100_000, None),
    "a_joint_too_few": (spelled(ARMS[FOREIGN]).replace("  wrist_3:", "  wrist_4:"), None),
    "a_tag": (spelled(ARMS[FOREIGN]).replace("kinematics:", "kinematics: !x", 1), None),
    "no_number": (spelled(ARMS[FOREIGN]).replace("0.1517904865811983", ".nan"), None),
    "of a larger model": (spelled(ARMS[FOREIGN].replace("-0.2436795097513105", "-0.425")), None),
    "in millimetres": (spelled(ARMS[FOREIGN].replace("0.1517904865811983", "151.79")), None),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_calibration_that_is_refused(tmp_path, name):
    text, said = BROKEN[name]
    with pytest.raises(ConfigError) as raised:
        read_robot(calibrated_config(tmp_path, text), tool="robotiq_2f85")
    assert raised.value.code is PepFault.CONFIG_INVALID
    assert raised.value.detail.startswith(f"calibration_file: {said or ''}")
    assert str(tmp_path) not in raised.value.detail


def test_a_broken_calibration_keeps_the_server_from_starting(tmp_path):
    """It is read with the cell file, before anything is opened."""
    path = tmp_path / "cell.jws"
    path.write_text(cell.sign(survey(NOW, audience="http://127.0.0.1:8800/mcp"), SURVEYOR))
    (tmp_path / "arm.yaml").write_text("kinematics:\n")
    config = GatewayConfig.from_toml(toml(cell_file=f'"{path}"', calibration_file=f'"{tmp_path}/arm.yaml"'))
    with pytest.raises(ConfigError) as raised:
        read_cell(config, at=NOW)
    assert raised.value.detail.startswith("calibration_file")


def test_doctor_tells_how_well_the_arm_is_known(tmp_path):
    path, configured = tmp_path / "cell.jws", tmp_path / "gateway.toml"
    stated = structs.replace(
        survey(NOW, audience="http://127.0.0.1:8800/mcp"),
        not_before=int(time.time()) - 9,
        not_after=int(time.time()) + 999,
    )
    path.write_text(cell.sign(stated, SURVEYOR))
    (tmp_path / "arm.yaml").write_text(spelled(ARMS[FOREIGN], FOREIGN))

    def arm(**more):
        configured.write_text(toml(cell_file=f'"{path}"', **more))
        ran = CliRunner().invoke(cli, ["doctor", "--config", str(configured), "--json"])
        (row,) = (row for row in json.loads(ran.stdout)["checks"] if row["check"] == "arm")
        assert (ran.exit_code == 0) == row["ok"]
        return row["ok"], row["detail"]

    assert arm()[1].startswith("nominal kinematics; reckoned to 7.5 mm")
    own = Calibration.from_yaml(spelled(ARMS[FOREIGN], FOREIGN)).sha256[:12]
    calibration = {"calibration_file": f'"{tmp_path}/arm.yaml"'}
    assert arm(**calibration) == (True, f"kinematics of its own, calibration {own}; reckoned to 5.0 mm")
    (tmp_path / "arm.yaml").write_text("kinematics: {}")
    assert not arm(**calibration)[0]


REFUSED = {
    "by another person": ({"key": keys.generate()}, "cell_signer_key: STATEMENT_UNTRUSTED"),
    "expired": ({"at": NOW + 365 * 86_400}, "cell_file: EXPIRED"),
    "not yet in force": ({"at": NOW - 61}, "cell_file: NOT_YET_VALID"),
    "for another server": ({"audience": AUDIENCE + "/other"}, "cell_file: WRONG_AUDIENCE"),
    "unsigned": ({"text": json.dumps(cell.to_claims(survey(NOW)))}, "cell_file: STATEMENT_MALFORMED"),
    "without its signature": ({"text": cell.sign(survey(NOW), SURVEYOR).rpartition(".")[0] + "."}, "cell_file: STATEMENT_MALFORMED"),
    "one bit flipped": ({"text": cell.sign(survey(NOW), SURVEYOR).replace(".e", ".f", 1)}, "cell_signer_key: STATEMENT_UNTRUSTED"),
    "another statement": (
        {"text": checkpoint.sign(checkpoint.Checkpoint("https://idp.example/ztpm", 1, "0" * 64, 1), SURVEYOR)},
        "cell_file: STATEMENT_WRONG_KIND",
    ),
    "empty": ({"text": ""}, "cell_file: STATEMENT_MALFORMED"),
    "binary": ({"text": bytes(range(256))}, "cell_file: UnicodeDecodeError"),
    "enormous": ({"text": "a" * 300_000}, "cell_file: STATEMENT_MALFORMED"),
    "an unknown tool": ({"tool": "chainsaw"}, "cell_file: PHYSICS_FAULT"),
    "a tool that the model knows and the driver does not": ({"tool": "robotiq_hande"}, "cell_file: TOOL_NOT_DRIVEN"),
    "a table 11 m away": ({"objects": (cell.Surveyed("t", "rigid", box((11_000_000, 0, 0), (1, 1, 1))),), "contacts": ()}, "cell_file: OUT_OF_REACH"),
    "a zone 11 m wide": ({"zones": (cell.Zone("z", None, box((0, 0, 0), (1, 11_000_000, 1))),)}, "cell_file: OUT_OF_REACH"),
    "a capsule that ends 11 m away": (
        {"zones": (cell.Zone("z", Tier(2), observation.Capsule((0, 0, 0), (0, 0, -11_000_000), 1)),)},
        "cell_file: OUT_OF_REACH",
    ),
    "a workspace 11 m wide": ({"workspace": cell.Workspace((-1, -1, -1), (1, 1, 11_000_000))}, "cell_file: OUT_OF_REACH"),
    "a workspace beside the base": ({"workspace": cell.Workspace((1, -9, -9), (9, 9, 9))}, "cell_file: BASE_OUTSIDE_WORKSPACE"),
    "a workspace below the base": ({"workspace": cell.Workspace((-9, -9, -9), (9, 9, -1))}, "cell_file: BASE_OUTSIDE_WORKSPACE"),
    "a contact with nothing": ({"contacts": (cell.Contact("chair", "tool", False),)}, "cell_file: CONTACT_WITH_NOTHING"),
    "a contact with a zone": ({"contacts": (cell.Contact("fixture", "tool", False),)}, "cell_file: CONTACT_WITH_NOTHING"),
    "an observed contact of a surveyed name": ({"contacts": (cell.Contact("table", "tool", True),)}, "cell_file: CONTACT_AMBIGUOUS"),
    "an observed contact of a zone's name": ({"contacts": (cell.Contact("charger", "tool", True),)}, "cell_file: CONTACT_AMBIGUOUS"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_cell_file_that_is_refused(tmp_path, name):
    wrong, said = REFUSED[name]
    with pytest.raises(ConfigError) as raised:
        signed(tmp_path, **wrong)
    assert raised.value.code is PepFault.CONFIG_INVALID
    assert raised.value.detail.startswith(said)


TURNED = observation.Box((500_000, 0, 0), (100_000, 100_000, 10_000), (923_880, 0, 0, 382_683))  # 45 degrees about z
HARD = {
    "a ball in a ball": (ball((0, 0, 0), 50), ball((0, 0, 10), 60), True),
    "a ball that looks out of a ball": (ball((0, 0, 0), 50), ball((0, 0, 11), 60), False),
    "a box in a box": (box((5, 5, 5), (5, 5, 5)), box((0, 0, 0), (10, 10, 10)), True),
    "a box that looks out of a box": (box((5, 5, 6), (5, 5, 5)), box((0, 0, 0), (10, 10, 10)), False),
    "a ball in a turned box": (ball((500_000, 0, 0), 9_000), TURNED, True),
    "a box that a turned box holds": (box((620_000, 0, 0), (5_000, 5_000, 5_000)), TURNED, True),
    "a box that only its own frame would hold": (box((580_000, 80_000, 0), (5_000, 5_000, 5_000)), TURNED, False),
    "a capsule in a capsule": (
        observation.Capsule((0, 0, 0), (100, 0, 0), 10),
        observation.Capsule((-5, 0, 0), (105, 0, 0), 10),
        True,
    ),
    "a capsule that is longer": (
        observation.Capsule((0, 0, 0), (200, 0, 0), 10),
        observation.Capsule((-5, 0, 0), (105, 0, 0), 20),
        False,
    ),
    "a box in a hull": (box((0, 0, 0), (50, 50, 50)), hull(60, 0), True),
    "a box that sticks out of a hull": (box((20, 0, 0), (50, 50, 50)), hull(60, 0), False),
    "a hull in its rounded twin": (hull(60, 5), hull(60, 5), True),
    "a hull that is rounder": (hull(60, 6), hull(60, 5), False),
    "a hull in a ball": (hull(60, 5), ball((0, 0, 0), 110), True),
    "a ball in the rounding of a hull": (ball((62, 0, 0), 2), hull(60, 5), True),
    "a ball that sticks out of the rounding": (ball((62, 0, 0), 4), hull(60, 5), False),
    "a ball beside a corner of a hull": (ball((64, 64, 64), 1), hull(60, 5), False),
    "a ball in a capsule of no length": (ball((0, 0, 0), 5), observation.Capsule((1, 0, 0), (1, 0, 0), 6), True),
}


@pytest.mark.parametrize("name", HARD)
def test_what_lies_whole_in_a_hard_zone_cannot_be_touched(name):
    thing, zone, inside = HARD[name]
    stated = survey(
        NOW,
        objects=(cell.Surveyed("thing", "rigid", thing),),
        zones=(cell.Zone("zone", None, zone),),
        contacts=(cell.Contact("thing", "tool", False),),
    )
    if inside:
        with pytest.raises(SurveyError) as raised:
            surveyed(stated, CellParameters())
        assert raised.value.code is SurveyFault.CONTACT_IN_HARD_ZONE
    else:
        surveyed(stated, CellParameters())
    declared = structs.replace(stated, zones=(cell.Zone("zone", Tier(4), zone),))
    assert surveyed(declared, CellParameters()).contacts
    untouched = structs.replace(stated, contacts=())
    assert surveyed(untouched, CellParameters()).zones


def test_the_process_does_not_start_on_another_persons_cell_file(tmp_path, files):
    config, key_file = files
    (tmp_path / "cell.jws").write_text(cell.sign(survey(time.time(), audience=config.audience), keys.generate()))
    path = tmp_path / "gateway.toml"
    path.write_text(
        toml(trust_file=f'"{config.trust_file}"', pep_key_file=f'"{key_file}"', cell_file=f'"{tmp_path}/cell.jws"')
    )
    ended = subprocess.run(
        [sys.executable, "-m", "ztpm.point.gateway_server", "--config", str(path)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "cell_signer_key" in ended.stderr


def test_the_embedded_zones_keep_away_from_the_sweep_and_can_be_reached():
    """0.15 m around each zone the ordinary sweep is free; turning on leads into the fixture.

    The other way round leads into the charger.
    """
    arm, cell_ = Robot.load("ur3e"), surveyed(survey(NOW), CellParameters())
    wider = replace(
        cell_,
        zones=tuple(
            StaticZone(z.name, None, sphere=Sphere(z.sphere.center_m, z.sphere.radius_m + 0.15)) for z in cell_.zones
        ),
    )

    def at(q0):
        return (q0, -1.62, 1.25, -1.2, -1.57, 0.0)

    def asked(start, target, parameters, speed=0.5):
        move = MoveJ(at(start), at(target), speed, 1.4)
        scene = parameters.surveyed
        return assess(arm, scene, move, parameters, perception_age_s=0.05, touch=frozenset(), seed=b"zones")

    for start, target in ((-0.6, 0.6), (0.6, -0.6)):
        assert asked(start, target, wider).violations == ()
        assert asked(start, target, cell_).tier == 1
    for q0 in (-1.4, -1.6, -1.8):
        for speed in (0.02, 0.5):
            into = asked(-0.6, q0, cell_, speed)
            assert (into.tier, into.violations) == (4, ())
            assert into.contributions[0].object == "fixture"
    assert asked(0.6, 2.6, cell_).violations == ("zone",)
    assert asked(0.6, 1.8, cell_).tier == 1


def test_the_mass_of_a_part_is_a_number_of_the_configuration():
    text = toml() + '[[cell.parts]]\nobject = "part-1"\nmass_kg = 0.4\n'
    numbers = GatewayConfig.from_toml(text).cell
    assert [(part.object, part.mass_kg) for part in surveyed(survey(NOW), numbers).parts] == [("part-1", 0.4)]
