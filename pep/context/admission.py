"""The gate of admission: nothing reaches an agent that was not judged, recorded and labelled.

    what is said -> reading -> decide -> record -> enter the context -> the value, with its label and a receipt
                    pure       pure      durable

Plain calls, for any agent framework: whoever runs the agent asks here before anything is put before its model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from policies.said import ItemKind

if TYPE_CHECKING:
    from capabilities.chain import Chain
    from capabilities.errors import Fault
    from pep.authority import Credentials
    from pep.context.flow import Context
    from policies.labels import Label
    from policies.model import Decision
    from policies.said import ItemReading

OBJECT: Final = "context"
"""The object of every request of admission."""
OPERATION_OF: Final = {
    ItemKind.INSTRUCTION: "instruct",
    ItemKind.MESSAGE: "hear",
    ItemKind.DOCUMENT: "retrieve",
    ItemKind.MEMORY: "remember",
    ItemKind.TOOL_RESPONSE: "respond",
    ItemKind.SCENARIO: "scenario",
}


@dataclass(frozen=True, slots=True)
class Admitted:
    """A value that may be put before the agent, and has been entered into its context.

    Attributes:
        value: a copy of its own; what its receipt vouches for.
        label: of the value.
        receipt: text of the signed receipt, for the argument that will come from it.
        decision: the PERMIT.
        record: hash of its record.
    """

    value: object
    label: Label
    receipt: str
    decision: Decision
    record: str


@dataclass(frozen=True, slots=True)
class Refused:
    """A value that must not reach the agent.

    Attributes:
        decision: why; DENY or DEFER.
        record: hash of its record, or "" when it could not be recorded.
    """

    decision: Decision
    record: str


class Admits(Protocol):
    """What retrieval, memory and tool adapters need of the gate of admission."""

    def admit(self, item: ItemReading, value: object, *, into: Context) -> Admitted | Refused:
        """The value, admitted into that context and on record; or why not. Never raises.

        Args:
            item: what is known of it: kind, id, label, provenance. Screening is added here, and taints the label.
            value: plain JSON, mostly a text; at most 1 MiB in canonical form.
            into: the context that it would enter (`Flow.context` for a holder, `Flow.fresh` for a reader).
        """
        ...


class Standing(Protocol):
    """The authority behind a context, as of now."""

    def chain(self, context: Context) -> Chain | Fault:
        """The holder's verified chain, or why it no longer stands. Never raises."""
        ...


class Admission:
    """Judges everything that would enter a context. Any thread; all IO is in its ports."""

    def instruct(self, text: str, *, credentials: Credentials, into: Context) -> Admitted | Refused:
        """e1: a person's signed intent, admitted as an instruction under the delegation that names its digest.

        Args:
            text: the signed intent (`capabilities.statements.intent`).
            credentials: of the orchestrator, after steps 1 to 10.
            into: its context.
        """
        raise NotImplementedError

    def hear(
        self, text: str, *, credentials: Credentials, into: Context, intent: str | None = None
    ) -> Admitted | Refused:
        """e2: another agent's signed message, admitted as what that agent says.

        Args:
            text: the signed message (`capabilities.statements.message`).
            credentials: the chain, after steps 1 to 10, in which the sender's hop is.
            into: the addressee's context.
            intent: the person's signed intent that the work is under, where it came along.
        """
        raise NotImplementedError

    def admit(self, item: ItemReading, value: object, *, into: Context) -> Admitted | Refused:
        """e3: see `Admits.admit`."""
        raise NotImplementedError
