"""Motion lease: opened with a token and a proof, carried in its session, one at a time, and ended."""

import asyncio
import contextlib
import os
import secrets
import socket
import time
from enum import StrEnum
from types import SimpleNamespace

import httpx2
import pytest
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from pep.base.clock import SystemClock
from pep.rtde.lease.lease import SILENCE_MS, LeaseEnding, Leases
from pep.rtde.lease.lease_endpoint import LOSSLESS, RENEWING, LeaseEndpoint, renewal_body
from pep.rtde.lease.lease_messages import (
    Beat,
    Bytes,
    Open,
    Opened,
    RefusalNotice,
    SessionFrameSplitter,
    decode,
    delimited,
    encode,
)
from pep.rtde.lease.lease_port import LeasePort
from pep.rtde.robot.connections import UNREAD_BYTES
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, HOST, ManualClock, Rig, full_scope
from ztpm.base.peer import user_of
from ztpm.point.lease_listener import WAITING, LeaseListener
from ztpm.program.program_ports import ProgramPorts

from capabilities.keys import keys
from capabilities.proof import session_opening
from pep.rtde.lease import lease_port

pytestmark = pytest.mark.real_time

URL = f"{AUDIENCE}/leases"
ECHO, BIG, SHUT = 30004, 30003, 29999
OWN = os.getuid()


def told(said):
    """Function that answers for `user_of`."""
    return lambda link: said


class Echo:
    """Says back what it hears. What it is left with, and whether it was left, is seen."""

    def __init__(self, back):
        self.back, self.heard, self.gone = back, b"", False

    def received(self, content):
        self.heard += content
        self.back.send(content)
        if content == b"why":
            self.back.tell("BUSY: so it is")
        if content == b"quit":
            self.back.close()

    def left(self):
        self.gone = True


class Robot:
    """Ports of which one echoes, one sends much at once and one is shut."""

    def __init__(self):
        self.lines, self.asked = [], []

    async def open(self, lease, port, back):
        self.asked.append((lease.agent, port))
        if port == SHUT:
            return Reason.NOT_GRANTED
        line = Echo(back)
        self.lines.append(line)
        back.send(b"banner")
        return line


class House:
    """A gateway's door and port over a robot that only listens."""

    def __init__(self, rig, robot=None, ended=lambda lease, why: None):
        self.rig, self.robot, self.over, self.told, self.carried = rig, robot or Robot(), [], [], 0
        self.signer = keys.generate()
        self.leases = Leases()
        self.port = LeasePort(self.leases, self.robot, clock=rig.clock, begun=self._carried, ended=self._ended)
        self._told = ended
        self.door = LeaseEndpoint(
            leases=self.leases, authority=rig.authority, clock=rig.clock, journal=rig.journal, caps=CAPS,
            url=URL, audience=AUDIENCE, signer=self.signer, port=0, lease_ms=2_000,
        )  # fmt: skip

    def _carried(self):
        self.carried += 1

    def _ended(self, lease, why):
        self.over.append((lease.agent, why))
        self._told(lease, why)

    async def __aenter__(self):
        with socket.create_server((HOST, 0)) as free:
            self.address = free.getsockname()
        self.arrivals = LeaseListener(self.port)
        await self.arrivals.listen(*self.address)
        self.http = httpx2.AsyncClient(transport=httpx2.ASGITransport(self.door.app()))
        return self

    async def __aexit__(self, *_):
        await self.http.aclose()
        self.arrivals.close()
        self.port.end(LeaseEnding.GATEWAY)

    def begun(self, holder, *, key=None, audience=AUDIENCE, verifier_key=None):
        return session_opening.begin(
            key=key or holder.key, url=URL, audience=audience, token=holder.text,
            verifier_key=verifier_key or keys.public_raw(self.signer), private=secrets.token_bytes(32),
            nonce=secrets.token_bytes(32), at=int(self.rig.clock.wall_s()), jti=secrets.token_hex(16),
        )  # fmt: skip

    async def post(self, holder, pending, **headers):
        headers = {"authorization": f"DPoP {holder.text}", "dpop": pending.proof} | headers
        return await self.http.post(URL, content=pending.body, headers=headers)

    async def renew(self, holder, lease_id, *, body=None, proof=None, **spoilt):
        """Answer to a renewal with the holder's token."""
        body = renewal_body(lease_id) if body is None else body
        proof = proof or holder.proof(
            body, at=self.rig.clock.wall_s(), **{"url": URL, "method": RENEWING} | spoilt
        )  # fmt: skip
        headers = {"authorization": f"DPoP {holder.text}", "dpop": proof}
        return await self.http.request(RENEWING, URL, content=body, headers=headers)

    async def lease(self, holder):
        """Lease id and session of the program's end."""
        pending = self.begun(holder)
        answered = await self.post(holder, pending)
        assert answered.status_code == 201, answered.text
        said = answered.json()
        opened = session_opening.conclude(
            pending, said["session"].encode(), at=self.rig.clock.wall_s(), most_missing=LOSSLESS, caps=CAPS
        )
        assert not isinstance(opened, Fault), opened
        return bytes.fromhex(said["lease"]), opened

    async def program(self, holder, *, user=OWN):
        """Ports of a program on an address of its own; with them, where they are and what ended them."""
        lease_id, opened = await self.lease(holder)
        over, host = [], f"127.{HOST.split('.')[1]}.{HOST.split('.')[2]}.11"
        ports = ProgramPorts(
            opened, lease_id, clock=self.rig.clock, user=user, ended=over.append, told=self.told.append
        )
        await ports.begin(gateway=self.address, host=host, ports=(ECHO, BIG, SHUT))
        return ports, host, over


