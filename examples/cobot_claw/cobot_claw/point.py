"""The admission point of the four agents, with the guarded tools of the Config agent beside it.

    python -m cobot_claw.point --config point.toml

The host of an agent asks here before anything reaches its model: a person's intent (e1), another agent's message
(e2), documents and memory (e3). Each question is an HTTP request under the agent's own token and proof, to
`/context/...` of the point's origin; the answer is the admitted value with its receipt, or the reason why there is
none. The same process guards the Config agent's tools (e4), so what entered a context is known where it acts.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import uvicorn
from mcp.server.mcpserver.exceptions import ToolError

from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from cobot_claw.depth import enclosing
from cobot_claw.telemetry import traced, within_trace
from cobot_claw.words import FORMS
from pep.base.errors import ConfigError, PepError, PepFault
from pep.context.stores.sqlite import HighWaterMarkFile, MemoryFile
from pep.perception.receiver import FrameReceiver
from pep.perception.sensor_frames import Distrusted, Frames, Unseen
from pep.point.admission_server import AdmissionServer
from pep.point.guard_config import GuardConfig
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mcp.server import MCPServer

    from capabilities.statements.observation import Shape
    from pep.request.authority import Credentials

CAMERA: Final = "claw-camera"
"""Registered id of the camera for this point."""
FRESH_MS: Final = 500
"""Oldest frame that is a view, as for facts of sensors (docs/guard.md)."""


@dataclass(frozen=True, slots=True)
class PointConfig:
    """`point.toml`: that of a guard, in its own file, and whose word counts.

    Attributes:
        guard: path of `guard.toml`.
        people, curators: raw public key, in hex, by id.
        store: directory of ChromaDB, with the signed manifest of each collection; "" for no retrieval.
        answering: raw public key of the gateway that vouches for the arm's tools, by its audience.
        perception_port: where the camera's frames come in; 0 for no camera.
    """

    guard: Path
    people: Mapping[str, bytes]
    curators: Mapping[str, bytes]
    store: str = ""
    perception_port: int = 0
    answering: Mapping[str, bytes] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> PointConfig:
        """The configuration of a file; paths begin at its folder."""
        given = tomllib.loads(path.read_text("utf-8"))

        def keys(name: str) -> dict[str, bytes]:
            return {id_: bytes.fromhex(raw) for id_, raw in given.get(name, {}).items()}

        store = given.get("store", "")
        return cls(
            path.parent / given["guard"],
            keys("people"),
            keys("curators"),
            str(path.parent / store) if store else "",
            given.get("perception_port", 0),
            keys("answering"),
        )


class ClawPoint(AdmissionServer):
    """The guarded tool server, the gate of admission beside it, and the camera's view.

    Args:
        server: of the tools.
        guard: of the guard.
        config: of the rest.
    """

    def __init__(self, server: MCPServer[Any], guard: GuardConfig, config: PointConfig) -> None:
        super().__init__(
            server,
            guard,
            people=config.people,
            curators=config.curators,
            forms=FORMS,
            memory=MemoryFile(guard.folder / "memory.sqlite"),
            marks=HighWaterMarkFile(guard.folder / "marks.json"),
            answering=config.answering,
        )
        self._perception_port = config.perception_port
        self._frames = Frames(sensors=self.follower, named=frozenset({CAMERA}), clock=self.clock, caps=CAPS)
        self._receiver = FrameReceiver(self._frames, clock=self.clock, incident=self._frame_incident)
        if config.store:
            from cobot_claw.knowledge import collections_at

            for content, collection in collections_at(Path(config.store)).items():
                manifest = (Path(config.store) / f"{content}.jws").read_text("ascii")
                if fault := self.curate(collection.name, content, collection.store, manifest):
                    raise ConfigError(PepFault.CONFIG_INVALID, f"{content}.jws: {fault.code}")

    async def declare(self) -> None:
        """Lets the declared tools be called, and hears the camera."""
        await super().declare()
        if self._perception_port:
            await self._receiver.listen(urlsplit(self.config.audience).hostname or "127.0.0.1", self._perception_port)

    async def release(self) -> None:
        """Ends the reception, and releases everything."""
        await self._receiver.close()
        await super().release()

    def view(self) -> dict[str, Any]:
        """View of the camera by its newest frame: signed by the registered key, in order, fresh (CII-4's recipe).

        Raises:
            ToolError: the newest frame must not be believed, is too old, or there is none.
        """
        seen, now_ms = self._frames.view(), self.clock.monotonic_ms()
        if isinstance(seen, Distrusted):
            raise ToolError(f"PERCEPTION_INVALID: {seen.rejected.fault}. Nothing is seen.")
        if isinstance(seen, Unseen):
            raise ToolError("PERCEPTION_MISSING: no frame has come. Nothing is seen.")
        (frame,) = seen.frames
        age_ms = frame.age_ms(now_ms)
        if not age_ms <= FRESH_MS:
            raise ToolError(f"PERCEPTION_STALE: the newest frame is {age_ms} ms old. Nothing is seen.")
        scene = frame.observation
        people = [{"id": each.id, **_middle([s for _, s in each.regions])} for each in scene.people]
        objects = [{"id": each.id, "kind": each.kind, **_middle([each.shape])} for each in scene.objects]
        return {"age_ms": age_ms, "people": people, "objects": objects}

    async def answer(
        self, name: str, credentials: Credentials, question: dict[str, Any], headers: Mapping[str, str]
    ) -> dict[str, object]:
        """Answer to a question, with a span in the trace of the agent that asks."""
        assert isinstance(credentials.chain, Chain)
        with within_trace(headers), traced(f"admit {name}", agent=credentials.chain.leaf.agent) as span:
            answer = await super().answer(name, credentials, question, headers)
            span.set_attribute("ztpm.reason", str(answer.get("reason", Reason.PERMITTED)))
            return answer


def _middle(shapes: Sequence[Shape]) -> dict[str, float]:
    """Middle and top of some shapes, m in the base frame."""
    low, high = enclosing(shapes)
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    return {"x_m": round(x, 4), "y_m": round(y, 4), "z_m": round(z, 4), "top_m": round(high[2], 4)}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m cobot_claw.point", description=__doc__)
    parser.add_argument("--config", required=True, type=Path)
    options = parser.parse_args()
    from cobot_claw.config_tools import Profile, config_server
    from cobot_claw.telemetry import begin

    try:
        config = PointConfig.read(options.config)
        guard = GuardConfig.read(config.guard)
    except (OSError, ValueError, KeyError, AttributeError, TypeError, PepError) as error:
        parser.exit(2, f"CONFIG_INVALID: {options.config}: {type(error).__name__}: {error}\n")
    begin("point", guard.folder / "spans.ndjson")
    point: ClawPoint | None = None

    def view() -> dict[str, Any]:
        assert point is not None
        return point.view()

    profile = Profile(guard.folder / "profile.json")
    point = ClawPoint(config_server(profile, view), guard, config)
    parts = urlsplit(guard.audience)
    serve(point, host=parts.hostname or "127.0.0.1", port=parts.port or 80)


def serve(app: Any, *, host: str, port: int) -> None:
    """Serves until SIGINT or SIGTERM, and says on standard output when it is ready."""

    class Told(uvicorn.Server):
        async def startup(self, sockets: Any = None) -> None:
            await super().startup(sockets)
            if self.started:
                print(json.dumps({"ready": True}), flush=True)

    settings = uvicorn.Config(
        app, host=host, port=port, loop="asyncio", ws="none", log_level="warning", access_log=False, server_header=False
    )
    Told(settings).run()


if __name__ == "__main__":
    main()
