"""Program in a lease: a real gateway's door over HTTP, a real process, and every end of either."""

import asyncio
import contextlib
import os
import secrets
import signal
import sys

import pytest
import uvicorn
from pep.base.clock import SystemClock
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.robot.connections import PORTS
from policies.words.reason_table import REASONS, Reason
from tests.pep.kit import AUDIENCE, HOST, PORT, Rig, full_scope
from tests.pep.rtde.lease.test_lease import ECHO, URL, House, Robot, drawn, until
from ztpm.base.loopback import free_host, is_free
from ztpm.program import lease_renewal
from ztpm.program.lease_renewal import LeaseRenewal
from ztpm.program.program_lease import PLACE, VARIABLE, LeaseError, Place, begin_lease, lend, open_lease

from capabilities.keys import keys
from ztpm_idp.client import ClientError

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(60)]

ASKS = f"""
import os, socket, sys, time
assert os.environ["{VARIABLE}"] == sys.argv[1]
link = socket.create_connection((sys.argv[1], {ECHO}))
assert link.recv(6) == b"banner"
link.sendall(b"hello")
assert link.recv(5) == b"hello"
print("heard", flush=True)
"""
STAYS = ASKS + "assert link.recv(1) == b''\nprint('gone', flush=True)\ntime.sleep(float(sys.argv[2]))\nsys.exit(7)\n"


class Served:
    """A house whose door is served over HTTP."""

    def __init__(self, rig):
        self.house = House(rig, Robot())

    async def __aenter__(self):
        await self.house.__aenter__()
        # The port that the door tells is the one that the carriages come to.
        object.__setattr__(self.house.door, "port", self.house.address[1])
        config = uvicorn.Config(self.house.door.app(), host=HOST, port=PORT, log_level="error", lifespan="off")
        self.server = uvicorn.Server(config)
        self.server.capture_signals = contextlib.nullcontext
        self.serving = asyncio.create_task(self.server.serve())
        await until(lambda: self.server.started)
        return self

    async def __aexit__(self, *_):
        self.server.should_exit = True
        await self.serving
        await self.house.__aexit__()

    async def lease(self, holder=None, *, gateway_key=None):
        holder = holder or self.house.rig.agent()
        place = Place(URL, AUDIENCE, gateway_key or keys.public_raw(self.house.signer))
        return await asyncio.to_thread(open_lease, URL, holder.text, begin_lease(place, holder.text, holder.key))


def served(scenario, tmp_path):
    async def inside():
        async with asyncio.timeout(40), Served(Rig(tmp_path, SystemClock())) as door:
            return await scenario(door)

    return asyncio.run(inside())


def program(text, *arguments):
    return [sys.executable, "-c", text, PLACE, *arguments]


def vacant(host):
    return all(is_free(host, port) for port in PORTS)


class Tokens:
    """Tokens of a mandate, the last one again and again; what is no text is raised."""

    def __init__(self, *texts):
        self.texts = list(texts)

    def token(self):
        text = self.texts.pop(0) if len(self.texts) > 1 else self.texts[0]
        if isinstance(text, Exception):
            raise text
        return text


def nothing():
    """Nobody waits for the ports."""


def unheard(text):
    """Nobody asks why."""


def test_a_program_finds_the_robot_and_its_status_is_told(tmp_path):
    async def scenario(door):
        host = free_host(secrets.token_bytes(16), vacant)
        ended = await lend(await door.lease(), host, program(ASKS), begun=nothing, told=unheard)
        assert (ended.early, ended.status) == (None, 0)
        ended = await lend(await door.lease(), host, program(ASKS + "sys.exit(5)"), begun=nothing, told=unheard)
        assert (ended.early, ended.status) == (None, 5)
        await until(lambda: len(door.house.over) == 2)
        assert {why for _, why in door.house.over} == {LeaseEnding.CLOSED}
        assert vacant(host)

    served(scenario, tmp_path)


