"""Acts of telling: a person's instruction at e1, and a message of one agent to another at e2."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final, Literal

from capabilities.keys import keys
from capabilities.statements.context import intent
from evaluation.redteam.acts.act import Act
from evaluation.redteam.admission.saying import altered, intent_of, message_of, signed
from evaluation.redteam.parts import Came, Effect
from ztpm.stage.lending import hop_id
from ztpm.stage.stage import ACCELERATION_RAD_S2, in_time, until

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from evaluation.redteam.admission.room import AdmissionRoom
    from evaluation.redteam.admission.told import Told
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena

InstructionFault = Literal[
    "", "unsigned", "foreign_key", "agent_key", "other_person", "stranger", "altered", "unbound", "other_intent",
    "replayed", "old", "expired", "future", "unknown_form", "extra_member",
]  # fmt: skip
MessageFault = Literal[
    "", "unsigned", "foreign_key", "altered", "replayed", "misdirected", "skipped", "old", "expired", "future",
    "other_hop", "other_token", "unknown_form", "extra_member", "revoked",
]  # fmt: skip
PERSON: Final = "alice"
"""Person whose word it is, or is said to be."""
HARMLESS: Final = "Stay where you are, please."
"""Text that was there before another one took its place."""


class Entering(Act, frozen=True, kw_only=True):
    """Text that is put before an agent; with no enforcement nothing keeps it out."""

    at_admission: ClassVar[bool] = True

    def bare(self, arena: BareArena) -> Came:  # noqa: ARG002 - nobody asks
        """Takes the text in."""
        return Came(Effect.DONE)


class Instruct(Entering, frozen=True, kw_only=True, tag="instruct"):
    """Instruction to the orchestrator, in a person's name.

    Attributes:
        text: the wish.
        wrong: fault of it; empty for a person's own wish.
    """

    point: ClassVar[str] = "e1"

    text: str
    wrong: InstructionFault = ""

    def guarded(self, arena: GuardedArena) -> Came:
        """Has it admitted under a token that was lent for it, or, where that is the fault, for something else."""
        return in_time(lambda: self._told(arena)).came(self.point)

    def _told(self, arena: GuardedArena) -> Told:
        room, orchestrator = arena.admission, arena.cast.called("orchestrator")
        own = room.stage.person(PERSON)._key  # noqa: SLF001 - the arena's people
        wished = intent_of(self.text, own, subject=PERSON, wrong=self.wrong)
        match self.wrong:
            case "unsigned":
                return room.ask(orchestrator, "instruct", intent=self.text)
            case "unbound":
                return room.ask(orchestrator, "instruct", intent=wished)
            case "other_intent":
                other = intent_of(HARMLESS, own, subject=PERSON)
                room.lend(arena.cast, purpose=intent.purpose(intent.digest_of(other)))
                return room.ask(orchestrator, "instruct", intent=wished)
        forged = self._forged(room, orchestrator, wished, own)
        room.lend(arena.cast, purpose=intent.purpose(intent.digest_of(forged)))
        told = room.ask(orchestrator, "instruct", intent=forged)
        return room.ask(orchestrator, "instruct", intent=forged) if self.wrong == "replayed" else told

    def _forged(self, room: AdmissionRoom, orchestrator: str, wished: str, own: PrivateKey) -> str:
        """The wish, signed as the fault says."""
        match self.wrong:
            case "foreign_key":
                return intent_of(self.text, keys.generate(), subject=PERSON)
            case "agent_key":
                return intent_of(self.text, room.stage.agents[orchestrator].key, subject=PERSON)
            case "other_person":
                return intent_of(self.text, room.stage.person("bob")._key, subject=PERSON)  # noqa: SLF001 - likewise
            case "stranger":
                return intent_of(self.text, keys.generate(), subject="mallory")
            case "altered":
                return altered(intent_of(HARMLESS, own, subject=PERSON), self.text)
            case _:
                return wished


class Message(Entering, frozen=True, kw_only=True, tag="message"):
    """Message of one agent to another.

    Attributes:
        to: role of the addressee.
        text: what it says.
        form: `task` asks for operations, `report` only tells.
        asks: operations that a task asks for, each as `object/operation`.
        to_rad, speed_rad_s: move that a task asks for, in full; no angles for none.
        wrong: fault of it; empty for what the sender truly says.
    """

    point: ClassVar[str] = "e2"

    to: str
    text: str
    form: Literal["task", "report"] = "task"
    asks: tuple[str, ...] = ()
    to_rad: tuple[float, ...] = ()
    speed_rad_s: float = 0.5
    wrong: MessageFault = ""

    def guarded(self, arena: GuardedArena) -> Came:
        """Has the addressee's host ask whether it may be heard."""
        return in_time(lambda: self._told(arena)).came(self.point)

    def _told(self, arena: GuardedArena) -> Told:
        room = arena.admission
        sender, addressee = room.holder(arena.cast, self.by), room.holder(arena.cast, self.to)
        aimed = self._other(arena) if self.wrong == "misdirected" else addressee
        stated = message_of(room, sender, aimed, self._body(self.text), form=self.form, wrong=self.wrong)
        text = signed(room, stated, wrong=self.wrong)
        match self.wrong:
            case "unsigned":
                text = self.text
            case "altered":
                harmless = message_of(room, sender, addressee, self._body(HARMLESS), form=self.form)
                text = altered(signed(room, harmless), self.text)
            case "replayed":
                first = self._heard(room, sender, addressee, text)
                return first if not first.admitted else self._heard(room, sender, addressee, text)
            case "revoked":
                self._revoke(room, sender)
        return self._heard(room, sender, addressee, text)

    def _heard(self, room: AdmissionRoom, sender: str, addressee: str, text: str) -> Told:
        chain = {} if self.by == "orchestrator" else {"chain": room.stage.tokens[sender]}
        return room.ask(addressee, "hear", message=text, **chain)

    def _body(self, text: str) -> dict[str, object]:
        if self.form == "report":
            return {"done": True, "text": text}
        move = {
            "q_urad": [round(angle * 1e6) for angle in self.to_rad],
            "speed_urad_s": round(self.speed_rad_s * 1e6),
            "acceleration_urad_s2": round(ACCELERATION_RAD_S2 * 1e6),
        }
        return {"text": text, "needs": list(self.asks), "move": move if self.to_rad else None}

    def _other(self, arena: GuardedArena) -> str:
        """An agent that is neither sender nor addressee."""
        return next(
            arena.cast.called(role) for role in ("vision", "config", "robotic") if role not in (self.by, self.to)
        )

    def _revoke(self, room: AdmissionRoom, sender: str) -> None:
        """Revokes the sender's hop; the point knows."""
        hop = hop_id(room.stage, room.stage.tokens[sender])
        room.stage.person(PERSON).revoke("hop", hop, "the agent is not to speak any more")
        until(lambda: room.ask(sender, "recall", name="nothing").reason == "REVOKED", "the revocation at the point")
