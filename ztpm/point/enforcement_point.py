"""Enforcement point of a cell in a process of its own: the common parts, and a door.

A point with a robot, people and physics is built on it (`ztpm.point.robot_point`). Nothing here loads physics.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import sys
import traceback
from typing import TYPE_CHECKING, Any, Final

from capabilities import tracing
from pep.base.collector import spare_what_stands
from pep.base.errors import ConfigError, PepError
from pep.point.parts import PointParts
from ztpm.base.path_router import PathRouter
from ztpm.base.report_server import WHOLE, serve_reports, view_of
from ztpm.base.trace_export import exporting
from ztpm.codes.code_table import FAILURE, status_of
from ztpm.codes.unavailable import UnavailableError, line_of, unavailable
from ztpm.edge.log import tell
from ztpm.edge.places import Bounds
from ztpm.edge.server import EdgeServer
from ztpm.point.health import health

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
    from pathlib import Path

    from ztpm.point.point_config import PointConfig

SHUTDOWN_S: Final = 3
SWITCH_S: Final = 0.001


class _Server(EdgeServer):
    """A server that leaves signals to the composition: the arm is stopped before anything else ends."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """No signal is captured here."""
        yield


class EnforcementPoint(PointParts):
    """Parts of an enforcement point with a door, composed.

    Attributes:
        config: of it.
        app: app behind its door; made by the subclass.
        bounds: most connections of callers.
    """

    config: PointConfig
    app: Any
    bounds = Bounds()

    async def run(self, *, reports: bool = False) -> None:
        """Serves until told to end, with nothing moving afterwards; `reports`: answers for reports."""
        loop = asyncio.get_running_loop()
        told = health(lambda: self.follower.view().age_ms, lambda: self.edge.lease_ms(None))
        certificate, own = self.config.tls_certificate_file, self.config.tls_key_file
        server = _Server(
            PathRouter(self.app, told),
            host=self.config.host,
            port=self.config.port,
            bounds=self.bounds,
            ssl_certfile=None if certificate is None else str(certificate),
            ssl_keyfile=None if own is None else str(own),
            check_tls=self._check_tls,
            log_level="error",
            timeout_graceful_shutdown=SHUTDOWN_S,
        )
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.ended.set)
        parts = self.beside()
        if reports:
            parts["reports"] = serve_reports(self.answers)
        tasks = [self.incidents.watched(what, part) for what, part in parts.items()]
        try:
            await self.first_view()
            await self.listen()
            await self.begin()
            serving = asyncio.create_task(server.serve())
            while not server.started and not serving.done():  # noqa: ASYNC110 - uvicorn offers no event for it
                await asyncio.sleep(0.01)
            if server.started:
                spare_what_stands()
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
            await self.let_go()
            await self.release()

    def _check_tls(self) -> None:
        """Checks the certificate and its key, where the door speaks TLS itself, as they are now.

        Raises:
            ValueError: one of both is not safe to show; it names the setting.
        """
        certificate, own = self.config.tls_certificate_file, self.config.tls_key_file
        if certificate is None or own is None:
            return
        from ztpm_idp.keys.key_files import SettingsError
        from ztpm_idp.safe_files import check_tls_pair

        try:
            check_tls_pair(certificate, own, at=self.clock.wall_s())
        except SettingsError as error:
            raise ValueError(f"{error.setting}: {error.why}") from None

    @property
    def answers(self) -> Mapping[str, Callable[[], Awaitable[dict[str, object]]]]:
        """Answers for the process that started it, by name (ztpm/base/report_server.py)."""
        return {WHOLE: self.report}

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

    async def let_go(self) -> None:
        """Releases inputs, after everything else has ended and before the last record is written."""


def main_of(serve: Callable[[], Coroutine[None, None, None]], *, config: Path, service: str) -> None:
    """Process of an enforcement point: it serves, and ends with the exit status of its end.

    Args:
        serve: its work.
        config: file of its configuration, for a person who has to mend it.
        service: name of the process in its traces.
    """
    # The watch looks every few ms: other threads hand the interpreter over within one (5 by default).
    sys.setswitchinterval(SWITCH_S)
    # Before MCPServer does, which would hide our warnings; its own, about strangers' input, stay hidden.
    tell(sys.stderr, context=tracing.context)
    logging.getLogger("mcp").setLevel(logging.ERROR)
    status = FAILURE
    try:
        with exporting(service, os.environ):
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
