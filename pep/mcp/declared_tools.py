"""Tools of a server with their declared rows, compared before anything is served."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, cast

from mcp_types import Tool

from pep.base.declaration import declared
from pep.base.errors import DeclarationError, PepFault
from pep.base.operation_row import ArgumentForm
from pep.mcp import fastmcp_server

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pep.base.operation_row import Operation, ToolArgument
    from pep.mcp.fastmcp_server import FastMCPServer
    from pep.mcp.guard import AnyServer

SCHEMA_TYPES: Final[Mapping[ArgumentForm, str]] = {
    ArgumentForm.NUMBER: "number",
    ArgumentForm.INTEGER: "integer",
    ArgumentForm.VECTOR: "array",
    ArgumentForm.FLAG: "boolean",
}
"""Type that a tool's schema states for an argument of a form."""


async def decorated(server: AnyServer) -> dict[str, Operation]:
    """Rows of the server's functions that declare one, by the name of their tool; a low-level server has none."""
    if fastmcp_server.is_fastmcp(server):
        return await fastmcp_server.decorated(cast("FastMCPServer", server))
    table = getattr(server, "_tool_manager", None)
    tools = () if table is None else table.list_tools()
    return {tool.name: row for tool in tools if (row := declared(tool.fn)) is not None}


def rows_of(
    served: Iterable[Tool], *, decorated: Mapping[str, Operation], configured: Mapping[str, Operation]
) -> dict[str, Operation]:
    """The row of every served tool, by its name; each fits the tool's schema.

    Args:
        served: the tools, as a client sees them.
        decorated: rows of functions, by the name of their tool.
        configured: rows of a configuration, likewise.

    Raises:
        DeclarationError: `TOOL_TWICE`, `TOOL_UNDECLARED` or `TOOL_SCHEMA_DIFFERS`, naming the tool.
    """
    rows: dict[str, Operation] = {}
    for tool in served:
        if tool.name in rows or (tool.name in decorated and tool.name in configured):
            raise DeclarationError(PepFault.TOOL_TWICE, tool.name)
        row = decorated.get(tool.name) or configured.get(tool.name)
        if row is None:
            raise DeclarationError(PepFault.TOOL_UNDECLARED, tool.name)
        check_schema(row, tool)
        rows[tool.name] = replace(row, name=tool.name)
    for name in configured:
        if name not in rows:
            raise DeclarationError(PepFault.TOOL_UNKNOWN, f"{name}: the server has no such tool")
    return rows


def definition_of(row: Operation, description: str) -> Tool:
    """Definition of a declared function that no server serves, as a person reviews it.

    Args:
        row: of the function.
        description: of it.
    """
    properties: dict[str, Any] = {}
    for argument in row.arguments or ():
        properties[argument.name] = {"type": SCHEMA_TYPES[argument.form]}
        if argument.form is ArgumentForm.VECTOR:
            properties[argument.name] |= {
                "items": {"type": "number"},
                "minItems": argument.parameters,
                "maxItems": argument.parameters,
            }
    schema = {"type": "object", "properties": properties, "required": list(properties)}
    return Tool(name=row.name, description=description, input_schema=schema)


def check_schema(row: Operation, tool: Tool) -> None:
    """Checks that a call which fits the row fits the tool's own schema, and the other way round.

    Raises:
        DeclarationError: `TOOL_SCHEMA_DIFFERS`, naming tool and argument.
    """
    properties: Mapping[str, Any] = tool.input_schema.get("properties") or {}
    arguments = {argument.name: argument for argument in row.arguments or ()}
    for name in sorted(properties.keys() ^ arguments.keys()):
        where = "declared, and not in the schema" if name in arguments else "in the schema, and not declared"
        raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{tool.name}.{name}: {where}")
    for name, argument in arguments.items():
        if not _fits(argument, properties[name]):
            raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{tool.name}.{name}: {SCHEMA_TYPES[argument.form]}")


def _fits(argument: ToolArgument, schema: Any) -> bool:
    if not isinstance(schema, dict) or schema.get("type") != SCHEMA_TYPES.get(argument.form):
        return False
    if argument.form is not ArgumentForm.VECTOR:
        return True
    items = schema.get("items")
    return isinstance(items, dict) and items.get("type") == "number"