def in_house(scenario, tmp_path, clock=None):
    rig = Rig(tmp_path, clock or SystemClock())

    async def inside():
        async with asyncio.timeout(30), House(rig) as house:
            return await scenario(house)

    return asyncio.run(inside())


async def until(what):
    async with asyncio.timeout(10):
        while not what():
            await asyncio.sleep(0.005)


async def read(reader, count):
    async with asyncio.timeout(10):
        return await reader.readexactly(count)


# ---- places at the port


def silent(address, host):
    """Connection that says nothing."""
    return socket.create_connection(address, timeout=5, source_address=(host, 0))


def is_open(connection):
    connection.setblocking(False)
    try:
        return connection.recv(1) != b""
    except BlockingIOError:
        return True
    except ConnectionResetError:
        return False


def test_one_address_has_so_many_places_and_its_oldest_silent_connection_goes_first(tmp_path, monkeypatch):
    monkeypatch.setattr(lease_port, "PATIENCE_S", 60.0)  # so that none of them ends by itself
    crowd_of, other_of = (f"127.{HOST.split('.')[1]}.{HOST.split('.')[2]}.{last}" for last in (21, 22))

    async def scenario(house):
        places = house.arrivals.places
        with contextlib.ExitStack() as stack:
            other = stack.enter_context(silent(house.address, other_of))
            await until(lambda: len(places) == 1)
            crowd = [stack.enter_context(silent(house.address, crowd_of)) for _ in range(WAITING.by_address)]
            await until(lambda: len(places) == 1 + WAITING.by_address)
            assert all(map(is_open, crowd))
            async with asyncio.timeout(10):
                while is_open(crowd[0]):  # first those are hung up on that follow within the grace of the others
                    stack.enter_context(silent(house.address, crowd_of))
                    await asyncio.sleep(0.02)
            assert all(map(is_open, crowd[2:]))
            assert len(places) == 1 + WAITING.by_address
            # Another address has its place as before; what is carried waits no longer.
            lease_id, _ = await house.lease(house.rig.agent())
            assert is_open(other)
            other.sendall(lease_id)
            await until(lambda: house.carried == 1)
            assert len(places) == WAITING.by_address
        await until(lambda: len(places) == 0)

    in_house(scenario, tmp_path)


# ---- the lease alone


