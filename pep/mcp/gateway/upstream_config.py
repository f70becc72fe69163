"""Configuration of one server behind a gateway: the table `[upstream.NAME]`, read strictly."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, Strict, StringConstraints, model_validator

TIMEOUT_S: Final = 60.0
"""Longest wait for a server's answer where none is stated; ours."""
TIMEOUT_MOST_S: Final = 3600.0
"""Ours: nothing waits for longer."""
SESSIONS: Final = 32
"""Ours: most connections to a URL beside the one of all, where no number is stated; a process has none."""
Variable = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
"""Name of an environment variable."""


class UpstreamConfig(BaseModel):
    """One table `[upstream.NAME]`.

    Attributes:
        name: of the server here.
        url: where it answers; "" for a process.
        command: of the process, with its arguments; empty for a URL.
        folder: working directory of the process.
        environment: names of the environment variables that the process gets besides the usual few.
        bearer: name of the environment variable with this gateway's own bearer token at the URL.
        prefix: put before the names of its tools and prompts.
        timeout_s: longest wait for an answer.
        sessions: most clients of the protocol before 2026-07-28 that have a connection, or process, of their own; None
            for the usual number.
        resources, prompts: whether its resources and prompts are for every holder of a live token.
        tasks: whether it may do an act as a task, which goes on after the permit that it was begun on.
        tool: declarations of its tools, by its own names; None where it guards itself, and all it has is passed on.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9-]{0,31}$")
    url: str = ""
    command: Annotated[tuple[str, ...], Strict(strict=False)] = ()
    folder: Annotated[Path, Strict(strict=False)] = Path()
    environment: Annotated[tuple[Variable, ...], Strict(strict=False)] = ()
    bearer: Variable | Literal[""] = ""
    prefix: str = Field(default="", pattern=r"^[A-Za-z0-9_.-]{0,32}$")
    timeout_s: float = Field(TIMEOUT_S, gt=0, le=TIMEOUT_MOST_S)
    sessions: Annotated[int, Field(ge=0, le=256)] | None = None
    resources: bool = False
    prompts: bool = False
    tasks: bool = False
    tool: dict[str, Any] | None = {}

    @model_validator(mode="after")
    def _reached(self) -> UpstreamConfig:
        if bool(self.url) == bool(self.command):
            raise ValueError("either url or command")
        if self.url:
            parts = urlsplit(self.url)
            if parts.scheme not in {"http", "https"} or not parts.hostname or parts.fragment or parts.username:
                raise ValueError("url: a URL of http or https, without a user")
        return self

    @property
    def most_sessions(self) -> int:
        """Most clients that have a connection of their own."""
        return self.sessions if self.sessions is not None else SESSIONS if self.url else 0
