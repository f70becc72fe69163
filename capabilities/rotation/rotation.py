r"""The keys of an identity provider over time: prepare, activate, taint, revoke. Clause [TRB-6] in docs/spec.md.

    PREPARED --activate--> ACTIVE --(the next is activated)--> RETIRED --taint--> TAINTED
        \________________________________________________________\__________________\--revoke--> REVOKED

A prepared key is trusted, so that every verifier knows it before it signs. The active key of a role signs. A retired
one is trusted until its tokens are over. Under a tainted one nothing new is accepted, under a revoked one nothing.
The active key can be neither tainted nor revoked: another is activated first, so that every role always has a signer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import KEYS_OF_A_ROLE, Role, Window
from capabilities.values.errors import BadKeyError, FaultCode

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.values.caps import Caps

BUNDLE_LIFETIME_S: Final = 366 * 86_400
"""Lifetime of a published bundle: a year, like the signed description of a cell."""


class KeyState(StrEnum):
    """State of a key in its life."""

    PREPARED = "prepared"
    ACTIVE = "active"
    RETIRED = "retired"
    TAINTED = "tainted"
    REVOKED = "revoked"


class RotationFault(StrEnum):
    """Reason for which a step is refused."""

    KEY_UNKNOWN = "KEY_UNKNOWN"
    KEY_IN_USE = "KEY_IN_USE"
    ALREADY_PREPARED = "ALREADY_PREPARED"
    TOO_MANY_KEYS = "TOO_MANY_KEYS"
    STILL_ACTIVE = "STILL_ACTIVE"
    WRONG_STATE = "WRONG_STATE"
    CLOCK_BACKWARDS = "CLOCK_BACKWARDS"


@dataclass(frozen=True, slots=True)
class RotationRefused:
    """A step that is not taken; the ring stays as it was."""

    why: RotationFault
    detail: str = ""


@dataclass(frozen=True, slots=True)
class KeyRecord:
    """Key of the provider and the times of its steps, seconds since the epoch; None: not done.

    Attributes:
        role, number: together its name; the number of a root key is the root key id of its tokens.
        key: raw public key.
        prepared_at, activated_at, retired_at, tainted_at, revoked_at: never one before an earlier one.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a bad key, or steps in an order that no ring takes.
    """

    role: Role
    number: int
    key: bytes
    prepared_at: int
    activated_at: int | None = None
    retired_at: int | None = None
    tainted_at: int | None = None
    revoked_at: int | None = None

    def __post_init__(self) -> None:
        keys.check_raw(self.key)
        done = [t for t in (self.prepared_at, self.activated_at, self.retired_at, self.tainted_at) if t is not None]
        times = done if self.revoked_at is None else [*done, self.revoked_at]
        whole = (
            0 <= self.number < 2**32
            and times[0] >= 0
            and times == sorted(times)
            and (self.activated_at is not None or self.retired_at is None)
            and (self.retired_at is not None or self.tainted_at is None)
            and (self.retired_at is not None or self.activated_at is None or self.revoked_at is None)
        )
        if not whole:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "steps that no key takes")

    @property
    def id(self) -> str:
        """Its name, for people and files: "root-2"."""
        return f"{ID_STEM[self.role]}-{self.number}"

    @property
    def state(self) -> KeyState:
        """State of the key, set by the last step that was taken."""
        steps = (
            (self.revoked_at, KeyState.REVOKED),
            (self.tainted_at, KeyState.TAINTED),
            (self.retired_at, KeyState.RETIRED),
            (self.activated_at, KeyState.ACTIVE),
        )
        return next((state for at, state in steps if at is not None), KeyState.PREPARED)


ID_STEM: Final = {
    Role.ROOT: "root",
    Role.ATTESTER: "attester",
    Role.FEED: "feed",
    Role.REGISTRY: "registry",
    Role.LEDGER: "ledger",
}


@dataclass(frozen=True, slots=True)
class KeyRing:
    """Every key that an identity provider has or had.

    No key is ever forgotten, so none comes back in another role.

    Attributes:
        issuer: canonical URL of the identity provider.
        version: of the trust bundle; every step makes it one more.
        issued_at: when the last step was taken, seconds since the epoch.
        records: in the order in which they were prepared.

    Raises:
        BadKeyError: `KEY_MALFORMED` when a role has not exactly one active key or more than one prepared, a name occurs
            twice, or a step lies after `issued_at`; `KEY_WRONG_ROLE` when a key occurs twice.
    """

    issuer: str
    version: int
    issued_at: int
    records: tuple[KeyRecord, ...]

    def __post_init__(self) -> None:
        if len({record.key for record in self.records}) != len(self.records):
            raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a key twice")
        if len({record.id for record in self.records}) != len(self.records):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a name twice")
        for role in Role:
            states = [record.state for record in self.records if record.role is role]
            if states.count(KeyState.ACTIVE) != 1 or states.count(KeyState.PREPARED) > 1:
                raise BadKeyError(FaultCode.KEY_MALFORMED, f"not one active and at most one prepared key of {role}")
        if any(_last_step(record) > self.issued_at for record in self.records):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a step after the last one")

    def active(self, role: Role) -> KeyRecord:
        """The key of a role that signs."""
        return next(r for r in self.records if r.role is role and r.state is KeyState.ACTIVE)

    def find(self, id_: str) -> KeyRecord | None:
        """The key of a name."""
        return next((record for record in self.records if record.id == id_), None)

    @property
    def all_keys(self) -> frozenset[bytes]:
        """Every key that the provider ever had: nobody else may have one of them."""
        return frozenset(record.key for record in self.records)

    def bundle(self, caps: Caps, *, lifetime_s: int = BUNDLE_LIFETIME_S) -> TrustBundle:
        """Trust bundle that verifiers are to use.

        A retired key is trusted for as long as the longest token lives, and a skew of clocks more. No key is trusted
        for longer than the bundle, which a `renew` makes anew.
        """
        valid_until = self.issued_at + lifetime_s
        overlap_s = caps.lifetime_s + caps.skew_s
        windows: dict[KeyRecord, Window] = {}
        for record in self.records:
            over_at = valid_until if record.retired_at is None else min(valid_until, record.retired_at + overlap_s)
            if record.revoked_at is None and self.issued_at < over_at:
                windows[record] = Window(max(0, record.prepared_at - caps.skew_s), over_at, record.tainted_at)
        of = {role: [record for record in windows if record.role is role] for role in Role}
        return TrustBundle(
            issuer=self.issuer,
            version=self.version,
            roots={record.number: record.key for record in of[Role.ROOT]},
            attesters=frozenset(record.key for record in of[Role.ATTESTER]),
            feed=frozenset(record.key for record in of[Role.FEED]),
            registry=frozenset(record.key for record in of[Role.REGISTRY]),
            ledger=frozenset(record.key for record in of[Role.LEDGER]),
            windows={record.key: window for record, window in windows.items()},
            issued_at=self.issued_at,
            valid_until=valid_until,
        )


def begin(issuer: str, first: dict[Role, bytes], *, at: int) -> KeyRing:
    """A ring of one active key for each role, number 1.

    Raises:
        BadKeyError: as `KeyRing`.
    """
    return KeyRing(issuer, 1, at, tuple(KeyRecord(role, 1, raw, at, at) for role, raw in first.items()))


# --- steps -----------------------------------------------------------------------------------------------------------


def prepare(ring: KeyRing, role: Role, key: bytes, *, at: int) -> KeyRing | RotationRefused:
    """A further key of a role is trusted from now on; it does not sign yet.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a bad key.
    """
    of_role = [record for record in ring.records if record.role is role]
    if key in ring.all_keys:
        return RotationRefused(RotationFault.KEY_IN_USE, "one key has one role, once")
    if any(record.state is KeyState.PREPARED for record in of_role):
        return RotationRefused(RotationFault.ALREADY_PREPARED, f"activate or revoke the prepared key of {role} first")
    if sum(record.state is not KeyState.REVOKED for record in of_role) >= KEYS_OF_A_ROLE:
        return RotationRefused(RotationFault.TOO_MANY_KEYS, f"{KEYS_OF_A_ROLE} keys of {role}: revoke what is over")
    added = KeyRecord(role, 1 + max(record.number for record in of_role), keys.check_raw(key), at)
    return _stepped(ring, lambda found: found, at, (added,))


def activate(ring: KeyRing, id_: str, *, at: int) -> KeyRing | RotationRefused:
    """The prepared key signs from now on; the one that signed so far is retired."""
    record = ring.find(id_)
    if record is None:
        return RotationRefused(RotationFault.KEY_UNKNOWN, id_)
    if record.state is not KeyState.PREPARED:
        return RotationRefused(RotationFault.WRONG_STATE, f"{id_} is {record.state}")
    role = record.role

    def step(found: KeyRecord) -> KeyRecord:
        if found.id == id_:
            return replace(found, activated_at=at)
        return replace(found, retired_at=at) if found.role is role and found.state is KeyState.ACTIVE else found

    return _stepped(ring, step, at)


def taint(ring: KeyRing, id_: str, *, at: int) -> KeyRing | RotationRefused:
    """Taints a key: its signatures from now on are refused; tokens under it are to be issued again.

    A thief who has the key can sign for earlier times: under a key that is known to be stolen nothing holds, `revoke`.
    """
    record = ring.find(id_)
    match record.state if record is not None else None:
        case None:
            return RotationRefused(RotationFault.KEY_UNKNOWN, id_)
        case KeyState.ACTIVE:
            return RotationRefused(RotationFault.STILL_ACTIVE, f"activate another key in place of {id_} first")
        case KeyState.RETIRED:
            return _marked(ring, id_, at, lambda found: replace(found, tainted_at=at))
        case state:
            return RotationRefused(RotationFault.WRONG_STATE, f"{id_} is {state}")


def revoke(ring: KeyRing, id_: str, *, at: int) -> KeyRing | RotationRefused:
    """Revokes a key: no signature by it is accepted any more, of any time."""
    record = ring.find(id_)
    match record.state if record is not None else None:
        case None:
            return RotationRefused(RotationFault.KEY_UNKNOWN, id_)
        case KeyState.ACTIVE:
            return RotationRefused(RotationFault.STILL_ACTIVE, f"activate another key in place of {id_} first")
        case KeyState.REVOKED:
            return RotationRefused(RotationFault.WRONG_STATE, f"{id_} is revoked")
        case _:
            return _marked(ring, id_, at, lambda found: replace(found, revoked_at=at))


def renew(ring: KeyRing, *, at: int) -> KeyRing | RotationRefused:
    """Renews the bundle: the same keys, for its whole life from now on."""
    return _stepped(ring, lambda found: found, at)


def _marked(ring: KeyRing, id_: str, at: int, mark: Callable[[KeyRecord], KeyRecord]) -> KeyRing | RotationRefused:
    return _stepped(ring, lambda found: mark(found) if found.id == id_ else found, at)


def _stepped(
    ring: KeyRing, step: Callable[[KeyRecord], KeyRecord], at: int, added: tuple[KeyRecord, ...] = ()
) -> KeyRing | RotationRefused:
    if not at >= ring.issued_at:
        # A step in the past would leave a bundle that is younger by its version and older by its time.
        return RotationRefused(RotationFault.CLOCK_BACKWARDS, f"the last step was at {ring.issued_at}")
    return KeyRing(ring.issuer, ring.version + 1, at, (*map(step, ring.records), *added))


def _last_step(record: KeyRecord) -> int:
    times = (record.prepared_at, record.activated_at, record.retired_at, record.tainted_at, record.revoked_at)
    return max(at for at in times if at is not None)
