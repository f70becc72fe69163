"""AgentDojo's tools as declared functions, and its arguments in our form and back."""

from __future__ import annotations

import asyncio
import tomllib
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.units import ListOf, Sort
from pep.base.declaration import ROW, row_from_toml

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from capabilities.values.units import Kind
    from evaluation.dojo.suites import Tool, WantedCall
    from pep.base.operation_row import Operation

WEB: Final = "https://"
"""Beginning of a web page's URL, which AgentDojo leaves out and ignores."""
TEXT: Final = "text"
"""Member that holds a text which is a free value."""


def rows() -> dict[str, Operation]:
    """The declared rows, by the name of the tool."""
    text = files("evaluation.dojo").joinpath("tools.toml").read_text(encoding="utf-8")
    return {name: row_from_toml(name, table) for name, table in tomllib.loads(text)["tool"].items()}


def function_of(row: Operation, tool: Tool, run: Callable[[str, Mapping[str, Any]], str | None]) -> Callable[..., Any]:
    """A declared function that runs the tool with the decided arguments; its result is the tool's error.

    Args:
        row: of the tool.
        tool: AgentDojo's.
        run: runs the tool of that name.
    """

    async def function(**decided: Any) -> str | None:
        return await asyncio.to_thread(run, row.name, theirs(row, tool, decided))

    function.__name__ = row.name
    function.__doc__ = tool.text
    setattr(function, ROW, row)
    return function


def ours(row: Operation, wanted: WantedCall) -> dict[str, Any]:
    """Arguments of a call in the form of its row; an unknown one stays, and is refused.

    Args:
        row: of the called tool.
        wanted: in AgentDojo's form.
    """
    kinds = _kinds(row)
    given = {name: value for name, value in wanted.arguments.items() if name not in kinds}
    return given | {name: _ours(kind, wanted.arguments.get(name)) for name, kind in kinds.items()}


def theirs(row: Operation, tool: Tool, decided: Mapping[str, Any]) -> dict[str, Any]:
    """Decided arguments in AgentDojo's form: what may be null is null where it is empty, 0 or false.

    Args:
        row: of the tool.
        tool: AgentDojo's.
        decided: by the gate.
    """
    kinds = _kinds(row)
    made = {name: _theirs(kinds[name], value, whole=name in tool.texts) for name, value in decided.items()}
    return {name: (value or None) if name in tool.optional else value for name, value in made.items()}


def _kinds(row: Operation) -> dict[str, Kind]:
    return {argument.name: limits[0].parameter.kind for argument, limits in row.stated()}


def _ours(kind: Kind, value: Any) -> Any:
    match kind:
        case ListOf():
            return value.split("\n") if isinstance(value, str) else [] if value is None else value
        case Sort.FREE:
            return {TEXT: value} if isinstance(value, str) else value
        case Sort.FLAG:
            return value is True if value is None else value
        case Sort.PATH:
            return f"/{value}"
        case Sort.URL:
            return value if str(value).startswith(WEB) else f"{WEB}{value}"
        case Sort.TEXT:
            return "" if value is None else value
        case _:
            return 0 if value is None else value


def _theirs(kind: Kind, value: Any, *, whole: bool) -> Any:
    match kind:
        case ListOf():
            return "\n".join(value) if whole else value
        case Sort.FREE:
            return value[TEXT] if isinstance(value, dict) else value
        case Sort.PATH:
            return value.removeprefix("/")
        case _:
            return value
