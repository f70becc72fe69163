"""Deferrals of one PEP: each asked once, each with an end, and with people's answers. Silence denies.

A deferral is on record before people are asked, an answer before it counts, and a use before its effect: the decision
record of the PERMIT names it. So nothing is asked twice and no use is given twice, however and whenever this process
ends. A use comes back only where the journal says that nothing was sent.
"""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.keys import keys
from capabilities.statements.people import answers as answers_statement
from capabilities.statements.people.vote import digest_of
from capabilities.tracing import trace_id
from capabilities.values.chain import Chain
from pep.people.ask_composer import compose, reasons_of
from pep.people.deferral import (
    ANSWERED,
    PICTURE_LOST,
    AskNotice,
    AskState,
    Deferral,
    answered_body,
    expired_body,
    holder_of,
    key_of,
    opened_body,
)
from pep.people.envelopes import Envelopes
from pep.people.openings import Openings
from pep.people.recovery import reopen
from pep.people.votes import (
    Count,
    RejectedStatement,
    VerifiedEnvelope,
    VerifiedOpening,
    VerifiedVote,
    read_envelope,
    read_opening,
    read_vote,
    registered,
)
from policies.evidence.evidence import ApprovalReading
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.statements.people import ask as ask_statement
    from capabilities.statements.people.answers import Answers
    from capabilities.values.caps import Caps
    from pep.base.ports import Approvers, Clock, Journal
    from pep.people.ask_composer import Asker
    from pep.people.deferral import Holder, Key
    from pep.people.votes import Tally
    from policies.evidence.evidence import Evidence, NotCollected
    from policies.evidence.model import Decision, Request

CAPACITY: Final = answers_statement.ASKS
"""Open deferrals held at once: as many as the provider can answer in one statement."""
BESIDE: Final = frozenset({"open", "used", "withdrawn", "expired"})
"""States of an answer beside which an envelope counts; beside a denial none does."""
KEPT: Final = 1_024
"""Deferrals held in all; beyond it the oldest one that is not open is forgotten and counts for nothing."""
KEPT_S: Final = 600
"""Seconds for which a deferral is kept after its end, as long as the provider tells of it."""
REFUSED_MS: Final = 10_000
"""Pause before a question is put again that the provider refused.

A budget does not recover within seconds.
"""