def test_one_at_a_time_and_only_for_who_brings_its_carriage():
    class Some:
        id = b"1" * 16

    leases, one, other = Leases(), Some(), Some()
    assert leases.open(one, at_ms=0)
    assert not leases.open(other, at_ms=0)
    assert leases.carry(b"2" * 16, at_ms=1) is None
    assert leases.carry(one.id, at_ms=1) is one
    assert leases.carry(one.id, at_ms=1) is None, "carried once"
    assert not leases.silent(at_ms=1 + SILENCE_MS)
    assert leases.silent(at_ms=2 + SILENCE_MS)
    assert not leases.end(other)
    assert leases.end(one)
    assert not leases.end(one)
    assert leases.open(other, at_ms=5_000)


# ---- asking for one


def test_a_lease_is_on_record_and_held(tmp_path):
    async def scenario(house):
        holder = house.rig.agent()
        lease_id, _ = await house.lease(holder)
        assert house.carried == 0, "its program is told nothing yet"
        (record,) = [r["body"] for r in house.rig.journal.records() if r["kind"] == "lease"]
        assert record["agent"] == "robotic"
        assert lease_id.hex() not in str(record), "whoever reads the record cannot bring a carriage"
        held = await house.post(holder, house.begun(holder))
        assert (held.status_code, held.json()["reason"]) == (409, "LEASE_HELD")
        assert house.leases.current.id == lease_id

    in_house(scenario, tmp_path)


@pytest.mark.parametrize(
    ("spoil", "status", "reason"),
    [
        (lambda h, holder, p: ({"authorization": "DPoP"}, p), 401, "TOKEN_MISSING"),
        (lambda h, holder, p: ({"authorization": f"Bearer {holder.text}"}, p), 401, "TOKEN_MISSING"),
        (lambda h, holder, p: ({"dpop": "x"}, p), 401, "PROOF_MALFORMED"),
        (lambda h, holder, p: ({}, h.begun(holder, key=keys.generate())), 401, "PROOF_WRONG_KEY"),
        (lambda h, holder, p: ({}, h.begun(holder, audience="http://127.0.0.1/mcp")), 401, "PROOF_NOT_FOR_THIS_REQUEST"),
        (lambda h, holder, p: ({}, h.begun(holder, verifier_key=keys.public_raw(keys.generate()))), 401, "PROOF_NOT_FOR_THIS_REQUEST"),
    ],
)  # fmt: skip
def test_who_may_not_have_one_is_told_why_and_it_is_on_record(tmp_path, spoil, status, reason):
    async def scenario(house):
        holder = house.rig.agent()
        headers, pending = spoil(house, holder, house.begun(holder))
        answered = await house.post(holder, pending, **headers)
        assert (answered.status_code, answered.json()["reason"]) == (status, reason)
        assert house.leases.current is None
        assert [r["body"]["reason"] for r in house.rig.journal.records() if r["kind"] == "refusal"] == [reason]

    in_house(scenario, tmp_path)


def test_a_revoked_token_a_replayed_opening_and_a_long_body_open_nothing(tmp_path):
    async def scenario(house):
        holder = house.rig.agent()
        pending = house.begun(holder)
        assert (await house.post(holder, pending)).status_code == 201
        house.port.end(LeaseEnding.CLOSED)
        again = await house.post(holder, pending)
        assert (again.status_code, again.json()["reason"]) == (401, "REPLAYED")
        long = await house.http.post(URL, content=b"x" * 3_000, headers={"authorization": f"DPoP {holder.text}"})
        assert (long.status_code, long.json()["reason"]) == (413, "BODY_TOO_LARGE")
        house.rig.feed.revoke("hop", holder.hop_id)
        refused = await house.post(holder, house.begun(holder))
        assert (refused.status_code, refused.json()["reason"]) == (401, "REVOKED")
        assert house.leases.current is None

    in_house(scenario, tmp_path)


def test_no_record_no_lease(tmp_path):
    async def scenario(house):
        house.rig.journal.close()
        holder = house.rig.agent()
        answered = await house.post(holder, house.begun(holder))
        assert (answered.status_code, answered.json()["reason"]) == (503, "RECORD_FAILED")
        assert house.leases.current is None

    in_house(scenario, tmp_path)


