"""docs/deployment.md says what the code says: its configuration is taken, its ports are ours, what it names is there."""

import json
import re
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import pytest
from capabilities.values.caps import DEFAULT
from capabilities.values.scope_json import scope_from_json
from pep.base.errors import PepFault
from pep.base.operations import MOVE_JOINT
from pep.rtde.robot.connections import GRIPPER, PORTS
from tests.pep.pit.robot.test_calibration import ARMS, spelled
from ursim.ports.launch import SimulatedController
from ztpm.base.layout import new_key
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm.cell.first_draft import CellWish, cell_draft, first_scope
from ztpm.cell.setup import GATEWAY_ID
from ztpm.point.cell_config import read_cell, read_key, read_policies, read_robot, read_trust
from ztpm.point.gateway_config import GatewayConfig, read_gateway_config
from ztpm.stage.stage import LEFT

from capabilities.keys import keys
from capabilities.rotation import rotation
from capabilities.statements import cell
from ztpm.cell import survey

rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "deployment.md").read_text("utf-8")
(CONFIG,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
(PROGRAM,) = re.findall(r"<!-- file: first.py -->\n```python\n(.*?)```", PAGE, re.DOTALL)
SLOW, FAST = re.findall(r"first\.py \{robot\} ([\d.]+)$", PAGE, re.MULTILINE)[:2]
GATEWAY = GatewayConfig.from_toml(CONFIG)


def numbers(spelt):
    """Ports as nftables and people spell them: "29999, 30001-30004"."""
    ends = [tuple(map(int, part.split("-"))) for part in spelt.split(",")]
    return {port for first, *last in ends for port in range(first, (last or [first])[0] + 1)}


def rule(beginning):
    """The ports of the one rule that begins so."""
    (line,) = (line for line in PAGE.splitlines() if line.strip().startswith(beginning))
    return numbers(re.search(r"\{(.*?)\}", line).group(1))


def test_the_configuration_is_taken_with_the_files_that_it_names(tmp_path, monkeypatch):
    monkeypatch.setenv(PASSPHRASE_VARIABLE, "a passphrase for tests")
    signer, at = keys.generate(), int(time.time())
    text = CONFIG.replace(GATEWAY.cell_signer_key, keys.b64u(keys.public_raw(signer)))
    configured = tmp_path / "gateway.toml"
    configured.write_text(text.replace("/etc/ztpm/", f"{tmp_path}/").replace("/var/lib/ztpm/", f"{tmp_path}/"))
    config = read_gateway_config(configured)
    own = new_key(config.pep_key_file, b"a passphrase for tests")
    ring = rotation.begin(config.issuer, {role: keys.public_raw(keys.generate()) for role in rotation.ID_STEM}, at=at)
    config.trust_file.write_bytes(ring.bundle(DEFAULT).to_json())
    config.calibration_file.write_text(spelled(next(iter(ARMS.values()))))
    wish = CellWish(name="first", author="carol", tool="robotiq_2f85", sensors=("camera-1",))
    draft = cell_draft(wish, audience=config.audience)
    config.cell_file.write_text(cell.sign(survey.draft(draft, at=at, days=1), signer))

    stated = read_cell(config, at=at)
    assert read_robot(config, tool=stated.tool).tool.name == stated.tool
    assert read_trust(config).issuer == config.issuer
    assert keys.public_raw(read_key(config)) == keys.public_raw(own)
    assert read_policies(config).policies


def test_every_setting_is_in_it():
    assert {field.name for field in fields(GatewayConfig)} == set(re.findall(r"^\[?(\w+)", CONFIG, re.MULTILINE))
    assert GATEWAY.pep_id == GATEWAY_ID, "which `ztpm rtde run` takes without --pep"


def test_the_ports_are_those_of_the_code():
    assert rule(f'iifname "eth0" ip daddr {GATEWAY.listen_host}') == set(PORTS)
    assert rule(f'iifname "eth0" ip daddr {GATEWAY.host}') == {
        GATEWAY.port, GATEWAY.carriage_port, GATEWAY.perception_port,
    }  # fmt: skip
    assert rule('oifname "eth1" tcp dport') == {*PORTS, GRIPPER}
    (seen,) = re.findall(rf"^nmap .* {GATEWAY.listen_host} +# ([\d, -]+) and nothing else$", PAGE, re.MULTILINE)
    assert numbers(seen) == set(PORTS)


def test_towards_the_robot_goes_nothing_but_the_gateways_tcp():
    rules = [line.split("#")[0].split() for line in PAGE.splitlines() if line.strip().startswith('oifname "eth1"')]
    assert [words[2:-1] for words in rules[:2]] == [["meta", "l4proto", "!=", "tcp"], ["meta", "skuid", "!=", "ztpm"]]
    assert {words[-1] for words in rules} == {"drop"}


def test_what_it_names_is_there():
    assert re.findall(r"`((?:capabilities|policies|pep|ztpm|ztpm_idp)(?:\.\w+)+)`", PAGE) == []  # commands do all of it
    (table,) = re.findall(r"\| code \|.*?\n\n", PAGE, re.DOTALL)
    codes = re.findall(r"`([A-Z_]{5,})`", table)
    assert codes
    assert set(codes) <= set(PepFault)


def test_the_scope_is_one_for_the_first_move():
    scope = scope_from_json(json.loads((DOCS / "examples" / "first.scope.json").read_text()))
    (grant,) = scope.grants
    assert (grant.object, grant.operation) == (MOVE_JOINT.object, MOVE_JOINT.name)
    assert [limit.parameter for limit in grant.limits] == list(MOVE_JOINT.parameters)
    made = scope_from_json(json.loads(first_scope(GATEWAY.audience)))
    assert (made.grants, made.ceiling, made.audiences) == (scope.grants, scope.ceiling, {GATEWAY.audience})
    bounds = {limit.parameter.name: limit.bound for limit in grant.limits}
    (acceleration,) = re.findall(r"float\(sys\.argv\[2\]\), ([\d.]+)\)", PROGRAM)
    for name, said in (("speed", SLOW), ("acceleration", acceleration)):
        assert bounds[name].low <= float(said) * 1e6 <= bounds[name].high
    assert float(FAST) * 1e6 > bounds["speed"].high


@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_the_first_program_moves_the_arm():
    with SimulatedController.start(joints=LEFT) as robot:
        ran = subprocess.run(
            [sys.executable, "-c", PROGRAM, robot.host, SLOW], capture_output=True, text=True, timeout=30, check=True
        )
        assert ran.stdout.split() == ["True", "0.05"]
        q = rtde_receive.RTDEReceiveInterface(robot.host).getActualQ()
    assert q == pytest.approx([LEFT[0] + 0.05, *LEFT[1:]], abs=1e-3)