def test_who_serves_until_a_signal_gives_the_lease_back_then(tmp_path):
    async def scenario(door):
        host, begun = free_host(secrets.token_bytes(16), vacant), asyncio.Event()
        serving = asyncio.create_task(lend(await door.lease(), host, [], begun=begun.set, told=unheard))
        await begun.wait()
        reader, writer = await asyncio.open_connection(host, ECHO)
        assert await reader.readexactly(6) == b"banner"
        os.kill(os.getpid(), signal.SIGTERM)
        ended = await serving
        assert (ended.early, ended.status) == (None, 0)
        assert await reader.read() == b""
        writer.close()

    served(scenario, tmp_path)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_goes_on_to_the_program_and_its_death_is_told(tmp_path, number):
    async def scenario(door):
        host, begun = free_host(secrets.token_bytes(16), vacant), asyncio.Event()
        waits = "import signal, sys, time; signal.signal(signal.SIGINT, signal.SIG_DFL); print(1, flush=True); time.sleep(60)"
        running = asyncio.create_task(lend(await door.lease(), host, program(waits), begun=begun.set, told=unheard))
        await begun.wait()
        await asyncio.sleep(0.5)  # it has said how it takes the signal
        os.kill(os.getpid(), number)
        ended = await running
        assert (ended.early, ended.status) == (None, 128 + number)

    served(scenario, tmp_path)


def test_a_lease_that_ends_first_closes_the_programs_connections_and_is_told(tmp_path):
    async def scenario(door):
        host = free_host(secrets.token_bytes(16), vacant)
        running = asyncio.create_task(
            lend(await door.lease(), host, program(STAYS, "0.2"), begun=nothing, told=unheard)
        )
        await until(lambda: any(line.heard == b"hello" for line in door.house.robot.lines))
        door.house.port.end(LeaseEnding.AUTHORITY)
        ended = await running
        assert (ended.early, ended.status) == (LeaseEnding.AUTHORITY, 7)

    served(scenario, tmp_path)


def test_no_lease(tmp_path):
    async def scenario(door):
        holder = door.house.rig.agent()
        with pytest.raises(LeaseError) as refused:
            await door.lease(gateway_key=keys.public_raw(keys.generate()))
        assert (refused.value.code, refused.value.refused) == ("PROOF_NOT_FOR_THIS_REQUEST", True)
        await door.lease(holder)
        with pytest.raises(LeaseError) as refused:
            await door.lease()
        assert (refused.value.code, refused.value.refused) == ("LEASE_HELD", True)
        row = REASONS[Reason.LEASE_HELD]
        assert row.text in refused.value.detail
        assert row.remedy in refused.value.detail

    served(scenario, tmp_path)


def says(said, *, status, told):
    return [(status, each, told) for each in said]


@pytest.mark.parametrize(
    ("status", "said", "told"),
    [
        *says(
            [b"", b"{}", b'{"reason":7}', b'{"reason":"\\u001b[2J"}', b'{"reason":"NO_SUCH"}'],
            status=409, told=("GATEWAY_FAILED", True),
        ),
        *says(
            [b"", b"[]", b"{}", b'{"lease":1}', b'{"lease":"00","session":"{}","port":1}', b"{" * 50],
            status=201, told=("GATEWAY_NOT_BELIEVED", False),
        ),
    ],
)  # fmt: skip
def test_an_answer_of_another_form_is_no_lease_and_a_reason_that_is_none_is_not_repeated(tmp_path, status, said, told):
    async def scenario(door):
        async def other(scope, receive, send):
            await send({"type": "http.response.start", "status": status, "headers": []})
            await send({"type": "http.response.body", "body": said})

        door.server.config.loaded_app = other
        with pytest.raises(LeaseError) as refused:
            await door.lease()
        assert (refused.value.code, refused.value.refused) == told

    served(scenario, tmp_path)


def test_nobody_there_is_told():
    place = Place(f"http://{HOST}:1/x", AUDIENCE, keys.public_raw(keys.generate()))
    with pytest.raises(LeaseError) as refused:
        open_lease(place.door, "a", begin_lease(place, "a", keys.generate()))
    assert (refused.value.code, refused.value.refused) == ("GATEWAY_UNREACHABLE", False)


