"""Enforcement point of a cell: clock, journal, feeds, authority, and a door.

A point with a robot, people and physics is built on it (`ztpm.point.robot_point`). Nothing here loads physics.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import os
import signal
import sys
import traceback
from typing import TYPE_CHECKING, Any, Final, TypedDict

from capabilities.proof.freshness import Memory, earliest_iat_s, retention_ms
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.clock import HeldClock, SystemClock, TimeMark
from pep.base.errors import ConfigError, PepError, PepFault
from pep.journal.file_journal import FileJournal
from pep.journal.replay_cache import ReplayCache
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile
from pep.provider.journal_shipper import JournalShipper
from pep.request.authority import Authority
from ztpm.base.incidents import Incidents
from ztpm.base.report_server import serve_reports, view_of
from ztpm.codes.code_table import FAILURE, status_of
from ztpm.codes.unavailable import UnavailableError, line_of, unavailable
from ztpm.edge.places import Bounds
from ztpm.edge.rare_log import tell_rarely
from ztpm.edge.server import EdgeServer
from ztpm.point.point_config import read_key, read_policies, read_trust
from ztpm.point.trust_mark import check_mark
from ztpm_idp.client import direct_http

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator
    from pathlib import Path

    import httpx2

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from pep.request.edge import Edge
    from policies.decision.policy import PolicySet
    from ztpm.point.point_config import PointConfig

FIRST_VIEW_S: Final = 30.0
"""Longest wait for the first verified view before it listens anyway, denying everything until it comes."""
SHUTDOWN_S: Final = 3
SWITCH_S: Final = 0.001
ACCEPTED: Final = frozenset({"decision", "ticket"})
"""Kinds of records that name a proof which had an effect."""


class EnforcementInputs(TypedDict):
    """Inputs of an enforcement point besides its configuration: read, verified and in force."""

    trust: TrustBundle
    key: PrivateKey
    policies: PolicySet
    http: httpx2.AsyncClient


def opened(config: PointConfig) -> EnforcementInputs:
    """Inputs that the configuration names.

    Raises:
        PepError: one of them cannot be had, or must not be believed.
    """
    policies, trust, key = read_policies(config), read_trust(config), read_key(config)
    check_mark(trust, config.state_dir / "trust.json", at=SystemClock().wall_s(), caps=CAPS)
    return EnforcementInputs(trust=trust, key=key, policies=policies, http=direct_http.async_client())


class _Server(EdgeServer):
    """A server that leaves signals to the composition: the arm is stopped before anything else ends."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """No signal is captured here."""
        yield


class EnforcementPoint:
    """Parts that every enforcement point of a cell has, composed.

    Args:
        config: of it.
        trust: the issuer's public keys.
        key: of this PEP.
        http: client of the identity provider.

    Attributes:
        ended: set it to end the process.
        app: app behind its door; made by the subclass.
        bounds: most connections of callers.
    """

    app: Any
    bounds = Bounds()

    def __init__(self, config: PointConfig, *, trust: TrustBundle, key: PrivateKey, http: httpx2.AsyncClient) -> None:
        self.config = config
        # Proofs, tokens and statements are judged by a wall time that nobody can set back.
        self.clock = HeldClock(SystemClock(), mark=TimeMark(config.state_dir / "time.json"), skew_s=CAPS.skew_s)
        # Rounded up: a proof counts whole seconds, and one made before the start must not pass for one made after it.
        self.started_s = earliest_iat_s(self.clock.wall_s(), memory=Memory.KEPT, caps=CAPS)
        self.journal = FileJournal.open(config.journal_file, pep_id=config.pep_id, clock=self.clock)
        self.http = http
        self.ended = asyncio.Event()
        self.incidents = Incidents(self.clock)
        self.follower = ProviderFollower(
            self.http,
            issuer=config.issuer,
            key=key,
            audience=config.audience,
            trust=trust,
            caps=CAPS,
            clock=self.clock,
            mark=FeedMarkFile(config.state_dir / "feed.json"),
            incident=self._feed_incident,
        )
        self.shipper = JournalShipper(
            self.journal,
            self.http,
            issuer=config.issuer,
            key=key,
            clock=self.clock,
            incident=lambda error: self.incidents.tell("ledger", error),
        )
        self.replay = ReplayCache(self.clock)
        self.authority = Authority(
            verifier=Verifier(trust, CAPS),
            feed=self.follower,
            replay=self.replay,
            clock=self.clock,
            caps=CAPS,
            audience=config.audience,
            started_s=self.started_s,
        )

    @property
    def edge(self) -> Edge:
        """Leases and records; the gate in a subclass that has one."""
        raise NotImplementedError

    def recover(self) -> None:
        """Remembers proofs that an earlier process accepted, and records a torn journal."""
        earliest_ms = (self.clock.wall_s() * 1000) - retention_ms(CAPS)
        expires_ms = self.clock.monotonic_ms() + retention_ms(CAPS)
        for record in self.journal.records():
            if record["kind"] in ACCEPTED and record["at_ms"] >= earliest_ms and record["body"]["proof"]:
                self.replay.remember(bytes.fromhex(record["body"]["proof"]), expires_ms=expires_ms)
        if self.journal.repaired_bytes:
            self.journal.append("incident", {"what": "torn-tail", "bytes": self.journal.repaired_bytes})

    async def run(self, *, reports: bool = False) -> None:
        """Serves until told to end, with nothing moving afterwards; `reports`: answers for reports."""
        loop = asyncio.get_running_loop()
        server = _Server(
            self.app,
            host=self.config.host,
            port=self.config.port,
            bounds=self.bounds,
            log_level="error",
            timeout_graceful_shutdown=SHUTDOWN_S,
        )
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.ended.set)
        parts = self.beside()
        if reports:
            parts["reports"] = serve_reports(self.report)
        tasks = [self.incidents.watched(what, part) for what, part in parts.items()]
        try:
            await self._first_view()
            await self.listen()
            await self.begin()
            serving = asyncio.create_task(server.serve())
            while not server.started and not serving.done():  # noqa: ASYNC110 - uvicorn offers no event for it
                await asyncio.sleep(0.01)
            if server.started:
                gc.collect()
                gc.freeze()  # else each full collection looks at all that was built at start, while an arm moves
                sys.stdout.write(json.dumps({"ready": True, "audience": self.config.audience}) + "\n")
                sys.stdout.flush()
            await asyncio.wait({serving, asyncio.create_task(self.ended.wait())}, return_when=asyncio.FIRST_COMPLETED)
            await self.stand()
            server.should_exit = True
            await serving
        finally:
            await self.close()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with contextlib.suppress(OSError):  # the last mark is at most a period old
                await asyncio.to_thread(self.clock.keep)
            await self.release()
            self.edge.close()
            await self.http.aclose()
            self.journal.close()

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as it serves, by name."""
        keeping = self.clock.run(
            failed=lambda error: self.incidents.tell("clock", error), set_back=self._clock_incident
        )
        return {"feed": self.follower.run(), "ledger": self.shipper.run(), "clock": keeping}

    async def report(self) -> dict[str, object]:
        """Report for the process that started it."""
        return {"view": view_of(self.follower)}

    async def listen(self) -> None:
        """Receives first all that must be known before it serves: the first verified views are there."""

    async def begin(self) -> None:
        """Opens further services beside the door."""

    async def stand(self) -> None:
        """Stops every motion."""

    async def close(self) -> None:
        """Ends the parts composed beside these, with nothing moving."""

    async def release(self) -> None:
        """Releases inputs, after everything else has ended and before the last record is written."""

    async def _first_view(self) -> None:
        """Waits until the first verified views are there and present proofs are accepted, or for long enough."""
        deadline_ms = self.clock.monotonic_ms() + int(FIRST_VIEW_S * 1000)
        while not self.ended.is_set() and self.clock.monotonic_ms() < deadline_ms:
            ages_ms = self.follower.view().age_ms, self.follower.conduct().age_ms
            if max(ages_ms) < FIRST_VIEW_S * 1000 and self.clock.wall_s() >= self.started_s:
                return
            await asyncio.sleep(0.02)

    # -- incidents beside requests

    def _feed_incident(self, error: PepError) -> None:
        """Records a refused answer; an unreachable provider is only told."""
        self.incidents.tell("feed", error)
        if error.code is not PepFault.FEED_UNREACHABLE and self.incidents.first("record", error.code):
            self._note({"what": "feed", "fault": str(error.code), "detail": error.detail})

    def _clock_incident(self, held_s: float) -> None:
        self._note({"what": "clock", "fault": str(PepFault.CLOCK_SET_BACK), "held_s": int(held_s)})

    def _note(self, body: dict[str, object]) -> None:
        self.incidents.watched("journal", self.edge.record("incident", body))


