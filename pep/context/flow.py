"""Contents of each context, and so the label of everything that comes out of it.

As in FIDES and CaMeL, everything that a model says derives from everything in its context. The rules:

1. An empty context has its holder's own choice as its label: source `AGENT`, signed by the holder, `Integrity.AGENT`.
2. Every value that comes out of a context has that label, joined with the label of everything that ever entered it
   (`policies.words.labels`).
3. A context never gets better. Its label only ages, and is joined with more.
4. A new hop of an agent is no new memory: its context begins with the content of the agent's other contexts.
5. A reader is a context of its own (CaMeL's quarantined model, the second model of the dual LLM pattern). It begins
   empty, its content enters no other context, and it ends with one value, which has the label of all that it read.
   That value is a thing to be handed on. Shown to the model of another context, it enters that one like anything else.
6. A forgotten content is never taken for clean: beyond their bounds contexts are joined, or nothing more enters.
7. What a text names is no choice of its reader: the texts are kept, so that a destination which stands in one of them
   is known (`pep.context.destinations`).
"""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from capabilities.statements.context.admission import OTHERS, SIGNERS
from pep.context.destinations import UNSAID, Texts, from_text
from policies.words.labels import Integrity, Label, Source, aged, joined

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.values.chain import Hop
    from pep.base.ports import Clock

AGENTS: Final = 1_024
"""Most agents whose contexts are remembered, as many as a registry snapshot names."""
HOPS: Final = 64
"""Most contexts of one agent that are told apart.

The label of the oldest one goes into the beginning of each new one.
"""
READERS: Final = 64
"""Most open readers of one agent."""
KEPT_MS: Final = 86_400_000
"""Time for which a context is remembered after its last entry: the longest life of a token (`Caps.lifetime_s`).

A host that keeps a context alive for longer says so by `Flow.keep`.
"""


@dataclass(frozen=True, slots=True)
class Holder:
    """Owner of a context: the agent, and the hop that it holds."""

    hop_id: str
    agent: str

    @classmethod
    def of(cls, hop: Hop) -> Holder:
        """The holder that a hop of a verified chain names."""
        return cls(hop.hop_id, hop.agent)


@dataclass(frozen=True, slots=True)
class Context:
    """One context: of a holder, or (with a `reader` id) of its reader."""

    holder: Holder
    reader: str = ""


@dataclass(frozen=True, slots=True)
class Full:
    """Refusal for lack of room: nothing more may enter. `what` names the things that are too many."""

    what: str


@dataclass(slots=True)
class _Memory:
    """Memory of one agent: label and time of each context, the one that changed last at the end.

    `begun` keeps readers that are open, also those that have read nothing: a reader of which nothing is known is
    closed. `told` has the texts of all contexts and readers that are not from a principal, and `instructed` those that
    are, by hop.
    """

    contexts: OrderedDict[str, tuple[Label, int]] = field(default_factory=OrderedDict)
    told: Texts = field(default_factory=Texts)
    instructed: OrderedDict[str, Texts] = field(default_factory=OrderedDict)
    begun: dict[str, tuple[Label, int] | None] = field(default_factory=dict)
    touched_ms: int = 0


def own(holder: Holder) -> Label:
    """Label of a holder's choice out of an empty context."""
    return Label(frozenset({Source.AGENT}), frozenset({holder.agent}), Integrity.AGENT, 0)


