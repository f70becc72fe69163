"""A person's word to an orchestrator (e1): a signed intent, and whether the delegation was given for exactly it.

Pure: text, keys of people and a chain go in, a reading comes out. An agent's report of a person's wish is never an
instruction: only a text under a person's registered key is one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.keys import keys as key_forms
from capabilities.statements import statement_form
from capabilities.statements.context import intent as statement
from capabilities.values import strict_json
from capabilities.values.errors import CapabilityError
from pep.context import screening
from policies.evidence.content_readings import InstructionReading, ItemKind, ItemReading
from policies.words.labels import NOBODY, Integrity, Label, Source, tainted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.context.intent import Intent
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain
    from pep.context.forms import Forms, ParsedBody

SPARED: Final = frozenset({screening.INSTRUCTION_LIKE})
"""A person's signed instruction may read like one."""


class People(Protocol):
    """The registered, active people whose word is an instruction."""

    def people(self) -> Mapping[str, bytes]:
        """Raw public key by person; empty while no snapshot has been verified. None of them is an agent's."""
        ...


@dataclass(frozen=True, slots=True)
class Instruction:
    """Instruction, as read.

    Attributes:
        reading: for CII-1.
        item: the same text as something that would enter a context, offered as authority, for CII-2.
        intent: the signed intent; None when the signature is not believed.
        read: its body, of its form; None when it is of none.
    """

    reading: InstructionReading
    item: ItemReading
    intent: Intent | None = None
    read: ParsedBody | None = None


def read(
    text: str, *, people: Mapping[str, bytes], chain: Chain | None, forms: Forms, at: float, caps: Caps
) -> Instruction:
    """Reads a text as an instruction; never raises.

    Args:
        text: the signed intent as it came.
        people: raw public key by registered, active person.
        chain: the verified chain under which it is to be carried out; None when none was verified.
        forms: the known forms of instructions.
        at: now, seconds since the epoch.
        caps: the bounds.
    """
    bound = "" if chain is None else statement.bound(chain)
    try:
        intent = statement.open(text, frozenset(people.values()), caps)
    except CapabilityError as error:
        return _unbelieved(str(error.code), bound)
    signer = statement_form.signer_thumbprint(text)
    subject = next((name for name, key in people.items() if key_forms.thumbprint(key) == signer), "")
    digest = statement.digest_of(text)
    fault = statement.refusal(intent, subject=subject, at=at, caps=caps)
    if intent.subject != subject:
        return _unbelieved(str(fault.code if fault else ""), bound)
    body = forms.read(intent.schema, intent.body)
    reading = InstructionReading(
        fault="" if fault is None else str(fault.code),
        principal=subject,
        signed_at=intent.at,
        well_formed=body is not None,
        intent_digest=digest,
        bound_digest=bound,
    )
    label = Label(
        frozenset({Source.OPERATOR}), frozenset({subject}), Integrity.PRINCIPAL, max(0, int((at - intent.at) * 1_000))
    )
    signs = screening.signs(screening.screen_value(strict_json.parse(intent.body)), spared=SPARED)
    item = ItemReading(
        kind=ItemKind.INSTRUCTION,
        id=digest,
        label=tainted(label) if signs else label,
        signs=signs,
        as_authority=True,
        fault=reading.fault,
    )
    return Instruction(reading, item, intent, body)


def _unbelieved(fault: str, bound: str) -> Instruction:
    """Reading of a text that no registered person signed, and that was still offered as authority."""
    return Instruction(
        InstructionReading(
            fault=fault, principal="", signed_at=0, well_formed=False, intent_digest="", bound_digest=bound
        ),
        ItemReading(kind=ItemKind.INSTRUCTION, id="", label=NOBODY, as_authority=True, fault=fault),
    )
