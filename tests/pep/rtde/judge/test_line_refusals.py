"""A line's own refusal is recorded like a judge's, with its lease, and never many in a second."""

import asyncio
from types import SimpleNamespace

import pytest
from pep.base.errors import JournalError, PepFault
from pep.rtde.judge.line_refusals import MOST, LineRefusals
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.active_lease import ActiveLease
from pep.rtde.line.conversations import LeasedDashboardPort, LeasedRtdePort, LeasedScriptPort
from pep.rtde.line.effects import Halt, Note, Tell
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.script.control_script import allow_list, installed_body
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason
from tests.pep.kit import FailingJournal
from tests.pep.rtde.leased import played, until
from ztpm_idp.domain.ledger import RECORD_KINDS

from pep.rtde.judge import line_refusals

pytestmark = [pytest.mark.e2e, pytest.mark.clause("RTDE-17")]

BUSY = InputRefusal(Reason.BUSY, "the command before is not over")
LIMIT = InputRefusal(Reason.ROBOT_LIMIT, "acceleration", 1)


def written(house):
    return [row["body"] for row in house.records("refusal")]


def test_it_has_a_record_like_a_judges_refusal(house):
    lease = house.lease()

    async def scenario(judge):
        judge.refused(lease, LIMIT, "moveJ")
        judge.refused(lease, BUSY, "speedJ")
        await until(lambda: len(written(house)) == 2)

    played(house, scenario)
    first, second = written(house)
    assert (first["effect"], first["reason"], first["status"]) == ("DENY", "ROBOT_LIMIT", 200)
    assert first["where"] == {"command": "moveJ", "detail": "acceleration"}
    assert first["evidence"]["chain"]["hops"][-1]["agent"] == "robotic"
    assert second["reason"] == "BUSY"
    assert "refusal" in RECORD_KINDS


def test_so_many_in_a_second_and_the_others_are_counted(house, monkeypatch):
    monkeypatch.setattr(line_refusals, "SECOND_S", 0.5)
    lease, count = house.lease(), 200

    async def scenario(judge):
        for _ in range(count):
            judge.refused(lease, BUSY, "moveJ")
        judge.refused(lease, LIMIT, "moveL")
        await until(lambda: len(written(house)) == MOST)
        await until(lambda: len(written(house)) == MOST + 1)
        judge.refused(lease, BUSY, "moveJ")
        await until(lambda: len(written(house)) == MOST + 2)

    played(house, scenario)
    *first, last, later = written(house)
    assert [body["reason"] for body in first] == ["BUSY"] * MOST
    assert all("more" not in body["where"] for body in (*first, later))
    assert last["where"] == {"command": "moveL", "detail": "acceleration", "more": count - MOST}


def test_what_is_left_when_the_judge_ends_is_on_record(house):
    lease, another = house.lease(), house.lease()

    async def scenario(judge):
        for _ in range(MOST + 3):
            judge.refused(lease, BUSY, "moveJ")
        judge.refused(another, LIMIT, "moveJ")

    played(house, scenario)
    bodies = written(house)
    assert len(bodies) == MOST + 2
    assert [body["where"]["more"] for body in bodies if "more" in body["where"]] == [2]
    assert [body["reason"] for body in bodies].count("ROBOT_LIMIT") == 1, "each lease has its own"


@pytest.mark.parametrize("error", [JournalError(PepFault.JOURNAL_BROKEN, "x"), RuntimeError("shut down")])
def test_a_record_that_fails_is_the_journals_trouble_alone(house, error):
    asked = []

    async def record(kind, body):
        asked.append(kind)
        raise error

    async def scenario():
        refusals = LineRefusals(record, house.clock)
        holder = SimpleNamespace(credentials=house.lease().credentials)
        for _ in range(MOST + 1):
            refusals.note(holder, BUSY, "moveJ")
        await refusals.close()

    asyncio.run(scenario())
    assert asked == ["refusal"] * (MOST + 1)


def test_without_a_journal_the_judge_goes_on(house):
    house.build(FailingJournal(house.journal))
    lease = house.lease()

    async def scenario(judge):
        judge.refused(lease, BUSY, "moveJ")

    played(house, scenario)
    assert written(house) == []


# ---- lines that hold no command


class Ends:
    """A tenant, the control line of a program where it has one, and the way back of another."""

    def __init__(self, *, control):
        self.noted, self.told, self.back_told, self.settled, self.closed, self.overs = [], [], [], 0, False, 0
        self.control = self if control else None
        self.line = SimpleNamespace(tell=self.told.append)
        self.ports = SimpleNamespace(note=lambda rung: None)
        self.back = SimpleNamespace(tell=self.back_told.append, send=lambda content: None, close=self.close)

    def note(self, refused, what):
        self.noted.append((refused.reason, what))

    def settle(self):
        self.settled += 1

    def left(self, port):
        pass

    def script_refused(self):
        self.overs += 1

    def close(self):
        self.closed = True


def dashboard(ends):
    LeasedDashboardPort(ends, ends.back).received(b"power on\n")


def script(ends):
    LeasedScriptPort(ends, ends.back, allow_list(installed_body)).received(
        b"def mine():\n  movej([0,0,0,0,0,0])\nend\n"
    )
    assert not ends.closed, "the control script may follow"
    assert ends.overs == 1, "its wait is over"


@pytest.mark.parametrize(
    ("refuse", "reason", "what"),
    [(dashboard, Reason.NOT_GRANTED, "dashboard"), (script, Reason.NOT_GRANTED, "sendCustomScript")],
)
@pytest.mark.parametrize("control", [True, False])
def test_a_script_and_a_line_of_the_dashboard_are_told_once_and_recorded(refuse, reason, what, control):
    async def scenario():
        ends = Ends(control=control)
        refuse(ends)
        return ends

    ends = asyncio.run(scenario())
    assert ends.noted == [(reason, what)]
    (text,) = ends.told + ends.back_told
    assert text.startswith(f"{reason}: ")
    assert (len(ends.told), ends.settled) == ((1, 1) if control else (0, 0))


@pytest.mark.parametrize("broken", ["told", "noted"])
def test_a_stop_waits_for_no_word_and_no_record(broken):
    """The stop for a refusal comes first, through any failure of the rest."""
    done = []

    def breaks(name):
        def doing(*_):
            done.append(name)
            if name == broken:
                raise ValueError

        return doing

    judge = SimpleNamespace(refused=breaks("noted"))
    ports = SimpleNamespace(deceleration=8.0, judge=judge, stop=lambda rung: done.append(rung))
    tenant = ActiveLease(ports, SimpleNamespace())
    port = LeasedRtdePort(tenant, SimpleNamespace(tell=breaks("told")))
    port.line.take = lambda: [Note(BUSY, "moveJ"), Tell("BUSY: so", 1), Halt()]
    port.settle()
    assert done == [StopMeans.PROGRAM, "noted", "told"]


def test_how_a_lease_is_over_reaches_what_tells_its_program():
    heard = []
    tenant = ActiveLease(SimpleNamespace(deceleration=8.0), SimpleNamespace())
    port = LeasedRtdePort(tenant, SimpleNamespace())
    port.line.commands = SimpleNamespace(leave=heard.append, take=list, stands=None)
    tenant.end(LeaseEnding.AUTHORITY)
    assert heard == [LeaseEnding.AUTHORITY]
