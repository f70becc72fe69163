"""Enrolment: a party that was registered once is never registered again behind a person's back."""

from itertools import pairwise
from types import SimpleNamespace

import pytest
from capabilities.statements.registry import PartyEntry, RegistrySnapshot, SensorEntry, ToolEntry
from capabilities.values.scope import Tier
from msgspec.structs import replace
from pep.mcp.arm_server import tool_definitions
from ztpm.base.layout import SURVEYOR, Layout, new_key, read_key
from ztpm.cell.cell import Cell
from ztpm.cell.enrolment import Difference, Differing, EnrolmentError, Kind, RestoringError, enrol, registered
from ztpm.cell.setup import (
    SECOND_SENSOR_ID,
    SENSOR_CALIBRATION,
    SENSOR_ID,
    SENSOR_TRANSIT_MS,
    Addresses,
    initialise,
)

from capabilities.keys import keys
from capabilities.statements import cell as cell_statement
from capabilities.values.caps import DEFAULT as CAPS
from ztpm.cell import enrolment
from ztpm_idp.client import ClientError, ProofAuth

PASSPHRASE = b"a passphrase for tests"


class Registry:
    """A person's client whose registrations are what the snapshot then says."""

    def __init__(self, cell):
        self.cell, self.sensors, self.tools, self.peps, self.fails_at = cell, {}, {}, {}, None

    def snapshot(self):
        a = self.cell.addresses
        return RegistrySnapshot(
            a.issuer,
            1,
            a.audience,
            0,
            tuple(self.tools.values()),
            tuple(self.sensors.values()),
            (),
            (),
            tuple(self.peps.values()),
        )

    def auth(self):
        return ProofAuth(keys.generate())

    def register_pep(self, name, key, audiences):
        assert name not in self.peps
        self.peps[name] = PartyEntry(name, key)

    def register_sensor(self, name, key, *, calibration, transit_ms, audience):
        assert name not in self.sensors
        self.sensors[name] = SensorEntry(name, key, calibration, transit_ms)

    def register_tool(self, *, audience, name, definition_digest, operation, base_tier):
        assert name not in self.tools
        if len(self.tools) == self.fails_at:
            raise ClientError("UNREACHABLE", 0)
        self.tools[name] = ToolEntry(name, definition_digest, operation, Tier(base_tier))


@pytest.fixture
def cell(tmp_path):
    layout, addresses = Layout(tmp_path / "cell"), Addresses("127.77.0.13")
    initialise(layout, addresses, passphrase=PASSPHRASE, policy="paper-default", defer_timeout_s=60)
    return Cell(layout, addresses, PASSPHRASE, (0.0,) * 6)


@pytest.fixture
def registry(cell, monkeypatch):
    made = Registry(cell)
    monkeypatch.setattr(enrolment, "registered", lambda issuer, audience, trust, *, auth: made.snapshot())
    return made


NAMES = sorted(tool.name for tool in tool_definitions())


def test_the_first_time_registers_everything_and_no_other_time_anything(cell, registry):
    assert enrol(cell, registry, None) == ()
    assert (list(registry.peps), list(registry.sensors)) == (["cell-1", "gateway-1"], [SENSOR_ID])
    assert sorted(registry.tools) == NAMES
    sensor = registry.sensors[SENSOR_ID]
    assert sensor.key == keys.public_raw(read_key(cell.layout.sensor_key, PASSPHRASE))
    before = (dict(registry.sensors), dict(registry.tools))
    assert enrol(cell, registry, None) == ()
    assert (registry.sensors, registry.tools) == before


def test_what_differs_later_is_told_and_left_as_it_is(cell, registry):
    enrol(cell, registry, None)
    changed, missing = NAMES[:2]
    registry.tools[changed] = replace(registry.tools[changed], definition_digest="00" * 32)
    del registry.tools[missing]
    del registry.peps["gateway-1"]
    registry.peps["cell-1"] = replace(registry.peps["cell-1"], key=bytes(32))
    registry.tools["old"] = replace(registry.tools[changed], name="old")
    registry.sensors[SENSOR_ID] = replace(registry.sensors[SENSOR_ID], transit_ms=SENSOR_TRANSIT_MS + 1)
    before = (dict(registry.sensors), dict(registry.tools))
    assert set(enrol(cell, registry, None)) == {
        Differing(Kind.TOOL, changed, Difference.CHANGED),
        Differing(Kind.TOOL, missing, Difference.MISSING),
        Differing(Kind.TOOL, "old", Difference.GONE),
        Differing(Kind.SENSOR, SENSOR_ID, Difference.CHANGED),
        Differing(Kind.PEP, "cell-1", Difference.CHANGED),
        Differing(Kind.PEP, "gateway-1", Difference.MISSING),
    }
    assert (registry.sensors, registry.tools) == before


