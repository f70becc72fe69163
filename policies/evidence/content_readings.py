"""Readings of texts to an agent: instructions (e1), messages (e2), and items for a context (e3).

A reading states what admission found: who signed, what was compared with what. Primitives judge it (CII-1, CII-2,
CII-3, CII-5, CII-6) and compute nothing again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from policies.words.labels import Label


@dataclass(frozen=True, slots=True)
class InstructionReading:
    """An operator's instruction to an orchestrator, signed as an intent.

    Attributes:
        fault: why the signature is not believed, a code; "" when it is.
        principal: subject of the registered, active person who signed it, or "".
        signed_at: seconds since the epoch.
        well_formed: it is of its schema, with every number finite and in its unit.
        intent_digest: SHA-256 (hex) of the text that the person signed.
        bound_digest: the intent digest that the delegation states, or "" when it states none.
    """

    fault: str
    principal: str
    signed_at: int
    well_formed: bool
    intent_digest: str
    bound_digest: str


class ItemKind(StrEnum):
    """Kind of item that would enter a context."""

    INSTRUCTION = "instruction"
    MESSAGE = "message"
    DOCUMENT = "document"
    MEMORY = "memory"
    TOOL_RESPONSE = "tool response"
    SCENARIO = "scenario"


@dataclass(frozen=True, slots=True)
class ItemReading:
    """One text or value that would enter a context.

    Attributes:
        kind, id: its kind, and its id in its collection, memory or call.
        label: its label; already tainted when `signs` is not empty.
        signs: what screening found in its text: "hidden text", "instruction-like", "mixed scripts" and the like. It is
            evidence, never authority: that nothing was found proves nothing.
        as_authority: it is offered as an instruction, a grant, a limit or an approval, not as content.
        fault: why its provenance is not believed, a code; "" when it is.
        listed: the audited manifest of its collection lists exactly this digest. For documents and scenarios.
        manifest_age_s: since the curator signed the manifest, or None when there is none. For documents and scenarios.
        writer_authorised: the writer's verified chain grants writing this. For memory.
        of_request: it answers the very request that was recorded. For tool responses.
        of_pin: the tool's definition was the approved one when it answered. For tool responses.
    """

    kind: ItemKind
    id: str
    label: Label
    signs: tuple[str, ...] = ()
    as_authority: bool = False
    fault: str = ""
    listed: bool = False
    manifest_age_s: int | None = None
    writer_authorised: bool = False
    of_request: bool = False
    of_pin: bool = False


@dataclass(frozen=True, slots=True)
class ArgumentReading:
    """One argument of a tool call, with the label of its origin.

    Attributes:
        name: of the parameter.
        label: joined over everything that the call's receipts say it derives from; for an argument without receipts it
            is the holder's own choice (`Integrity.AGENT`).
        fault: why a receipt is not believed, a code; "" when all are.
    """

    name: str
    label: Label
    fault: str = ""


@dataclass(frozen=True, slots=True)
class ContextReading:
    """Items that would enter a context (e3), and the origins of the arguments of a call (e4).

    Attributes:
        items: in order; empty for a tool call.
        arguments: one for each parameter of the request; empty where nothing is called.
    """

    items: tuple[ItemReading, ...] = ()
    arguments: tuple[ArgumentReading, ...] = ()


@dataclass(frozen=True, slots=True)
class MessageReading:
    """A message between agents.

    Attributes:
        fault: why it is not believed (signature, form), a code; "" when it is.
        sender, addressee: as it states them.
        by_holder: it is signed with the key of the hop that it is said under, in a chain that was verified.
        addressed: the addressee is the agent that received it.
        in_schema: its body is of the schema that it names, and that schema is known.
        in_sequence: its number follows the last one of its conversation.
        in_delegation: the hop that it is said under grants its request.
        age_s: since it was said; None when it does not state a time that can be believed.
    """

    fault: str
    sender: str
    addressee: str
    by_holder: bool
    addressed: bool
    in_schema: bool
    in_sequence: bool
    in_delegation: bool
    age_s: int | None
