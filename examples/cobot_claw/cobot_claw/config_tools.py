"""Tools of the Config agent: the motion profile that the agents plan with. Its operations are declared beside them.

The profile is the application's own. It cannot widen anything: what the arm is, carries and may do stands in the cell
file that a person signs and in the tokens, and the gateway goes by these.
"""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from mcp.server import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pep import Free, Within, operation
from pep.base.declaration import declared

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.operation_row import Operation

PROFILE: Final = {
    "tool_centre_m": [0.0, 0.0, 0.174],
    "payload_kg": 0.9,
    "limits": {"joint": {"speed_rad_s": 0.5, "acceleration_rad_s2": 1.4}, "grip": {"force_n": 40.0}},
    "note": "Robotiq 2F-85 on the flange",
}
"""The profile of a new system: the tool point and weight of the shipped gripper."""
Metres = Annotated[float, Within(-300_000, 300_000, "um")]
Kilograms = Annotated[float, Within(0, 3_000, "g", scale=1_000, above={2_000: 2})]


class JointLimits(BaseModel):
    """Speed and acceleration that the agents plan with."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    speed_rad_s: float = Field(gt=0, le=1.05)
    acceleration_rad_s2: float = Field(gt=0, le=2.0)


class GripLimits(BaseModel):
    """Force that the agents plan with."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    force_n: float = Field(ge=20, le=100)


class Limits(BaseModel):
    """Nested limits of the profile."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    joint: JointLimits
    grip: GripLimits


class Profile:
    """The profile, in a file. Any thread.

    Args:
        path: of the file; a missing one is `PROFILE`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._held: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else dict(PROFILE)

    def get(self) -> dict[str, Any]:
        """The profile now."""
        with self._lock:
            return dict(self._held)

    def change(self, **members: Any) -> dict[str, Any]:
        """The profile with these members, once it is on disk."""
        with self._lock:
            changed = {**self._held, **members}
            beside = self._path.with_suffix(".new")
            beside.write_text(json.dumps(changed), "utf-8")
            os.replace(beside, self._path)  # noqa: PTH105 - one word for both
            self._held = changed
            return dict(changed)


def nothing_seen() -> dict[str, Any]:
    """The view of a server without a camera."""
    raise ToolError("PERCEPTION_MISSING: no camera is connected.")


def config_server(profile: Profile, view: Callable[[], dict[str, Any]] = nothing_seen) -> MCPServer[Any]:
    """An MCP server with the tools of the profile and the camera, not yet guarded.

    Args:
        profile: what the tools read and change.
        view: what the camera sees now.
    """
    server: MCPServer[Any] = MCPServer("claw-config", log_level="ERROR")

    @server.tool()
    @operation("profile", base_tier=0)
    def read_profile() -> dict[str, Any]:
        """Read the motion profile: tool centre point, payload, limits, note."""
        return profile.get()

    @server.tool()
    @operation("profile", base_tier=1)
    def set_tool_centre(x_m: Metres, y_m: Metres, z_m: Metres) -> dict[str, Any]:
        """Set the tool centre point of the profile, in metres from the flange."""
        return profile.change(tool_centre_m=[x_m, y_m, z_m])

    @server.tool()
    @operation("profile", base_tier=1)
    def set_payload(mass_kg: Kilograms, note: str) -> dict[str, Any]:
        """Set the payload of the profile in kilograms, with a note on what it is."""
        return profile.change(payload_kg=mass_kg, note=note)

    @server.tool()
    @operation("profile", base_tier=1)
    def set_limits(limits: Annotated[dict[str, Any], Free(1_024)]) -> dict[str, Any]:
        """Set the limits of the profile: {"joint": {"speed_rad_s", "acceleration_rad_s2"}, "grip": {"force_n"}}."""
        try:
            known = Limits.model_validate(limits)
        except ValidationError as error:
            where = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
            raise ToolError(f"Nothing was changed. {where}") from None
        return profile.change(limits=known.model_dump())

    @server.tool()
    @operation("camera", base_tier=0)
    def look() -> dict[str, Any]:
        """Look at the cell: people and objects with their middle in metres (base frame), and the picture's age."""
        return view()

    return server


def rows() -> dict[str, Operation]:
    """Operations of these tools, by name."""
    found = (declared(tool.fn) for tool in server._tool_manager.list_tools())  # noqa: SLF001 - no way outside a loop
    return {row.name: row for row in found if row is not None}


server = config_server(Profile(Path("profile.json")))
"""The server that a person looks at and registers (`ztpm mcp pin`)."""