class Asks:
    """All deferrals of one PEP.

    Args:
        clock: both clocks.
        journal: takes each ask, answer and end before it counts.
        timeout_ms: time for which a deferral stays open.
        asker: author of the asks.
        approvers: the registered approvers' keys.
        caps: bounds on statements.
    """

    def __init__(
        self, *, clock: Clock, journal: Journal, timeout_ms: int, asker: Asker, approvers: Approvers, caps: Caps
    ) -> None:
        self._clock = clock
        self._journal = journal
        self._timeout_ms = timeout_ms
        self._asker = asker
        self._approvers = approvers
        self._caps = caps
        # `_writing` is held over a record, `_lock` never: evidence is collected on the event loop.
        self._writing = threading.Lock()
        self._lock = threading.Lock()
        self._deferrals: OrderedDict[str, Deferral] = OrderedDict()
        self._leaves = Openings()
        self._envelopes = Envelopes()
        self._rejected_openings: set[str] = set()
        self._high_s = 0.0

    def _wall_s(self) -> float:
        """Wall time that never goes back, not even over a restart, so that no ended deferral lives again."""
        self._high_s = max(self._high_s, self._clock.wall_s())
        return self._high_s

    # -- evidence and uses, on the event loop

    def witness(self, request: Request, evidence: Evidence) -> Evidence:
        """The evidence with people's answers to this very request, and with a prior leave that is in force.

        A use that is there is reserved for the request, until it is consumed or released.
        """
        chain = evidence.chain
        if not isinstance(chain, Chain):
            return evidence
        known = registered(self._approvers)
        with self._lock:
            now_s, approval, named = self._wall_s(), None, ""
            if (chosen := self._choose(holder_of(chain, request), known, now_s)) is not None:
                deferral, counted, standing = chosen
                approval = deferral.reserve(request.request_id, evidence.at_ms, counted, standing)
                named = approval.opening_id
            if approval is None or approval.state in BESIDE:
                inside = self._envelopes.reading(chain, request, evidence, known, now_s=now_s)
                approval = approval if inside is None else inside
            opening = self._leaves.reading(chain, request, known, named=named, now_s=now_s, at_ms=evidence.at_ms)
        return replace(evidence, approval=approval, opening=opening)

    def _choose(
        self, holder: Holder, registered: Mapping[bytes, str], now_s: float
    ) -> tuple[Deferral, Tally, str] | None:
        """The newest answer that can matter, else the newest open question, else the newest answer that is over."""
        mine = [(d, d.count(registered)) for d in reversed(self._deferrals.values()) if d.key[0] == holder]
        states = [(d, counted, d.standing(counted, now_s)) for d, counted in mine]
        now_ms = self._clock.monotonic_ms()
        for wanted in (("denied", "granted"), ("open",), ("used", "withdrawn", "expired")):
            for chosen in states:
                # a no stands as long as the question would have
                if chosen[2] in wanted and (chosen[2] != "denied" or now_ms < chosen[0].ask.expires_ms):
                    return chosen
        return None

    def consume(self, decision: Decision) -> bool:
        """True when the use that the decision names belongs to this request from now on, or it names none.

        To be called before the decision's record is handed to the journal: from there on the record may be durable.
        """
        if decision.approval is None:
            return True
        with self._lock:
            id_, request_id, use = decision.approval.ask_id, decision.request_id, decision.approval.use
            deferral = self._deferrals.get(id_)
            if deferral is None:
                return self._envelopes.consume(id_, request_id, use, self._clock.monotonic_ms())
            opening_id = deferral.question.opening_id
            if opening_id and not self._leaves.consume(opening_id, request_id):
                return False
            if deferral.consume(request_id, use, self._clock.monotonic_ms()):
                return True
            self._leaves.give_back(opening_id, request_id)
            return False

    def stands(self, decision: Decision) -> bool:
        """True while the answer whose use the decision names still counts, or it names none."""
        if decision.approval is None:
            return True
        known, id_ = registered(self._approvers), decision.approval.ask_id
        with self._lock:
            now_s, deferral = self._wall_s(), self._deferrals.get(id_)
            if deferral is None:
                return self._envelopes.stands(id_, known, now_s=now_s)
            opening_id = deferral.question.opening_id
            if opening_id and not self._leaves.stands(opening_id, known, now_s=now_s):
                return False
            counted = deferral.count(known)
            granted = deferral.state is AskState.GRANTED and counted.count is Count.GRANTED
            return granted and now_s <= counted.not_after

    def release(self, request_id: str) -> None:
        """Frees the uses that were only reserved for the request. Consumed ones stay consumed."""
        with self._lock:
            for deferral in self._deferrals.values():
                deferral.release(request_id)
            self._envelopes.release(request_id)

    def give_back(self, decision: Decision) -> None:
        """Returns the use of a PERMIT, of which the journal says that nothing was or can be sent."""
        if decision.approval is None:
            return
        with self._lock:
            deferral = self._deferrals.get(decision.approval.ask_id)
            if deferral is not None:
                deferral.give_back(decision.request_id, decision.approval.use)
                self._leaves.give_back(deferral.question.opening_id, decision.request_id)
            else:
                self._envelopes.give_back(decision.approval.ask_id, decision.request_id, decision.approval.use)

    # -- questions, beside the event loop

    def consult(self, *, request: Request, evidence: Evidence, decision: Decision) -> tuple[AskState, AskNotice | None]:
        """The deferral that stands for this agent, this very request and this question, opened now when there is none.

        An expired one is told once; the next identical request asks anew. A new one is on record before this returns.

        Args:
            request: deferred.
            evidence: on which; its chain is verified.
            decision: the DEFER.

        Returns:
            `OPEN`, `EXPIRED` or `REFUSED` with the deferral; `REFUSED` with None when there is no room for another.

        Raises:
            pep.base.errors.JournalError: when it could not be recorded; nobody is asked then.
            StatementError, ValueError: when it is nothing that people could be asked.
        """
        self.expire()
        with self._writing:
            if isinstance(evidence.chain, Chain):
                key = (holder_of(evidence.chain, request), frozenset(reasons_of(decision)), decision.tier)
                if (standing := self._standing(key, evidence.approval)) is not None:
                    return standing
            wall_s = self._wall_s()
            expires_at = wall_s + self._timeout_ms / 1000
            question, text, shown = compose(
                request,
                evidence,
                decision,
                asker=self._asker,
                nonce=secrets.token_hex(16),
                asked_at=int(wall_s),
                expires_at=max(int(wall_s) + 1, int(expires_at)),
            )
            ask = self._ask(
                question, text, reason=str(decision.reason), expires_at=expires_at, trace_id=trace_id() or ""
            )
            ask = replace(ask, picture=shown)
            self._journal.append("ask", opened_body(ask))
            with self._lock:
                self._deferrals[ask.ask_id] = Deferral(ask, question, key_of(question))
            return AskState.OPEN, ask

    def _ask(
        self, question: ask_statement.Ask, text: str, *, reason: str, expires_at: float, trace_id: str
    ) -> AskNotice:
        left_ms = min(self._timeout_ms, int((expires_at - self._wall_s()) * 1000 + 0.5))
        return AskNotice(
            ask_id=question.ask_id,
            agent=question.agent,
            request_digest=question.request_digest,
            reason=reason,
            expires_ms=self._clock.monotonic_ms() + left_ms,
            expires_at=expires_at,
            url=self._asker.page(question.ask_id),
            text=text,
            trace_id=trace_id,
            pictured=bool(question.picture_digest),
        )

    def _standing(
        self, key: Key, seen: ApprovalReading | NotCollected | None
    ) -> tuple[AskState, AskNotice | None] | None:
        """Deferral that already stands for this question; a refusal for lack of room; None when it is to be asked.

        A question that was open when the evidence was collected, and was answered since, stands: people have just
        spoken, and the next identical request hears them.
        """
        now_ms = self._clock.monotonic_ms()
        answered = seen.ask_id if isinstance(seen, ApprovalReading) and seen.state == "open" else ""
        with self._lock:
            same = [d for d in self._deferrals.values() if d.key == key]
            for deferral in same:
                if deferral.state is AskState.EXPIRED and not deferral.told:
                    deferral.told = True
                    return AskState.EXPIRED, deferral.ask
                if deferral.state is AskState.REFUSED and now_ms < deferral.refused_until_ms:
                    return AskState.REFUSED, deferral.ask
            for deferral in same:
                just_answered = deferral.ask.ask_id == answered and deferral.state in ANSWERED.values()
                if deferral.state is AskState.OPEN or deferral.awaits_word or just_answered:
                    return AskState.OPEN, deferral.ask
            if sum(d.state is AskState.OPEN for d in self._deferrals.values()) >= CAPACITY:
                return AskState.REFUSED, None
        return None

    def expire(self) -> tuple[AskNotice, ...]:
        """Ends the deferrals whose time is over, each with a denial on record.

        Raises:
            pep.base.errors.JournalError: when one could not be recorded; it then stays open, and the next call tries
            again.
        """
        ended: list[AskNotice] = []
        with self._writing:
            now_ms = self._clock.monotonic_ms()
            with self._lock:
                over = [d for d in self._deferrals.values() if d.state is AskState.OPEN and now_ms >= d.ask.expires_ms]
            for deferral in over:
                self._journal.append("ask-expired", expired_body(deferral.ask.ask_id, deferral.ask.request_digest))
                with self._lock:
                    deferral.state = AskState.EXPIRED
                ended.append(deferral.ask)
            with self._lock:
                self._forget()
        return tuple(ended)

    def _forget(self) -> None:
        """Forgets deferrals that have been over for long.

        One of which its agent has not been told yet is kept longest.
        """
        now_s = self._wall_s()
        closed = [d for d in self._deferrals.values() if d.state is not AskState.OPEN]
        surplus = len(self._deferrals) - KEPT
        for number, deferral in enumerate(closed):
            over = now_s > max(deferral.ask.expires_at, deferral.not_after) + KEPT_S
            untold = deferral.state is AskState.EXPIRED and not deferral.told
            if number < surplus or (over and not untold):
                del self._deferrals[deferral.ask.ask_id]

    def refuse(self, ask_id: str, *, lost: bool = False) -> None:
        """The provider takes no more questions of this agent, or this one is lost: on record, and over.

        Raises:
            pep.base.errors.JournalError: when it could not be recorded.
        """
        with self._writing:
            deferral = self._deferrals.get(ask_id)
            if deferral is None or deferral.state is not AskState.OPEN:
                return
            reason = PICTURE_LOST if lost else str(Reason.ASK_BUDGET_SPENT)
            body = {**expired_body(ask_id, deferral.ask.request_digest), "reason": reason}
            self._journal.append("ask-refused", body)
            with self._lock:
                deferral.state = AskState.LOST if lost else AskState.REFUSED
                deferral.refused_until_ms = self._clock.monotonic_ms() + REFUSED_MS

    def posted(self, ask_id: str) -> None:
        """Notes that the provider has the ask."""
        with self._lock:
            if ask_id in self._deferrals:
                self._deferrals[ask_id].posted = True

    def unposted(self) -> tuple[AskNotice, ...]:
        """Open deferrals that the provider does not have yet."""
        with self._lock:
            return tuple(d.ask for d in self._deferrals.values() if d.state is AskState.OPEN and not d.posted)

    def notice_of(self, ask_id: str) -> AskNotice | None:
        """The open deferral of that id, or None."""
        with self._lock:
            deferral = self._deferrals.get(ask_id)
        return deferral.ask if deferral is not None and deferral.state is AskState.OPEN else None

    def state_of(self, ask_id: str) -> AskState | None:
        """State of a deferral, or None when it is forgotten."""
        with self._lock:
            deferral = self._deferrals.get(ask_id)
            return None if deferral is None else deferral.state

    def awaited(self, chain: Chain, request: Request) -> str | None:
        """Id of the newest open deferral of this very request of its holder, or None."""
        holder = holder_of(chain, request)
        with self._lock:
            mine = (d for d in reversed(self._deferrals.values()) if d.key[0] == holder)
            return next((d.ask.ask_id for d in mine if d.state is AskState.OPEN), None)

    def matter(self) -> int:
        """Number of deferrals, openings and envelopes that a word of the provider could change."""
        with self._lock:
            live = sum(d.state in {AskState.OPEN, AskState.GRANTED} for d in self._deferrals.values())
            return live + len(self._leaves) + len(self._envelopes)

    # -- answers, beside the event loop

    def accept(self, answers: Answers, *, sent_ms: int) -> None:
        """Every vote and opening that verifies is known now, and counts once it is on record.

        Args:
            answers: verified, for this audience, to a nonce of ours.
            sent_ms: monotonic time at which that nonce was sent.

        Raises:
            pep.base.errors.JournalError: when an answer could not be recorded; it then does not count.
        """
        known = registered(self._approvers)
        if not known:
            # No registry was read yet, or it has no approver: no vote can be verified, and none is condemned for it.
            return
        with self._writing:
            for answered in answers.asks:
                with self._lock:
                    deferral = self._deferrals.get(answered.ask_id)
                if deferral is not None:
                    self._count(deferral, answered.votes, known, sent_ms)
            self._take_leaves(answers.openings, sent_ms)
            self._take_envelopes(answers.envelopes, sent_ms)

    def _count(self, deferral: Deferral, texts: Iterable[str], known: Mapping[bytes, str], sent_ms: int) -> None:
        ballots, ask = dict(deferral.ballots), deferral.ask
        for text in texts:
            digest = _digest(text)
            if digest in ballots or digest in deferral.rejected:
                continue
            read = read_vote(text, deferral.question, ask.text, self._approvers, at=self._wall_s(), caps=self._caps)
            if isinstance(read, VerifiedVote):
                ballots[digest] = read
            elif len(deferral.rejected) < answers_statement.VOTES:
                self._reject("vote", ask.ask_id, digest, read)
                deferral.rejected.add(digest)
        counted = replace(deferral, ballots=ballots).count(known)
        state = ANSWERED.get(counted.count, deferral.state)
        if state is not deferral.state and deferral.state in {AskState.OPEN, AskState.GRANTED}:
            if deferral.state is AskState.OPEN and not self._clock.monotonic_ms() < ask.expires_ms:
                return  # too late: its end comes first
            self._journal.append("ask-answered", answered_body(ask, counted, ballots.values()))
        else:
            state = deferral.state
        with self._lock:
            deferral.state, deferral.ballots, deferral.posted = state, ballots, True
            deferral.not_after = max((ballot.vote.not_after for ballot in ballots.values()), default=0)
            deferral.word_ms = sent_ms if deferral.word_ms is None else max(deferral.word_ms, sent_ms)

    def _take_leaves(self, texts: Iterable[str], sent_ms: int) -> None:
        approvers, before, taken = self._approvers.approvers(), self._leaves.by_text(), []
        for text in texts:
            leave = before.get(text) or read_opening(text, self._asker.audience, approvers, caps=self._caps)
            digest = _digest(text)
            if isinstance(leave, VerifiedOpening):
                taken.append(leave)
            elif digest not in self._rejected_openings and len(self._rejected_openings) < KEPT:
                self._reject("opening", "", digest, leave)
                self._rejected_openings.add(digest)
        with self._lock:
            self._leaves.replace(taken, sent_ms=sent_ms)

    def _take_envelopes(self, texts: Iterable[str], sent_ms: int) -> None:
        approvers, before, taken = self._approvers.approvers(), self._envelopes.by_text(), []
        for text in texts:
            envelope = before.get(text) or read_envelope(text, self._asker.audience, approvers, caps=self._caps)
            digest = _digest(text)
            if isinstance(envelope, VerifiedEnvelope):
                taken.append(envelope)
            elif digest not in self._rejected_openings and len(self._rejected_openings) < KEPT:
                self._reject("envelope", "", digest, envelope)
                self._rejected_openings.add(digest)
        with self._lock:
            self._envelopes.replace(taken, sent_ms=sent_ms)

    def _reject(self, what: str, ask_id: str, digest: str, rejected: RejectedStatement) -> None:
        """A statement that does not count is on record, once."""
        body: dict[str, object] = {"what": f"{what}-rejected", "digest": digest, "fault": str(rejected.code)}
        self._journal.append("incident", {**body, "ask_id": ask_id} if ask_id else body)

    # -- restart, before anything else

    def recover(self, records: Iterable[Mapping[str, Any]]) -> None:
        """Deferrals, answers and uses are as an earlier process left them; votes are fetched again before they count.

        An open deferral has what was left of its time by the wall clock, or by the newest record when the clock was
        set back meanwhile. One that this PEP's key did not sign is no question of ours.

        Args:
            records: of the whole journal, oldest first.
        """
        remains = reopen(records, [keys.public_raw(self._asker.key)], self._caps)
        self._high_s = max(self._high_s, remains.high_s)
        with self._lock:
            for left in remains.asks:
                ask = self._ask(
                    left.question,
                    left.text,
                    reason=left.reason,
                    expires_at=left.expires_at,
                    trace_id=left.trace_id,
                )
                deferral = Deferral(ask, left.question, key_of(left.question), state=left.state)
                deferral.not_after, deferral.used = left.not_after, left.used
                self._deferrals[ask.ask_id] = deferral
            for opening_id, request_id in remains.opening_uses:
                self._leaves.recover(opening_id, request_id)
            for envelope_id, use, request_id in remains.envelope_uses:
                self._envelopes.recover(envelope_id, request_id, use)
            self._forget()


def _digest(text: str) -> str:
    """Of a statement's text; one that is not ASCII is no statement, and one is as bad as another."""
    return digest_of(text) if text.isascii() else ""