class Flow:
    """The contexts of all holders at one admission point. Any thread; no IO.

    Args:
        clock: labels age on its monotonic time.
        agents: most agents that are remembered.
    """

    def __init__(self, clock: Clock, *, agents: int = AGENTS) -> None:
        self._clock = clock
        self._agents = agents
        self._lock = threading.Lock()
        self._memory: dict[str, _Memory] = {}

    def context(self, hop: Hop) -> Context:
        """The context of the holder that a hop of a verified chain names."""
        return Context(Holder.of(hop))

    def fresh(self, holder: Holder) -> Context | Full:
        """A new, empty context for a reader that works for the holder, until `close`."""
        reader = secrets.token_hex(16)
        with self._lock:
            memory = self._remembered(holder.agent)
            if isinstance(memory, Full):
                return memory
            if len(memory.begun) >= READERS:
                return Full("readers")
            memory.begun[reader] = None
        return Context(holder, reader)

    def enter(self, into: Context, label: Label, value: object = UNSAID) -> Full | None:
        """Enters a content with this label into the context; or refuses every further one.

        Args:
            into: the context.
            label: of the content.
            value: the content, plain JSON; after one that is not stated every destination may have stood in it.
        """
        with self._lock:
            memory = self._remembered(into.holder.agent)
            if isinstance(memory, Full):
                return memory
            now_ms = self._clock.monotonic_ms()
            memory.touched_ms = now_ms
            if into.reader:
                if into.reader not in memory.begun:
                    return Full("a reader that is closed")
                memory.begun[into.reader] = _more(memory.begun[into.reader], label, now_ms)
                memory.told.add(value)
                return None
            before = memory.contexts.pop(into.holder.hop_id, None) or _all(memory, now_ms)
            memory.contexts[into.holder.hop_id] = _more(before, label, now_ms)
            if len(memory.contexts) > HOPS:
                # nothing is lost by this: the context that has just begun, began with it
                memory.contexts.popitem(last=False)
            if label.integrity is not Integrity.PRINCIPAL or label.tainted:
                memory.told.add(value)
            elif value is not UNSAID:
                _instructed(memory, into.holder.hop_id).add(value)
            return None

    def names(self, word: str, hops: Sequence[Hop], shown: Texts) -> bool:
        """True where the destination takes its authority from a text that the last hop's agent was told.

        Args:
            word: the destination.
            hops: of the verified chain; an instruction into the context of any of them is for this work.
            shown: further texts that the agent was told.
        """
        with self._lock:
            memory = self._memory.get(hops[-1].agent)
            told = (shown,) if memory is None else (shown, memory.told)
            held = [(self._memory.get(hop.agent), hop.hop_id) for hop in hops]
            instructed = [one.instructed[id_] for one, id_ in held if one is not None and id_ in one.instructed]
            return from_text(word, told, instructed)

    def label(self, of: Context) -> Label:
        """Label of every value that comes out of the context now. A closed reader is unknown, and so tainted."""
        with self._lock:
            now_ms = self._clock.monotonic_ms()
            memory = self._memory.get(of.holder.agent)
            if of.reader:
                if memory is None or of.reader not in memory.begun:
                    return replace(own(of.holder), integrity=Integrity.NONE, tainted=True)
                held = memory.begun[of.reader]
            elif memory is None:
                held = None
            else:
                held = memory.contexts.get(of.holder.hop_id) or _all(memory, now_ms)
        return own(of.holder) if held is None else _bounded(joined((own(of.holder), _at(held, now_ms))))

    def close(self, reader: Context) -> Label:
        """Label of the one value of a reader, which is forgotten; closed twice, it is tainted."""
        label = self.label(reader)
        with self._lock:
            memory = self._memory.get(reader.holder.agent)
            if memory is not None and reader.reader:
                memory.begun.pop(reader.reader, None)
        return label

    def keep(self, of: Context) -> None:
        """Keeps the context alive: its agent is remembered for another `KEPT_MS`."""
        with self._lock:
            memory = self._memory.get(of.holder.agent)
            if memory is not None:
                memory.touched_ms = self._clock.monotonic_ms()

    def unsafe_forget(self, agent: str) -> None:
        """Forgets an agent. Only a host that has just started it anew, without its memory, may call this."""
        with self._lock:
            self._memory.pop(agent, None)

    def _remembered(self, agent: str) -> _Memory | Full:
        """The agent's memory, made when there is room: expired ones make room, live ones never do."""
        memory = self._memory.get(agent)
        if memory is not None:
            return memory
        now_ms = self._clock.monotonic_ms()
        if len(self._memory) >= self._agents:
            over = [name for name, old in self._memory.items() if now_ms - old.touched_ms > KEPT_MS]
            for name in over:
                del self._memory[name]
        if len(self._memory) >= self._agents:
            return Full("agents")
        self._memory[agent] = memory = _Memory(touched_ms=now_ms)
        return memory


def _instructed(memory: _Memory, hop_id: str) -> Texts:
    """Texts of people's instructions under that hop; the oldest make room: what is forgotten allows nothing."""
    found = memory.instructed.setdefault(hop_id, Texts())
    if len(memory.instructed) > HOPS:
        memory.instructed.popitem(last=False)
    return found


def _at(held: tuple[Label, int], now_ms: int) -> Label:
    label, since_ms = held
    return aged(label, now_ms - since_ms)


def _more(held: tuple[Label, int] | None, label: Label, now_ms: int) -> tuple[Label, int]:
    """The label joined into the held one, as of now."""
    parts = (label,) if held is None else (_at(held, now_ms), label)
    return _bounded(joined(parts)), now_ms


def _all(memory: _Memory, now_ms: int) -> tuple[Label, int] | None:
    """Label of all that entered any context of the agent but its readers'; None when nothing did."""
    held = memory.contexts.values()
    return (_bounded(joined(_at(one, now_ms) for one in held)), now_ms) if held else None


def _bounded(label: Label) -> Label:
    """The label with as many names as a statement can hold: the rest is `OTHERS`, which no policy knows."""
    if len(label.signers) <= SIGNERS:
        return label
    named = sorted(label.signers - {OTHERS})[: SIGNERS - 1]
    return replace(label, signers=frozenset((*named, OTHERS)))