def test_a_lease_that_nobody_carries_is_over(tmp_path):
    async def scenario(house):
        await house.lease(house.rig.agent())
        house.rig.clock.advance(SILENCE_MS)
        house.port.look()
        assert house.over == []
        house.rig.clock.advance(1)
        house.port.look()
        assert house.over == [("robotic", LeaseEnding.SILENT)]
        assert house.leases.current is None

    in_house(scenario, tmp_path, ManualClock())


# ---- renewing

MANDATE, OTHER_MANDATE = "ab" * 16, "cd" * 16


def drawn(house, holder=None, **options):
    """A token of the mandate, for that agent with its key."""
    key = {} if holder is None else {"key": holder.key}
    return house.rig.agent(**{"mandate_id": MANDATE} | key | options)


@pytest.mark.clause("LSD-10")
def test_another_token_of_the_mandate_takes_the_place_of_the_first(tmp_path):
    async def scenario(house):
        clock = house.rig.clock
        first = drawn(house, scope=full_scope(clock.wall_s(), lifetime_s=60))
        lease_id, opened = await house.lease(first)
        lease = house.leases.current
        ends, old = lease.not_after, lease.credentials
        clock.advance(45_000)
        second = drawn(house, first, scope=full_scope(clock.wall_s(), lifetime_s=60))
        answer = await house.renew(second, lease_id)
        assert (answer.status_code, answer.json()) == (200, {"not_after": ends + 45})
        assert house.leases.current is lease
        assert lease.credentials.chain.leaf.hop_id == second.hop_id
        assert lease.not_after == ends + 45
        kinds = [(r["kind"], r["body"].get("hop")) for r in house.rig.journal.records()]
        assert kinds == [("lease", first.hop_id), ("lease-renewed", second.hop_id)]
        assert lease_id.hex() not in str(list(house.rig.journal.records()))
        clock.advance(30_000)  # the first token is over
        frame = opened.seal(b"", at=clock.wall_s())
        assert isinstance(frame, Fault), "the holder's end is renewed by the holder"
        assert isinstance(house.rig.authority.verify(old.token, lease_ms=2_000), Fault)
        assert isinstance(house.rig.authority.verify(lease.credentials.token, lease_ms=2_000), Chain)
        assert not isinstance(lease.session.seal(b"", at=clock.wall_s()), Fault)
        # Of the mandate alone is the end that is left.
        house.rig.feed.revoke("token", old.chain.token_id)
        assert isinstance(house.rig.authority.verify(lease.credentials.token, lease_ms=2_000), Chain)
        house.rig.feed.revoke("mandate", MANDATE)
        assert house.rig.authority.verify(lease.credentials.token, lease_ms=2_000).code == "REVOKED"

    in_house(scenario, tmp_path, ManualClock())


@pytest.mark.clause("LSD-10")
@pytest.mark.parametrize(
    ("options", "status", "reason"),
    [
        ({"name": "planner"}, 403, "LEASE_OF_ANOTHER"),
        ({"key": keys.generate()}, 403, "LEASE_OF_ANOTHER"),
        ({"mandate_id": OTHER_MANDATE}, 403, "MANDATE_DIFFERS"),
        ({"mandate_id": None}, 403, "MANDATE_MISSING"),
        ({"audience": "http://127.0.0.1/mcp"}, 401, "WRONG_AUDIENCE"),
        ({"lifetime_s": -1}, 401, "EXPIRED"),
        ({"revoked": True}, 401, "REVOKED"),
    ],
    ids=["agent", "key", "mandate", "no mandate", "audience", "expired", "revoked"],
)
def test_a_token_that_may_not_take_its_place_changes_nothing(tmp_path, options, status, reason):
    async def scenario(house):
        asked = dict(options)
        scope = {name: asked.pop(name) for name in ("audience", "lifetime_s") if name in asked}
        revoked = asked.pop("revoked", False)
        first = drawn(house)
        lease_id, _ = await house.lease(first)
        other = drawn(house, first, scope=full_scope(house.rig.clock.wall_s(), **scope), **asked)
        if revoked:
            house.rig.feed.revoke("hop", other.hop_id)
        before = house.leases.current.credentials, house.leases.current.not_after
        answer = await house.renew(other, lease_id)
        assert (answer.status_code, answer.json()["reason"]) == (status, reason)
        assert (house.leases.current.credentials, house.leases.current.not_after) == before
        assert [(r["kind"], r["body"].get("reason")) for r in house.rig.journal.records()][1:] == [("refusal", reason)]

    in_house(scenario, tmp_path)