# ---- renewed


@pytest.mark.clause("LSD-10")
def test_a_lease_is_renewed_while_its_program_works_and_outlives_its_first_token(tmp_path, monkeypatch):
    monkeypatch.setattr(lease_renewal, "LOOK_S", 0.05)

    async def scenario(door):
        rig = door.house.rig
        short = full_scope(rig.clock.wall_s(), lifetime_s=2)
        first = drawn(door.house, scope=short)
        second = drawn(door.house, first)
        leased, heard = await door.lease(first), []
        ends = door.house.leases.current.not_after
        tokens = Tokens(first.text, second.text)
        renewal = LeaseRenewal(leased, URL, first.key, tokens, first.text, told=heard.append)
        host, begun = free_host(secrets.token_bytes(16), vacant), asyncio.Event()
        running = asyncio.create_task(
            lend(leased, host, program(STAYS, "0"), begun=begun.set, told=unheard, kept=renewal.keep)
        )
        await begun.wait()
        await until(lambda: door.house.leases.current.not_after > ends)
        await until(lambda: rig.clock.wall_s() > ends + 0.6)  # beats of both ends went on beyond the first token
        assert door.house.leases.current is not None
        door.house.port.end(LeaseEnding.GATEWAY)
        ended = await running
        assert (ended.early, ended.status) == (LeaseEnding.GATEWAY, 7)
        assert heard == []
        renewed = [r["body"]["hop"] for r in rig.journal.records() if r["kind"] == "lease-renewed"]
        assert renewed == [second.hop_id], "each token once"

    served(scenario, tmp_path)


@pytest.mark.clause("LSD-10")
def test_a_renewal_that_fails_is_told_and_tried_again(tmp_path, monkeypatch):
    monkeypatch.setattr(lease_renewal, "LOOK_S", 0.01)
    monkeypatch.setattr(lease_renewal, "AGAIN_S", 0.01)

    async def scenario(door):
        first = drawn(door.house)
        foreign, second = drawn(door.house, first, mandate_id="cd" * 16), drawn(door.house, first)
        leased, heard = await door.lease(first), []
        no_more = ClientError("MANDATE_REVOKED", 403, "it is\x1b[2J over")
        tokens = Tokens(no_more, foreign.text, RuntimeError(), second.text)
        renewal = LeaseRenewal(leased, URL, first.key, tokens, first.text, told=heard.append)
        keeping = asyncio.create_task(renewal.keep())
        await until(lambda: door.house.leases.current.credentials.chain.leaf.hop_id == second.hop_id)
        keeping.cancel()
        revoked, differs, broken = heard
        assert revoked.startswith("MANDATE_REVOKED (403): it is?[2J")
        assert (
            differs
            == f"MANDATE_DIFFERS: {REASONS[Reason.MANDATE_DIFFERS].text} {REASONS[Reason.MANDATE_DIFFERS].remedy}"
        )
        assert broken == "RuntimeError"

    served(scenario, tmp_path)


@pytest.mark.clause("LSD-10")
@pytest.mark.parametrize("said", [b"", b"{}", b'{"not_after":true}', b'{"not_after":1}', b'{"not_after":99999999999}'])
def test_an_answer_of_another_form_renews_nothing_at_this_end(tmp_path, said):
    async def scenario(door):
        first = drawn(door.house)
        leased = await door.lease(first)

        async def other(scope, receive, send):
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": said})

        door.server.config.loaded_app = other
        tokens = Tokens(drawn(door.house, first).text)
        renewal = LeaseRenewal(leased, URL, first.key, tokens, first.text, told=unheard)
        with pytest.raises(LeaseError) as refused:
            await asyncio.to_thread(renewal.look)
        assert refused.value.code == "GATEWAY_NOT_BELIEVED"

    served(scenario, tmp_path)
