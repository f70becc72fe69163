"""Tools of a server with their declared rows, compared before anything is served."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, cast

from mcp_types import Tool

from capabilities.values import bounds
from capabilities.values.scope import Each, Stems, Words
from capabilities.values.units import ListOf, Sort
from pep.base.declaration import declared, defined_twice
from pep.base.errors import DeclarationError, PepFault
from pep.base.operation_row import ArgumentForm
from pep.mcp import fastmcp_server
from pep.mcp.mapping import checked_defaults
from pep.mcp.schema_types import members_of, types_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from capabilities.values.scope import Bound
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
    ArgumentForm.TEXT: "string",
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
        check_schema(row, tool, whole=tool.name in decorated)
        rows[tool.name] = checked_defaults(replace(_with_defaults(row, tool), name=tool.name))
    for name in configured:
        if name not in rows:
            raise DeclarationError(PepFault.TOOL_UNKNOWN, f"{name}: the server has no such tool")
    return rows


def _with_defaults(row: Operation, tool: Tool) -> Operation:
    """The row with the defaults of the tool's own schema, of the arguments that it does not require.

    A null in place of a value is no default: such an argument is given in each call.
    """
    stated, required = _properties(tool)
    arguments = []
    for argument, limits in row.stated():
        schema = stated[argument.name]
        left_out = isinstance(schema, dict) and "default" in schema and argument.name not in required
        if left_out and schema["default"] is None and limits[0].parameter.kind is not Sort.FREE:
            left_out = "null" not in types_of(schema, tool.input_schema)
        arguments.append(replace(argument, default=json.dumps(schema["default"]) if left_out else None))
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


def check_schema(row: Operation, tool: Tool, *, whole: bool) -> None:
    """Checks that a call which fits the row fits the tool's own schema.

    Args:
        row: of the tool.
        tool: as its server lists it.
        whole: the row has every argument of the tool; else it may leave out what the tool does not require, and no call
            gives that.

    Raises:
        DeclarationError: `TOOL_SCHEMA_DIFFERS`, naming tool and argument.
    """
    properties, required = _properties(tool)
    wanted = {argument.name for argument, _ in row.stated()}
    for name in sorted(properties.keys() ^ wanted):
        if name in wanted or whole or name in required:
            where = "declared, and not in the schema" if name in wanted else "in the schema, and not declared"
            raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{tool.name}.{name}: {where}")
    for argument, limits in row.stated():
        schema = _schema(argument, limits[0])
        if not _fits(schema, limits[0].bound, properties[argument.name], tool.input_schema):
            raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{tool.name}.{argument.name}: {_words(schema)}")


def _properties(tool: Tool) -> tuple[Mapping[str, Any], Sequence[str]]:
    """Schemas of the tool's arguments, and names of the required ones.

    Raises:
        DeclarationError: `TOOL_SCHEMA_DIFFERS`: its schema has another form.
    """
    properties, required = tool.input_schema.get("properties") or {}, tool.input_schema.get("required") or []
    if not isinstance(properties, dict) or not isinstance(required, list):
        raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{tool.name}: its schema is none of an object")
    return properties, required


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


def _fits(wanted: Mapping[str, Any], bound: Bound | None, schema: Any, root: Any) -> bool:
    """True where a tool's schema takes the row's values of the wanted type, their members too.

    Args:
        wanted: schema of the row.
        bound: of the row's values, or of their members; None for any.
        schema: of the tool.
        root: whole schema of the tool, in which references are looked up.
    """
    if "type" not in wanted:
        return True
    types = types_of(schema, root)
    if wanted["type"] == "string":
        # A server that takes more than texts may read JSON in one: "null" is then none.
        none = isinstance(bound, (Words, Stems)) and not bounds.permits(bound, "null")
        return types == {"string"} or (none and types == {"string", "null"})
    if wanted["type"] not in types:
        return False
    if "items" not in wanted:
        return True
    element = bound.element if isinstance(bound, Each) else None
    members = members_of(schema, root)
    return bool(members) and all(_fits(wanted["items"], element, each, root) for each in members)


def _words(schema: Mapping[str, Any]) -> str:
    return f"{schema['type']} of {schema['items']['type']}" if "items" in schema else str(schema["type"])