@pytest.mark.clause("LSD-10")
def test_a_lease_that_was_opened_without_a_mandate_is_not_renewed(tmp_path):
    async def scenario(house):
        first = house.rig.agent()
        lease_id, _ = await house.lease(first)
        for mandate_id in (None, MANDATE):
            answer = await house.renew(drawn(house, first, mandate_id=mandate_id), lease_id)
            assert (answer.status_code, answer.json()["reason"]) == (403, "MANDATE_MISSING")

    in_house(scenario, tmp_path)


@pytest.mark.clause("LSD-10")
@pytest.mark.parametrize(
    ("spoil", "status", "reason"),
    [
        (lambda lease_id: {"body": renewal_body(b"another lease id")}, 404, "LEASE_UNKNOWN"),
        (lambda lease_id: {"body": b""}, 404, "LEASE_UNKNOWN"),
        (lambda lease_id: {"body": b"[]"}, 404, "LEASE_UNKNOWN"),
        (lambda lease_id: {"body": b'{"lease":7}'}, 404, "LEASE_UNKNOWN"),
        (lambda lease_id: {"body": b'{"lease": "%s"}' % lease_id.hex().encode()}, 404, "LEASE_UNKNOWN"),
        (lambda lease_id: {"body": b'{"lease":"%s"}' % lease_id.hex().upper().encode()}, 404, "LEASE_UNKNOWN"),
        (lambda lease_id: {"body": b"x" * 3_000}, 413, "BODY_TOO_LARGE"),
        (lambda lease_id: {"method": "POST"}, 401, "PROOF_NOT_FOR_THIS_REQUEST"),
        (lambda lease_id: {"url": AUDIENCE}, 401, "PROOF_NOT_FOR_THIS_REQUEST"),
        (lambda lease_id: {"key": keys.generate()}, 401, "PROOF_WRONG_KEY"),
    ],
)
def test_a_renewal_of_another_form_or_proof_changes_nothing(tmp_path, spoil, status, reason):
    async def scenario(house):
        first = drawn(house)
        lease_id, _ = await house.lease(first)
        answer = await house.renew(drawn(house, first), lease_id, **spoil(lease_id))
        assert (answer.status_code, answer.json()["reason"]) == (status, reason)
        assert house.leases.current.credentials.chain.leaf.hop_id == first.hop_id

    in_house(scenario, tmp_path)


@pytest.mark.clause("LSD-10")
def test_a_lease_that_is_over_a_used_proof_and_a_full_disk_renew_nothing(tmp_path):
    async def scenario(house):
        first = drawn(house)
        lease_id, _ = await house.lease(first)
        second = drawn(house, first)
        proof = second.proof(renewal_body(lease_id), at=house.rig.clock.wall_s(), url=URL, method=RENEWING)
        assert (await house.renew(second, lease_id, proof=proof)).status_code == 200
        again = await house.renew(second, lease_id, proof=proof)
        assert (again.status_code, again.json()["reason"]) == (401, "REPLAYED")
        house.port.end(LeaseEnding.CLOSED)
        late = await house.renew(drawn(house, first), lease_id)
        assert (late.status_code, late.json()["reason"]) == (404, "LEASE_UNKNOWN")
        lease_id, _ = await house.lease(first)
        house.rig.journal.close()
        unrecorded = await house.renew(drawn(house, first), lease_id)
        assert (unrecorded.status_code, unrecorded.json()["reason"]) == (503, "RECORD_FAILED")
        assert house.leases.current.credentials.chain.leaf.hop_id == first.hop_id

    in_house(scenario, tmp_path)


