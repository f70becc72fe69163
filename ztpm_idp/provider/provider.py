"""The identity provider at work: a command goes through the pure domain inside one transaction of the store.

Order of every change: load, decide, make the token if there is one, write, commit, answer. An answer is durable.
"""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from capabilities import tracing
from capabilities.rotation.succession import ring_follows
from capabilities.statements import trust as trust_statement
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.token.verify import token_to_text
from capabilities.values import trace_context
from capabilities.values.errors import CapabilityError, FaultCode
from ztpm_idp.domain.changes import ChangeKind, ChangeState
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.commands import CompleteRecovery, Delegate, Revoke
from ztpm_idp.domain.core import caller_refused, decide
from ztpm_idp.domain.events import Revoked, TokenDelegated, TokenIssued
from ztpm_idp.domain.joint import claim, union
from ztpm_idp.domain.lending import allowances
from ztpm_idp.domain.locks import EVERYTHING, locks_of
from ztpm_idp.domain.login.devices import within
from ztpm_idp.domain.oauth.events import AccessMade
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson
from ztpm_idp.domain.state import State
from ztpm_idp.domain.wanted import wanted
from ztpm_idp.keys import key_ring, oauth_keys
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.provider.done import Done, OneUse
from ztpm_idp.provider.epoch_wait import EpochWait
from ztpm_idp.provider.feed import BaseHeads, read_back
from ztpm_idp.provider.joint_work import JointWork, Work
from ztpm_idp.provider.metrics import DONE, FAILED
from ztpm_idp.provider.news import News
from ztpm_idp.provider.problems import Problem
from ztpm_idp.provider.stated_rules import rules_of
from ztpm_idp.store import AgainError, ConflictError, LocksTooFewError, Made, OnceOnlyError, ProofUse, ProofUsedError
from ztpm_idp.store.allowances import Counted

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from capabilities.proof.proof import Proof
    from capabilities.statements.workload import AnyPlatform
    from policies.decision.policy import PolicySet
    from ztpm_idp.domain.commands import Command
    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.locks import Locks
    from ztpm_idp.domain.login.records import SessionKey
    from ztpm_idp.domain.parties import Party
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import Wanted
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.provider.joint_work import Outcomes
    from ztpm_idp.provider.metrics import Metrics
    from ztpm_idp.settings import Settings
    from ztpm_idp.store import Store


TRIES: Final = 5
"""Times that a command is tried while other transactions are in its way; after that the store is unavailable."""


