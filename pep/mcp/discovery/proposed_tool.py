"""Declaration proposed for one tool as a server lists it, or the reason why there is none.

What is proposed is what the guard takes: each declaration was read and compared with the tool's schema by the guard's
own checks. Names, texts, schema and annotations are the server's claims; a person reviews what is made of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

from mcp_types import Tool

from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.characters import compatible, hidden, mixed
from capabilities.values.errors import ScopeError
from capabilities.values.well_formed import well_formed_grants
from pep.base.declaration import grant, row_from_toml
from pep.base.errors import DeclarationError, PepFault
from pep.mcp.declared_tools import rows_of
from pep.mcp.discovery.guessed_unit import name_words, words_about
from pep.mcp.discovery.proposed_argument import ProposedArgument, proposed_arguments
from pep.mcp.tool_digest import plain_definition

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

DEFINITION_BYTES: Final = 65_536
"""Ours: largest definition of a tool that is read; a person reviews no larger one."""
SAID: Final = 100
"""Characters of a description that are shown."""
PLACE_SAID: Final = 200
"""Characters that are shown of why an argument is left out."""
PLACES: Final = 3
"""Hidden characters of a tool that are named."""
ACTS: Final = frozenset(
    {"add", "append", "apply", "cancel", "change", "checkout", "clear", "close", "commit", "create", "delete"}
    | {"disable", "drop", "edit", "enable", "execute", "insert", "install", "kill", "merge", "move", "open", "pay"}
    | {"post", "publish", "push", "put", "remove", "rename", "replace", "reset", "restart", "revert", "run", "send"}
    | {"set", "start", "stop", "update", "upload", "write"}
)
"""Words of a name that say an effect, against an annotation that denies one."""


class LeftOutCode(StrEnum):
    """Codes of a tool for which nothing is proposed, beside those of the guard's own checks."""

    HIDDEN_TEXT = "HIDDEN_TEXT"
    DEFINITION_TOO_LARGE = "DEFINITION_TOO_LARGE"
    ARGUMENT_UNDECLARABLE = "ARGUMENT_UNDECLARABLE"


@dataclass(frozen=True, slots=True)
class ProposedTool:
    """Proposal for one tool. Its texts may be the server's: they are made safe where they are shown.

    Attributes:
        name: of the tool.
        said: the beginning of its description.
        object: what it acts on.
        base_tier: least tier of a call.
        because: what the tier rests on.
        arguments: in the schema's order.
        review: what a person has to look at, of the tool as a whole.
        code: why it is left out; "" where it is proposed.
        reason: in words.
    """

    name: str
    said: str = ""
    object: str = ""
    base_tier: int = 3
    because: str = ""
    arguments: tuple[ProposedArgument, ...] = ()
    review: tuple[str, ...] = ()
    code: str = ""
    reason: str = ""

    @property
    def table(self) -> dict[str, Any]:
        """The table `[tool.NAME]`, as TOML has it."""
        arguments = {each.name: each.stated for each in self.arguments}
        return {"object": self.object, "base_tier": self.base_tier, **({"arguments": arguments} if arguments else {})}

    @property
    def doubtful(self) -> bool:
        """True where a line of it is marked for review."""
        return bool(self.review) or any(each.review for each in self.arguments)


def propose_tool(tool: Tool, *, object: str) -> ProposedTool:  # noqa: A002 - a request's word
    """The proposal for a tool.

    Args:
        tool: as the server lists it.
        object: what its calls act on.
    """
    name, said = tool.name[: CAPS.text_bytes], _beginning(tool.description or "")
    if len(tool.model_dump_json(by_alias=True, exclude_none=True)) > DEFINITION_BYTES:
        reason = f"its definition has more than {DEFINITION_BYTES} bytes"
        return ProposedTool(name, said, code=LeftOutCode.DEFINITION_TOO_LARGE, reason=reason)
    seen = plain_definition(tool)
    found = [place for where, text in _texts(seen) for place in _hidden(where, text)]
    if found:
        more = f", and {len(found) - PLACES} more" if len(found) > PLACES else ""
        reason = f"characters that no reader sees: {'; '.join(found[:PLACES])}{more}"
        return ProposedTool(name, said, code=LeftOutCode.HIDDEN_TEXT, reason=reason)
    tier, because, review = _tier(tool)
    if alike := sorted({where for where, text in _texts(seen) if any(mixed(text)) or any(compatible(text))}):
        review = (*review, f"letters that pass for others in {', '.join(alike[:PLACES])}")
    if tier == 0 and tool.annotations is not None and tool.annotations.open_world_hint:
        review = (*review, "the server says openWorldHint: what a call says leaves this place")
    made = ProposedTool(name, said, object, tier, because, review=review)
    try:
        arguments, left_out = _arguments(tool, object)
        made = replace(made, arguments=arguments, review=(*review, *left_out))
        _check(tool.name, made.table, tool)
    except _UndeclarableError as error:
        return replace(made, code=LeftOutCode.ARGUMENT_UNDECLARABLE, reason=str(error))
    except DeclarationError as error:
        return replace(made, code=str(error.code), reason=error.detail)
    return made


