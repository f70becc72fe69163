"""Tools of a server with their declared rows, compared before anything is served."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, cast

from mcp_types import Tool

from capabilities.values.scope import Each
from capabilities.values.units import ListOf, Sort
from pep.base.declaration import declared, defined_twice
from pep.base.errors import DeclarationError, PepFault
from pep.base.operation_row import ArgumentForm
from pep.mcp import fastmcp_server
from pep.mcp.mapping import checked_defaults

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.values.units import Kind
    from pep.base.operation_row import BoundedParameter, Operation, ToolArgument
    from pep.mcp.fastmcp_server import FastMCPServer
    from pep.mcp.guard import AnyServer

_TYPES: Final[Mapping[ArgumentForm, str]] = {
    ArgumentForm.NUMBER: "number",
    ArgumentForm.INTEGER: "integer",
    ArgumentForm.VECTOR: "array",
    ArgumentForm.FLAG: "boolean",
    ArgumentForm.NUMBERS: "number",
    ArgumentForm.INTEGERS: "integer",
}
"""Type that a tool's schema states for an argument of a form, or for each member of its list."""


async def decorated(server: AnyServer) -> dict[str, Operation]:
    """Rows of the server's functions that declare one, by the name of their tool; a low-level server has none.

    Raises:
        DeclarationError: `TOOL_TWICE`: the module defined a tool twice, and the server kept the first.
    """
    if fastmcp_server.is_fastmcp(server):
        return await fastmcp_server.decorated(cast("FastMCPServer", server))
    # The SDK tells a tool's function in no public way; without this table no tool is declared, and none is served.
    table = getattr(server, "_tool_manager", None)
    tools = () if table is None else table.list_tools()
    for tool in tools:
        if defined_twice(tool.fn):
            raise DeclarationError(PepFault.TOOL_TWICE, f"{tool.name}: the server kept the first definition of two")
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
        rows[tool.name] = checked_defaults(replace(_with_defaults(row, tool), name=tool.name))
    for name in configured:
        if name not in rows:
            raise DeclarationError(PepFault.TOOL_UNKNOWN, f"{name}: the server has no such tool")
    return rows


def _with_defaults(row: Operation, tool: Tool) -> Operation:
    """The row with the defaults of the tool's own schema, of the arguments that it does not require."""
    stated, required = tool.input_schema.get("properties") or {}, tool.input_schema.get("required") or ()
    optional = {
        name: schema["default"] for name, schema in stated.items() if name not in required and "default" in schema
    }
    arguments = (
        replace(each, default=json.dumps(optional[each.name])) if each.name in optional else replace(each, default=None)
        for each in row.arguments or ()
    )
    return replace(row, arguments=tuple(arguments))


def definition_of(row: Operation, description: str) -> Tool:
    """Definition of a declared function that no server serves, as a person reviews it.

    Args:
        row: of the function.
        description: of it.
    """
    properties = {argument.name: _schema(argument, limits[0]) for argument, limits in row.stated()}
    defaults = {each.name: json.loads(each.default) for each in row.arguments or () if each.default is not None}
    for name, default in defaults.items():
        properties[name]["default"] = default
    schema = {
        "type": "object",
        "properties": properties,
        "required": [name for name in properties if name not in defaults],
    }
    return Tool(name=row.name, description=description, input_schema=schema)


def check_schema(row: Operation, tool: Tool) -> None:
    """Checks that a call which fits the row fits the tool's own schema, and the other way round.

    Raises:
        DeclarationError: `TOOL_SCHEMA_DIFFERS`, naming tool and argument.
    """
    properties: Mapping[str, Any] = tool.input_schema.get("properties") or {}
    wanted = {argument.name: _schema(argument, limits[0]) for argument, limits in row.stated()}
    for name in sorted(properties.keys() ^ wanted.keys()):
        where = "declared, and not in the schema" if name in wanted else "in the schema, and not declared"
        raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{tool.name}.{name}: {where}")
    for name, schema in wanted.items():
        if not _fits(schema, properties[name]):
            raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{tool.name}.{name}: {_words(schema)}")


def _schema(argument: ToolArgument, limit: BoundedParameter) -> dict[str, Any]:
    """Schema of an argument, whose first parameter is of this limit; a free value's has no type."""
    kind = limit.parameter.kind
    if argument.form is ArgumentForm.VECTOR:
        number = argument.parameters
        return {"type": "array", "items": {"type": "number"}, "minItems": number, "maxItems": number}
    if not isinstance(kind, ListOf):
        return _one(argument.form, kind)
    length = {"minItems": limit.bound.least, "maxItems": limit.bound.most} if isinstance(limit.bound, Each) else {}
    return {"type": "array", "items": _one(argument.form, kind.element)} | length


def _one(form: ArgumentForm, kind: Kind) -> dict[str, Any]:
    if form is not ArgumentForm.VALUE:
        return {"type": _TYPES[form]}
    return {} if kind is Sort.FREE else {"type": "boolean" if kind is Sort.FLAG else "string"}


def _fits(wanted: Mapping[str, Any], schema: Any) -> bool:
    """True where a tool's schema is of the wanted type, its members too."""
    if "type" not in wanted:
        return True
    if not isinstance(schema, dict) or schema.get("type") != wanted["type"]:
        return False
    return "items" not in wanted or _fits(wanted["items"], schema.get("items"))


def _words(schema: Mapping[str, Any]) -> str:
    return f"{schema['type']} of {schema['items']['type']}" if "items" in schema else str(schema["type"])