class Provider:
    """Provider that the routes use: it alone may change the state.

    Args:
        settings, keys, store: of this deployment.
        now: wall clock, seconds since the epoch.
        platform: the platform whose word on workloads is trusted from the start, if any.
        policies: the set that decides on delegations.
        oauth: keys of the authorization server, or None: there is none here.
        publishers: raw public keys by name of each whose releases are trusted.
        metrics: count commands and transactions; None: nobody does.

    Attributes:
        epochs: requests that wait for the next revocation.
        snapshots: signed registries by audience, each with its line and the versions of registry and trust bundle
            (`provider.feed`).
        base_heads: of the chain of revocations.
        news: of revocations, for those who wait.
        faults: by setting, the reason for which a file that changed is not acted on; the one before still is.
        platform_keys_ms: by platform, when its keys were taken, milliseconds since the epoch.
    """

    def __init__(
        self,
        settings: Settings,
        keys: IdpKeys,
        store: Store,
        now: Callable[[], float],
        *,
        platform: AnyPlatform | None,
        policies: PolicySet,
        oauth: OAuthKeys | None = None,
        publishers: Mapping[str, frozenset[bytes]] = MappingProxyType({}),
        metrics: Metrics | None = None,
    ) -> None:
        self._reserved = frozenset[bytes]() if oauth is None else frozenset(oauth.public.values())
        self._platforms: dict[str, AnyPlatform] = {} if platform is None else {"": platform}
        self.rules = rules_of(
            settings, keys, tuple(self._platforms.values()), policies, publishers, reserved=self._reserved
        )
        self.oauth = oauth
        self.settings = settings
        self.keys = keys
        self.store = store
        self._now = now
        self.epochs = EpochWait(store.epoch)
        self.snapshots: dict[str, tuple[tuple[int, int, int], str]] = {}
        self.base_heads = BaseHeads()
        self.news = News()
        self._recent_tokens: dict[str, tuple[int, int, int]] = {}
        self.faults: dict[str, str] = {}
        self.platform_keys_ms = dict.fromkeys(self._platforms, self.now_ms())
        self._metrics = metrics
        if metrics is not None:
            store.timed = metrics.transaction
        self._signed_trust: tuple[int, tuple[str, ...]] = (-1, ())
        self._lending, self._taking_back = (
            JointWork(self._together, self._by_itself, at_once=at_once) for at_once in (store.at_once, 1)
        )

    def adopt(self, keys: IdpKeys) -> None:
        """Signs with these keys from now on, between two requests: all of them change, or none does.

        Raises:
            SettingsError: `key_ring_file`, for a ring that no steps of a rotation made of the present one, whose bundle
                does not hold now, or which has a key of a platform. Nothing changes then.
        """
        if keys.ring is None or self.keys.ring is None:
            raise SettingsError(key_ring.SETTING, "keys without a ring are read once")
        if (fault := ring_follows(self.keys.ring, keys.ring)) is not None:
            raise SettingsError(key_ring.SETTING, f"{fault.code}: {fault.detail}")
        key_ring.check_current(keys, at=self._now())
        if self._reserved & keys.every_public:
            raise SettingsError(key_ring.SETTING, "a key of the authorization server: one key has one role")
        if any(platform.all_keys & keys.every_public for platform in self.rules.platforms):
            raise SettingsError(key_ring.SETTING, "a key of a platform: one key has one role")
        self.keys, self.rules = keys, self._rules(keys)

    def adopt_oauth(self, keys: OAuthKeys | None) -> None:
        """Signs access tokens with these keys from now on, and takes those that any of them signed.

        Raises:
            SettingsError: `oauth_key_files`, for a key that has another role already, or an authorization server that
                would begin or end. Nothing changes then.
        """
        if keys is None or self.oauth is None:
            if keys is not self.oauth:
                raise SettingsError(oauth_keys.SETTING, "an authorization server begins and ends with a new start")
            return
        public = frozenset(keys.public.values())
        if public & self.keys.every_public or any(platform.all_keys & public for platform in self.rules.platforms):
            raise SettingsError(oauth_keys.SETTING, "a key of the provider or of a platform: one key has one role")
        # A key that was one of these is nobody's afterwards either.
        self._reserved |= public
        self.oauth, self.rules = keys, self._rules(self.keys)

    def trust_platform(self, name: str, platform: AnyPlatform | None) -> None:
        """Believes the word of this platform from now on, in place of what had this name; None: of none.

        Raises:
            SettingsError: for a key of the provider's own, or workloads that another platform has; nothing changes.
        """
        others = {known: each for known, each in self._platforms.items() if known != name}
        if platform is not None:
            if platform.all_keys & (self.keys.every_public | self._reserved):
                raise SettingsError(name, "a key of the provider itself: one key has one role")
            if any(each.holds(platform.root) or platform.holds(each.root) for each in others.values()):
                raise SettingsError(name, "another platform has these workloads already")
        self._platforms = others if platform is None else {**others, name: platform}
        self.platform_keys_ms = {known: self.platform_keys_ms.get(known, 0) for known in others}
        if platform is not None:
            self.platform_keys_ms[name] = self.now_ms()
        self.rules = self._rules(self.keys)

    def _rules(self, keys: IdpKeys) -> Rules:
        now, platforms = self.rules, tuple(self._platforms.values())
        return rules_of(self.settings, keys, platforms, now.policies, now.publishers, reserved=self._reserved)

    def signed_trust(self) -> tuple[str, ...]:
        """The trust bundle, signed by each trusted registry key: once for each bundle, however often it is asked for.

        Raises:
            SignerUnavailableError: a registry key does not sign now.
        """
        if self._signed_trust[0] != self.rules.trust.version:
            signers = self.keys.registry, *self.keys.former_registry
            texts = tuple(trust_statement.sign(self.rules.trust, key) for key in signers)
            self._signed_trust = self.rules.trust.version, texts
        return self._signed_trust[1]

    def now_ms(self) -> int:
        """The wall clock, milliseconds since the epoch."""
        return int(self._now() * 1_000)

    async def known(self, proof: Proof) -> Party:
        """The registered party that made this proof, which is to be used up before anything is answered.

        Raises:
            Problem: `CALLER_UNKNOWN` or `CALLER_INACTIVE`.
        """
        party = await self.store.party_of_key(proof.key)
        if party is None:
            async with self.store.read() as view:
                due = await view.people.due(proof.key, at_ms=self.now_ms())
            if due is not None:
                # A recovery waits for nothing but its person's first request.
                await self.run(CompleteRecovery(due.change_id), actor=due.person)
                party = await self.store.party_of_key(proof.key)
        # A stranger's proof is not stored: strangers change nothing here.
        refused = caller_refused(
            State(parties={} if party is None else {party.id: party}), "" if party is None else party.id
        )
        if party is None or refused is not None:
            raise Problem(IdpCode.CALLER_UNKNOWN if refused is None else refused.code)
        if isinstance(party, RegisteredPerson) and proof.key not in party.keys:
            raise Problem(IdpCode.CALLER_INACTIVE)
        return party

    async def use_up(self, proof: Proof | ProofUse) -> None:
        """The proof is used up.

        Raises:
            Problem: `REPLAYED` for a proof that was used before.
        """
        use = self._use_of(proof)
        if not await self.store.first_use(key=use.key, jti=use.jti, expires_ms=use.expires_ms, at_ms=use.at_ms):
            raise Problem(FaultCode.REPLAYED)

    def _use_of(self, proof: Proof | ProofUse) -> ProofUse:
        if isinstance(proof, ProofUse):
            return proof
        caps = self.rules.caps
        return ProofUse(
            proof.key, proof.jti, expires_ms=(proof.iat + caps.proof_age_s + caps.skew_s) * 1_000, at_ms=self.now_ms()
        )

    async def notice(self, party: Party) -> str:
        """The recovery that waits, for an administrator to be told of with every answer; else nothing."""
        if not isinstance(party, RegisteredPerson) or PersonRole.ADMIN not in party.roles:
            return ""
        at_ms = self.now_ms()
        async with self.store.read() as view:
            waiting = await view.people.open_changes(at_ms=at_ms)
        told = (
            f"recovery {change.change_id}"
            for change in waiting
            if change.kind is ChangeKind.RECOVERY and change.state(at_ms) is ChangeState.OPEN
        )
        return ", ".join(told)

    async def run(
        self,
        command: Command,
        *,
        actor: str,
        session_key: SessionKey | None = None,
        once: OneUse | None = None,
    ) -> Done:
        """The command is done, durably.

        Args:
            command: parsed strictly.
            actor: for the ledger.
            session_key: the session-bound key that signed it, which bounds it; None: the caller's own key did.
            once: of the proof that came with it: in the same commit it is used up, also by a refusal.

        Raises:
            Problem: it is refused; nothing of it holds, but the ledger keeps its record of the attempt.
            StoreUnavailableError: the store failed; nothing may be taken to hold.
        """
        name, end = type(command).__name__, FAILED
        try:
            with tracing.step(trace_context.COMMAND, {trace_context.OPERATION: name}) as span:
                try:
                    done = await self._run(command, actor=actor, session_key=session_key, once=once)
                    end = DONE
                except Problem as refused:
                    end = refused.code.value
                    raise
                finally:
                    span.set_attribute(trace_context.RESULT, end)
        finally:
            if self._metrics is not None:
                self._metrics.command(name, end)
        return done

    async def _run(self, command: Command, *, actor: str, session_key: SessionKey | None, once: OneUse | None) -> Done:
        try:
            outcome, done = await self._tried(command, actor=actor, session_key=session_key, once=once)
        except ProofUsedError:
            raise Problem(FaultCode.REPLAYED) from None
        except OnceOnlyError:
            raise Problem(FaultCode.ATTESTATION_INVALID, "the nonce, or the platform's token, is spent") from None
        except ConflictError:
            raise Problem(IdpCode.CONFLICT) from None
        except CapabilityError as error:
            raise Problem(error.code, error.detail) from None
        if isinstance(outcome, Refusal):
            raise Problem(outcome.code, outcome.detail, outcome.explanation)
        if done is None:
            raise AssertionError
        self.epochs.told(done.epoch)  # after the commit: no caller is woken for an epoch that may still be rolled back
        return done

    async def _tried(
        self, command: Command, *, actor: str, session_key: SessionKey | None, once: OneUse | None
    ) -> tuple[Outcome, Done | None]:
        """The command, beside others that wait where it may be joint with them."""
        needed, trace_id = wanted(command), tracing.trace_id()
        locks = locks_of(command, needed)
        own = None if session_key is not None else claim(command, locks)
        if own is None:
            return await self._alone(
                command, needed, locks, actor=actor, session_key=session_key, once=once, trace_id=trace_id
            )
        # Revocations wait for no other command.
        queue = self._taking_back if isinstance(command, Revoke) else self._lending
        return await queue.done(Work(command, needed, locks, own, actor, once, trace_id))

    async def _alone(
        self,
        command: Command,
        needed: Wanted,
        locks: Locks,
        *,
        actor: str,
        session_key: SessionKey | None,
        once: OneUse | None,
        trace_id: str | None,
    ) -> tuple[Outcome, Done | None]:
        """The command with the locks that it needs, begun again where the database says so, `TRIES` times in all."""
        tries_left = TRIES
        while True:
            try:
                return await self._decided(
                    command, needed, locks, actor=actor, session_key=session_key, once=once, trace_id=trace_id
                )
            except LocksTooFewError:
                locks = EVERYTHING  # these are never too few
                self._again("locks")
            except AgainError:
                tries_left -= 1
                if not tries_left:
                    raise
                self._again("conflict")

    def _again(self, cause: str) -> None:
        if self._metrics is not None:
            self._metrics.repeated(cause)

    async def _by_itself(self, w: Work) -> tuple[Outcome, Done | None]:
        """A command that could be joint, alone."""
        return await self._alone(
            w.command, w.needed, w.locks, actor=w.actor, session_key=None, once=w.once, trace_id=w.trace_id
        )

    async def _decided(
        self,
        command: Command,
        needed: Wanted,
        locks: Locks,
        *,
        actor: str,
        session_key: SessionKey | None,
        once: OneUse | None,
        trace_id: str | None,
    ) -> tuple[Outcome, Done | None]:
        """The command in one transaction: its outcome, and what it has done unless it is refused."""
        at_ms = self.now_ms()
        use = None if once is None or once.spent else self._use_of(once.proof)
        young_ms = at_ms - self.rules.nonce_age_s * 1_000
        async with self.store.write(locks, use=use) as transaction:
            state = await transaction.load(needed, young_ms=young_ms, counted=self._counted(at_ms))
            before = await transaction.counters()
            seen: State | Refusal = state
            if session_key is not None:
                held = await transaction.devices.session_key(session_key.key)
                seen = within(state, command, held, at_ms)
            found = (seen, (), None) if isinstance(seen, Refusal) else self._judged(command, seen, at_ms)
            outcome, written, token = found
            epoch = before.epoch
            if written:
                epoch = await transaction.append(written, actor=actor, at_ms=at_ms, trace_id=trace_id)
            await read_back(self, transaction, written, before=before, at_ms=at_ms)
        if once is not None:
            once.spent = True  # with the commit; where it was rolled back, the use was, too
        return outcome, _done(outcome, epoch, token, state)

    def _counted(self, at_ms: int) -> Counted:
        return Counted(at_ms, self.rules.allowances, self._recent_tokens)

    def _judged(self, command: Command, state: State, at_ms: int) -> tuple[Outcome, tuple[Event, ...], str | None]:
        """Outcome of a command, the events to be written, and the token that it makes, if any."""
        outcome = decide(self.rules, state, command, at_ms)
        if isinstance(outcome, Refusal):
            return outcome, outcome.recorded, None
        token = self._make_token(command, outcome)
        return outcome, _kept(outcome, token), token

    async def _together(self, works: Sequence[Work]) -> Outcomes:
        """Commands of `domain.joint` in one transaction: what became of each, once all of that is durable."""
        at_ms = self.now_ms()
        young_ms = at_ms - self.rules.nonce_age_s * 1_000
        uses = [None if (o := work.once) is None or o.spent else self._use_of(o.proof) for work in works]
        outcomes: Outcomes = {}
        made: list[Made] = []
        async with self.store.write(union(work.locks for work in works), uses=uses) as transaction:
            states = await transaction.load_each(
                [work.needed for work in works], young_ms=young_ms, counted=self._counted(at_ms)
            )
            before = await transaction.counters()
            if before.restoring:
                raise LocksTooFewError  # what that needs to be judged is loaded for one command alone
            for work, unused, state in zip(works, transaction.unused, states, strict=True):
                try:
                    if not unused:
                        raise ProofUsedError  # noqa: TRY301
                    seen = allowances.after(state, work.needed, (each.event for each in made))
                    outcome, written, token = self._judged(work.command, seen, at_ms)
                    if not work.locks.cover(written):
                        raise LocksTooFewError  # noqa: TRY301
                except Exception as error:  # noqa: BLE001  its own, and nobody else's
                    outcomes[work] = error
                else:
                    made += [Made(event, work.actor, work.trace_id) for event in written]
                    epoch = before.epoch + sum(isinstance(each.event, Revoked) for each in made)
                    outcomes[work] = outcome, _done(outcome, epoch, token, state)
            if made:
                await transaction.append_each(made, at_ms=at_ms)
                await read_back(self, transaction, tuple(each.event for each in made), before=before, at_ms=at_ms)
        for work in works:
            if work.once is not None:
                work.once.spent = True  # with the commit, also of one that was refused
        return outcomes

    async def hinted(self, epoch: int | None) -> None:
        """Requests that wait for the epoch are told what the store holds: another process may have revoked.

        Args:
            epoch: that the hint is about; None: some hints may be lost.
        """
        if epoch is None or epoch > self.epochs.highest:  # else it was this process
            self.epochs.told(await self.store.epoch())

    def _make_token(self, command: Command, events: tuple[Event, ...]) -> str | None:
        for event in events:
            match event:
                case TokenIssued():
                    made = mint(
                        root=self.keys.root,
                        root_key_id=self.keys.root_key_id(self.settings.root_key_id),
                        token_id=event.token_id,
                        sponsor=event.sponsor,
                        hop=event.hop,
                        scope=event.scope,
                        caps=self.rules.caps,
                        mandate_id=event.mandate_id,
                    )
                    return token_to_text(made)
                case TokenDelegated() if isinstance(command, Delegate):
                    made = delegate(
                        command.token,
                        chain=event.chain,
                        attester=self.keys.attester,
                        trust=self.rules.trust,
                        hop=event.hop,
                        restriction=event.restriction,
                        caps=self.rules.caps,
                        reserved=self.rules.own_keys,
                    )
                    return token_to_text(made)
                case _:
                    continue
        return None


def _done(outcome: Outcome, epoch: int, token: str | None, state: State) -> Done | None:
    """Result of a command, unless it was refused."""
    return None if isinstance(outcome, Refusal) else Done(outcome, epoch, token, known=bool(state.hops))


def _kept(events: tuple[Event, ...], token: str | None) -> tuple[Event, ...]:
    """The events to be written: an access token's with the capability that was made for it."""
    return tuple(
        replace(event, access=replace(event.access, capability=token or "")) if isinstance(event, AccessMade) else event
        for event in events
    )