@pytest.mark.clause("LSD-10")
def test_a_lease_that_ends_while_its_renewal_is_recorded_is_not_renewed(tmp_path):
    async def scenario(house):
        first = drawn(house)
        lease_id, _ = await house.lease(first)
        lease, append = house.leases.current, house.rig.journal.append

        def ending(kind, body):
            house.leases.end(lease)
            return append(kind, body)

        object.__setattr__(house.door, "journal", SimpleNamespace(append=ending))
        answer = await house.renew(drawn(house, first), lease_id)
        assert (answer.status_code, answer.json()["reason"]) == (404, "LEASE_UNKNOWN")
        assert lease.credentials.chain.leaf.hop_id == first.hop_id

    in_house(scenario, tmp_path)


# ---- carrying


def test_a_program_has_its_connections_side_by_side_and_what_it_says_first_is_not_lost(tmp_path):
    async def scenario(house):
        ports, host, over = await house.program(house.rig.agent())
        one, say_one = await asyncio.open_connection(host, ECHO)
        two, say_two = await asyncio.open_connection(host, BIG)
        say_one.write(b"first")
        say_two.write(b"second")
        assert await read(one, 11) == b"bannerfirst"
        assert await read(two, 12) == b"bannersecond"
        assert house.carried == 1
        big = secrets.token_bytes(300_000)
        say_one.write(big)
        assert await read(one, len(big)) == big
        assert house.robot.asked == [("robotic", ECHO), ("robotic", BIG)]
        say_one.close()
        await until(lambda: house.robot.lines[0].gone)
        assert not house.robot.lines[1].gone
        ports.close()
        await until(lambda: over and house.over)
        assert (over, house.over) == ([LeaseEnding.CLOSED], [("robotic", LeaseEnding.CLOSED)])
        assert house.robot.lines[1].gone
        assert await two.read() == b""
        with pytest.raises(OSError, match=r"."):
            await asyncio.open_connection(host, ECHO)
        say_two.close()

    in_house(scenario, tmp_path)


def test_what_the_port_closes_is_closed_and_the_lease_goes_on(tmp_path):
    async def scenario(house):
        _, host, over = await house.program(house.rig.agent())
        for _ in range(40):  # numbers of lines are used again
            reader, writer = await asyncio.open_connection(host, ECHO)
            writer.write(b"quit")
            assert await reader.read(-1) == b"bannerquit"
            writer.close()
        assert over == []

    in_house(scenario, tmp_path)


def test_a_shut_port_refuses_one_connection_only(tmp_path):
    async def scenario(house):
        _, host, over = await house.program(house.rig.agent())
        reader, writer = await asyncio.open_connection(host, SHUT)
        assert await reader.read() == b""
        writer.close()
        assert [text.partition(":")[0] for text in house.told] == ["NOT_GRANTED"], "and why it is shut is told"
        again, say = await asyncio.open_connection(host, ECHO)
        assert await read(again, 6) == b"banner"
        say.close()
        assert over == []

    in_house(scenario, tmp_path)


def test_what_a_line_tells_comes_beside_the_connection(tmp_path):
    async def scenario(house):
        _, host, over = await house.program(house.rig.agent())
        reader, writer = await asyncio.open_connection(host, ECHO)
        assert await read(reader, 6) == b"banner"
        writer.write(b"why")
        assert await read(reader, 3) == b"why", "the connection has what it had"
        await until(lambda: house.told)
        assert house.told == ["BUSY: so it is"]
        writer.close()
        assert over == []

    in_house(scenario, tmp_path)


def test_a_reason_that_is_not_known_is_told_as_it_is(tmp_path, monkeypatch):
    """A younger gateway may have more of them."""
    monkeypatch.setattr("ztpm.program.program_ports.Reason", StrEnum("Reason", ["BUSY"]))

    async def scenario(house):
        _, host, _ = await house.program(house.rig.agent())
        reader, writer = await asyncio.open_connection(host, SHUT)
        assert await reader.read() == b""
        writer.close()
        assert house.told == ["NOT_GRANTED"]

    in_house(scenario, tmp_path)