class _UndeclarableError(Exception):
    """An argument that no declaration fits; the text says why."""


def _arguments(tool: Tool, object_name: str) -> tuple[tuple[ProposedArgument, ...], tuple[str, ...]]:
    """The first proposal of each argument that the guard takes, and what is to review of those that have none.

    Raises:
        _UndeclarableError: for an argument that has none, and that the tool requires.
    """
    properties, required = tool.input_schema.get("properties", {}), tool.input_schema.get("required", [])
    if not isinstance(properties, dict) or not isinstance(required, list):
        raise _UndeclarableError("its schema has no properties of the usual form")
    found, left_out = [], []
    for name, schema in properties.items():
        try:
            found.append(_argument(tool, object_name, name, schema))
        except _UndeclarableError as error:
            if name in required:
                raise
            left_out.append(f"{str(error)[:PLACE_SAID]}: left out, so that no call gives it")
    return tuple(found), tuple(left_out)


def _argument(tool: Tool, object_name: str, name: str, schema: object) -> ProposedArgument:
    if not isinstance(schema, dict):
        raise _UndeclarableError(f"{name}: its schema is no object")
    needed = name in tool.input_schema.get("required", [])
    alone = Tool(
        name=tool.name,
        input_schema={**tool.input_schema, "properties": {name: schema}, "required": [name] if needed else []},
    )
    why = "no declaration fits"
    said = words_about(name, tool.description or "")
    for proposed in proposed_arguments(name, schema, root=tool.input_schema, needed=needed, said=said):
        if proposed.missing:
            why = proposed.missing
            continue
        try:
            _check(
                tool.name, {"object": object_name, "base_tier": 0, "arguments": {name: proposed.stated}}, alone
            )  # any tier: it has no rows
        except DeclarationError as error:
            why = f"{error.code} {error.detail}"
            continue
        return proposed
    raise _UndeclarableError(f"{name}: {why}")


def _check(name: str, table: Mapping[str, Any], tool: Tool) -> None:
    """Checks that the guard takes the table for the tool, and that a grant of it can be written.

    Raises:
        DeclarationError: naming tool and argument.
    """
    row = row_from_toml(name, dict(table))
    (row,) = rows_of([tool], decorated={}, configured={name: row}).values()
    try:
        well_formed_grants((grant(row),), CAPS)
    except ScopeError as error:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{name}: no grant of it: {error.detail}") from error


# --- class -----------------------------------------------------------------------------------------------------------


def _tier(tool: Tool) -> tuple[int, str, tuple[str, ...]]:
    """Proposed base tier, what it rests on, and what is to review."""
    said = tool.annotations
    reads, destroys = (None, None) if said is None else (said.read_only_hint, said.destructive_hint)
    effects = sorted(ACTS & set(name_words(tool.name)))
    if reads and destroys:
        return 3, "the server says both readOnlyHint and destructiveHint", ("its annotations contradict each other",)
    if reads and effects:
        why = f'the server says readOnlyHint, but its name says "{effects[0]}"'
        return 3, why, ("0 only if it changes nothing",)
    if reads:
        return 0, "the server says readOnlyHint: it changes nothing", ()
    if destroys:
        return 3, "the server says destructiveHint: a person is asked", ()
    if destroys is False:
        return 2, "the server says that it changes something, and destroys nothing", ()
    return 3, "the server does not say what it changes: a person is asked", ("0 if it changes nothing",)


# --- texts -----------------------------------------------------------------------------------------------------------


def _beginning(text: str) -> str:
    first = " ".join(text.split())
    return first if len(first) <= SAID else first[: SAID - 3].rstrip() + "..."


def _texts(value: Any) -> Iterator[tuple[str, str]]:
    """Every text of a definition, keys too, with its place."""
    waiting: list[tuple[str, Any]] = [("", value)]
    while waiting:
        where, each = waiting.pop()
        if isinstance(each, str):
            yield where, each
        elif isinstance(each, list):
            waiting += ((where, member) for member in each)
        elif isinstance(each, dict):
            for key, member in each.items():
                place = f"{where}.{key}" if where else key
                yield f"the key {place}", key
                waiting.append((place, member))


def _hidden(where: str, text: str) -> Iterator[str]:
    for kind, at in hidden(text):
        yield f"{where[: CAPS.text_bytes]}, {kind} U+{ord(text[at]):04X} at {at + 1}"