def main_of(serve: Callable[[], Coroutine[None, None, None]], *, config: Path) -> None:
    """Process of an enforcement point: it serves, and ends with the exit status of its end.

    Args:
        serve: its work.
        config: file of its configuration, for a person who has to mend it.
    """
    # The watch looks every few ms: other threads hand the interpreter over within one (5 by default).
    sys.setswitchinterval(SWITCH_S)
    # Before MCPServer does, which would hide our warnings; its own, about strangers' input, stay hidden.
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s %(message)s")
    logging.getLogger("mcp").setLevel(logging.ERROR)
    tell_rarely()
    status = FAILURE
    try:
        asyncio.run(serve())
        status = 0
    except ConfigError as error:
        status = _told(error.code, f"{config}: {error.detail}")
    except PepError as error:
        status = _told(error.code, error.detail)
    except UnavailableError as error:
        status = _told(error.code, error.sentence)
    except OSError as error:
        told = unavailable(error)
        status = _told(told.code, told.sentence)
    except Exception:  # noqa: BLE001 - any error ends the process, which tells it where its output is still read
        with contextlib.suppress(OSError):
            traceback.print_exc()
    finally:
        # A thread inside ur_rtde that still waits for a controller that is gone would be joined for ever; and the
        # reader of our output may be gone, too.
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(status)


def _told(code: str, sentence: str) -> int:
    """Tells a person; the exit status."""
    with contextlib.suppress(OSError):
        sys.stderr.write(f"{line_of(code, sentence)}\n")
    return status_of(code)