def test_a_second_sensor_has_a_key_and_a_registration_of_its_own_and_is_named_in_the_signed_cell(tmp_path, monkeypatch):
    layout, addresses = Layout(tmp_path / "cell"), Addresses("127.77.0.17")
    initialise(layout, addresses, passphrase=PASSPHRASE, policy="paper-default", defer_timeout_s=60, second_sensor=True)
    two = Cell(layout, addresses, PASSPHRASE, (0.0,) * 6)
    made = Registry(two)
    monkeypatch.setattr(enrolment, "registered", lambda issuer, audience, trust, *, auth: made.snapshot())
    assert enrol(two, made, None) == ()
    assert list(made.sensors) == [SENSOR_ID, SECOND_SENSOR_ID]
    assert len({sensor.key for sensor in made.sensors.values()}) == 2
    surveyor = keys.public_raw(read_key(layout.operator_key(SURVEYOR), PASSPHRASE))
    assert cell_statement.open(layout.cell_file.read_text().strip(), {surveyor}, CAPS).sensors == tuple(made.sensors)
    made.sensors[SECOND_SENSOR_ID] = replace(made.sensors[SECOND_SENSOR_ID], key=bytes(32))
    assert enrol(two, made, None) == (Differing(Kind.SENSOR, SECOND_SENSOR_ID, Difference.CHANGED),)


def test_each_sensor_of_a_cell_is_begun_with_its_own_key(cell):
    def begin(*told, **_):
        begun.extend(told)
        return SimpleNamespace(until_ready=lambda: None, stop=lambda: None)

    def given(option):
        return [value for word, value in pairwise(begun) if word == option]

    begun, layout = [], cell.layout
    cell.begin_child = begin
    cell.start_sensor("--paused")
    assert (given("--sensor"), given("--key-file"), begun[-1]) == ([SENSOR_ID], [str(layout.sensor_key)], "--paused")
    new_key(layout.second_sensor_key, PASSPHRASE)
    begun.clear()
    cell.start_sensor()
    assert given("--sensor") == [SENSOR_ID, SECOND_SENSOR_ID]
    assert given("--key-file") == [str(layout.sensor_key), str(layout.second_sensor_key)]
    assert given("--calibration") == [SENSOR_CALIBRATION] * 2


@pytest.mark.parametrize("member", ["operation", "base_tier"])
def test_operation_and_tier_count_too(cell, registry, member):
    enrol(cell, registry, None)
    name = NAMES[0]
    registry.tools[name] = replace(registry.tools[name], **{member: "other" if member == "operation" else Tier(4)})
    assert enrol(cell, registry, None) == (Differing(Kind.TOOL, name, Difference.CHANGED),)


def test_a_first_time_that_was_cut_short_goes_on(cell, registry):
    registry.fails_at = 2
    with pytest.raises(ClientError):
        enrol(cell, registry, None)
    assert not cell.layout.enrolled.exists()
    registry.fails_at = None
    assert enrol(cell, registry, None) == ()
    assert sorted(registry.tools) == NAMES


def test_a_first_time_overrides_nothing_that_is_there(cell, registry):
    tool = next(tool for tool in tool_definitions() if tool.name == NAMES[0])
    registry.tools[tool.name] = ToolEntry(tool.name, "00" * 32, tool.operation, Tier(tool.base_tier))
    other = keys.public_raw(keys.generate())
    registry.sensors[SENSOR_ID] = SensorEntry(SENSOR_ID, other, SENSOR_CALIBRATION, SENSOR_TRANSIT_MS)
    assert {differing.name for differing in enrol(cell, registry, None)} == {tool.name, SENSOR_ID}
    assert (registry.tools[tool.name].definition_digest, registry.sensors[SENSOR_ID].key) == ("00" * 32, other)


def test_a_registry_that_does_not_answer(cell):
    with pytest.raises(EnrolmentError):
        registered(cell.addresses.issuer, cell.addresses.audience, None, auth=ProofAuth(keys.generate()))


def test_a_cell_whose_provider_is_being_restored_begins_so_that_somebody_can_end_it(cell, registry, monkeypatch):
    def waits(*_, **__):
        raise RestoringError

    enrol(cell, registry, None)
    monkeypatch.setattr(enrolment, "registered", waits)
    assert enrol(cell, registry, None) == ()
    cell.layout.enrolled.unlink()
    with pytest.raises(RestoringError):
        enrol(cell, registry, None)