def test_another_users_process_gets_nothing(tmp_path):
    async def scenario(house):
        _, host, _ = await house.program(house.rig.agent(), user=OWN + 1)
        reader, writer = await asyncio.open_connection(host, ECHO)
        with contextlib.suppress(ConnectionResetError):
            assert await reader.read() == b""
        writer.close()
        assert house.robot.asked == []

    in_house(scenario, tmp_path)


def test_who_is_at_the_other_end():
    with socket.create_server((HOST, 0)) as server:
        client = socket.create_connection(server.getsockname())
        accepted, _ = server.accept()
        with client, accepted:
            assert user_of(accepted) == user_of(client) == OWN
        assert user_of(accepted) is None
    first, second = socket.socketpair()
    with first, second:
        assert user_of(first) is None


def test_who_does_not_read_loses_whole_words_and_holds_up_nobody(tmp_path):
    async def scenario(house):
        _, host, over = await house.program(house.rig.agent())
        other, say = await asyncio.open_connection(host, BIG)
        deaf = socket.create_connection((host, ECHO))
        await until(lambda: len(house.robot.lines) == 2)
        (line,) = [each for each in house.robot.lines if each is not house.robot.lines[0]]
        word = bytes(4_000)
        for _ in range(8 * UNREAD_BYTES // len(word)):
            line.back.send(word)
            await asyncio.sleep(0)
        say.write(b"still here")
        assert await read(other, 16) == b"bannerstill here"
        deaf.setblocking(False)
        got, loop = 0, asyncio.get_running_loop()
        with contextlib.suppress(TimeoutError):
            while True:
                got += len(await asyncio.wait_for(loop.sock_recv(deaf, 1 << 20), 0.5))
        assert (got - len(b"banner")) % len(word) == 0
        assert got < 7 * UNREAD_BYTES
        deaf.close()
        say.close()
        assert over == []

    in_house(scenario, tmp_path)


# ---- its end


def test_the_gateways_end_is_the_programs(tmp_path):
    async def scenario(house):
        _, host, over = await house.program(house.rig.agent())
        reader, writer = await asyncio.open_connection(host, ECHO)
        await read(reader, 6)
        house.port.end(LeaseEnding.AUTHORITY)
        assert house.over == [("robotic", LeaseEnding.AUTHORITY)]
        await until(lambda: over)
        assert await reader.read() == b""
        writer.close()
        await house.lease(house.rig.agent())  # the robot is free again

    in_house(scenario, tmp_path)


def test_a_line_that_breaks_at_the_end_keeps_no_other_from_it(tmp_path):
    async def scenario(house):
        _, host, _ = await house.program(house.rig.agent())
        links = [await asyncio.open_connection(host, ECHO) for _ in range(3)]
        for reader, _ in links:
            await read(reader, 6)
        broken = house.robot.lines[1]
        broken.left = {}.__getitem__  # raises
        with contextlib.suppress(TypeError):
            house.port.end(LeaseEnding.AUTHORITY)
        assert house.over == [("robotic", LeaseEnding.AUTHORITY)]
        assert [line.gone for line in house.robot.lines] == [True, False, True]
        for _, writer in links:
            writer.close()

    in_house(scenario, tmp_path)


class Bare:
    """A program's end made by hand, to say what none would say."""

    def __init__(self, house, lease_id, opened):
        self.house, self.id, self.session = house, lease_id, opened

    async def __aenter__(self):
        self.reader, self.writer = await asyncio.open_connection(*self.house.address)
        self.writer.write(self.id)
        return self

    async def __aexit__(self, *_):
        self.writer.close()

    def frame(self, word):
        return delimited(self.session.seal(encode(word), at=self.house.rig.clock.wall_s()))

    async def words(self, wanted):
        cutter, found = SessionFrameSplitter(), []
        async with asyncio.timeout(10):
            while wanted not in found:
                for frame in cutter.feed(await self.reader.read(65_536)):
                    found.append(decode(self.session.open(frame, at=self.house.rig.clock.wall_s()).body))
        return found


def flipped(frame):
    return frame[:-1] + bytes([frame[-1] ^ 1])


@pytest.mark.parametrize(
    "said",
    [
        lambda bare: flipped(bare.frame(Beat())),
        lambda bare: (bare.frame(Beat()), bare.frame(Beat()))[1],  # one is missing
        lambda bare: bare.frame(Beat())[:4] + bytes(43),
        lambda bare: b"\xff" * 8,
        lambda bare: bare.frame(Bytes(3, b"x")),  # a line that is not open
        lambda bare: bare.frame(Opened(3)),
        lambda bare: bare.frame(RefusalNotice(7, "BUSY: said I")),  # the gateway's word
        lambda bare: b"".join(bare.frame(Open(n, ECHO)) for n in range(17)),
        lambda bare: (lambda frame: frame + frame)(bare.frame(Beat())),
    ],
)
def test_what_no_program_says_ends_the_lease(tmp_path, said):
    async def scenario(house):
        async with Bare(house, *await house.lease(house.rig.agent())) as bare:
            bare.writer.write(bare.frame(Open(7, ECHO)))
            await bare.words(Opened(7))
            bare.writer.write(said(bare))
            await until(lambda: house.over)
            assert house.over == [("robotic", LeaseEnding.MALFORMED)]
            assert house.robot.lines[0].gone
            assert house.leases.current is None

    in_house(scenario, tmp_path)


def test_a_cut_connection_ends_it_at_once(tmp_path):
    async def scenario(house):
        async with Bare(house, *await house.lease(house.rig.agent())) as bare:
            bare.writer.write(bare.frame(Open(7, ECHO)))
            await bare.words(Opened(7))
        await until(lambda: house.over)
        assert house.over == [("robotic", LeaseEnding.CUT)]
        assert house.robot.lines[0].gone

    in_house(scenario, tmp_path)


def test_a_silent_program_loses_it(tmp_path):
    async def scenario(house):
        async with Bare(house, *await house.lease(house.rig.agent())) as bare:
            began = time.monotonic()
            bare.writer.write(bare.frame(Open(7, ECHO)))
            await until(lambda: house.over)
            assert house.over == [("robotic", LeaseEnding.SILENT)]
            assert 1.5 <= time.monotonic() - began < 4.0

    in_house(scenario, tmp_path)


def test_a_program_whose_gateway_is_silent_ends_too(tmp_path):
    async def scenario(house):
        deaf = await asyncio.start_server(lambda r, w: None, HOST, 0)
        lease_id, opened = await house.lease(house.rig.agent())
        over = []
        ports = ProgramPorts(opened, lease_id, clock=house.rig.clock, user=OWN, ended=over.append, told=over.append)
        await ports.begin(gateway=deaf.sockets[0].getsockname(), host=HOST, ports=())
        await until(lambda: over)
        assert over == [LeaseEnding.SILENT]
        deaf.close()

    in_house(scenario, tmp_path)


@pytest.mark.parametrize("said", [b"", b"x", b"sixteen bytes of", bytes(4_000)])
def test_who_names_no_lease_is_left_without_a_word(tmp_path, said):
    async def scenario(house):
        await house.lease(house.rig.agent())
        reader, writer = await asyncio.open_connection(*house.address)
        writer.write(said)
        with contextlib.suppress(ConnectionResetError):
            assert await reader.read() == b""
        writer.close()
        assert house.leases.current is not None
        assert house.over == []

    in_house(scenario, tmp_path)


def test_a_second_carriage_of_a_lease_is_none(tmp_path):
    async def scenario(house):
        lease_id, opened = await house.lease(house.rig.agent())
        async with Bare(house, lease_id, opened) as bare:
            bare.writer.write(bare.frame(Open(7, ECHO)))
            await bare.words(Opened(7))
            reader, writer = await asyncio.open_connection(*house.address)
            writer.write(lease_id)
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
            writer.close()
            assert house.over == []

    in_house(scenario, tmp_path)
