"""Removal of primitives: each in a process of its own, since it changes the process for good."""

import subprocess
import sys
from pathlib import Path

from evaluation.redteam.composition import ALL, MODES, composed
from evaluation.redteam.taken_out.rows import GATEWAY, PHYSICS, PROVIDER, TAKEN, TOOLS, concerning

TOP = Path(__file__).parents[3]

REMOVED = """
from dataclasses import fields
from capabilities.keys import keys
from capabilities.statements import observation
from evaluation.redteam.taken_out.rows import TAKEN, take_out
from pep.context import instructions, messages
from pep.context.messages import ConversationBook
from pep.perception.sensor_frames import Frames, SensorFrame
from policies.evidence.evidence import Evidence
from policies.evidence.model import Request
from policies.primitives.base import Case, Holds
from policies.primitives.catalog import CATALOG
from tests.capabilities.world import NOW, key_of
from tests.pep.context.context_kit import CAPS, FORMS, PEOPLE, chain_to, said, wanted
from tests.pep.kit import CALIBRATION, ManualClock, Registry

clock, registry, chain, known = ManualClock(), Registry(), chain_to("robotic"), dict(forms=FORMS, at=NOW + 1, caps=CAPS)
registry.add_sensor()
frames = Frames(sensors=registry, named=frozenset({"camera-1"}), clock=clock, caps=CAPS)
seen = observation.Observation(
    sensor="camera-1", boot_id="0" * 32, sequence=1, captured_ms=int(clock.wall_s() * 1000), calibration=CALIBRATION,
    complete=True, people=(), objects=(),
)
frame = observation.sign(seen, keys.generate()).encode()


def believed():
    stranger = key_of("mallory")
    order = instructions.read(wanted(key=stranger), people=PEOPLE, chain=None, **known)
    heard = dict(addressee="robotic", conversations=ConversationBook(clock), **known)
    word = messages.read(said(chain, key=stranger), chain=chain, **heard)
    texts = {"CII-1": order.intent, "CII-6": word.message}
    texts["CII-4"] = frame if isinstance(frames.admit(frame), SensorFrame) else None
    return {id for id, text in texts.items() if text is not None}


def held():
    case = Case(Request("r", frozenset(), "", "", "", (), 0.0), Evidence(at=0.0, at_ms=0), True, None)
    found = set()
    for row in CATALOG:
        primitive = object.__new__(row.decides)
        for field in fields(primitive):
            object.__setattr__(primitive, field.name, 1)
        if isinstance(primitive.judge(case), Holds):
            found.add(row.id)
    return found


some = {"CII-1", "CII-4", "CII-6"}
assert (believed(), held()) == (set(), set())
take_out(frozenset(some))
assert (believed(), held()) == (some, some)
take_out(frozenset(TAKEN))
assert held() == {row.id for row in CATALOG}
"""
"""Words of strangers are refused, and nothing holds without evidence; for what is off alone that changes."""


def test_what_is_off_holds_without_evidence_and_believes_a_stranger() -> None:
    ran = subprocess.run([sys.executable, "-c", REMOVED], capture_output=True, text=True, cwd=TOP, check=False)
    assert ran.returncode == 0, ran.stderr


def test_each_primitive_and_the_physics_have_one_row() -> None:
    assert set(TAKEN) == {*ALL, PHYSICS}
    assert [row.id for row in TAKEN.values() if not row.processes] == []
    for mode in MODES.values():
        assert mode <= set(TAKEN)


def test_a_process_is_begun_without_what_concerns_it_alone() -> None:
    begun = {}

    def begin(name: str, module: str, *arguments: str, **options: object) -> None:
        begun[name] = module, arguments, options

    for name in (PROVIDER, GATEWAY, TOOLS, "sensor", "admission"):
        composed({"CII-3", "TEA-4", "CATP-4"}, begin)(name, "its.module", "--config", "f", environment={})
    whole, module = ("its.module", ("--config", "f"), {"environment": {}}), "evaluation.redteam.composition"
    assert begun["sensor"] == whole
    assert begun[PROVIDER] == (module, ("CATP-4", *("its.module", "--config", "f")), {"environment": {}})
    assert begun[TOOLS][1][0] == "CATP-4"
    assert begun[GATEWAY][1][0] == "CATP-4,TEA-4"
    assert begun["admission"][1][0] == "CATP-4,CII-3,TEA-4"


def test_nothing_off_is_the_product_itself() -> None:
    assert concerning(GATEWAY, ()) == frozenset()
