"""The bundle of public keys that a verifier trusts, each for a time.

Clauses [TRB-1] to [TRB-3] in docs/spec.md. The bundle that a verifier starts from comes out of band or over an
authenticated channel, never from a token.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Final, assert_never

from capabilities.keys.keys import KEY_BYTES, b64u, check_raw
from capabilities.keys.windows import FOREVER, KEYS_OF_A_ROLE, Role, Standing, TrustedKey, Window, entry
from capabilities.values import strict_json, text
from capabilities.values.errors import BadKeyError, CapabilityError, Fault, FaultCode
from capabilities.values.form import Form, FormError, read, upto, whole

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_ROOT_IDS: Final = 2**32


@dataclass(frozen=True, slots=True)
class TrustBundle:
    """Public keys that a verifier trusts, by role. Raw keys; no key has two roles.

    `roots` to `ledger` hold every key of the bundle, inside its window or not; `root`, `signers` and
    `refusal` ask for the moment.

    Attributes:
        issuer: canonical URL of the identity provider.
        version: grows with each change; part of every cache key.
        roots: by root key id. Roots and attesters are Ed25519: of a P-256 signature in a Biscuit both values of s hold,
            so that one token would have two spellings.
        attesters, feed, registry, ledger: by role.
        windows: when each key is trusted; of every key, and always where none is stated.
        issued_at, valid_until: the bundle holds at `t < valid_until`, seconds since the epoch.
        all_keys: every key of the bundle: none of them may belong to an agent.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a bad key, an empty or crowded role, a bad issuer or times in the wrong order;
            `KEY_WRONG_ROLE` for a key with two roles.
    """

    issuer: str
    version: int
    roots: Mapping[int, bytes]
    attesters: frozenset[bytes]
    feed: frozenset[bytes]
    registry: frozenset[bytes]
    ledger: frozenset[bytes]
    windows: Mapping[bytes, Window] = field(default_factory=dict)
    issued_at: int = 0
    valid_until: int = FOREVER
    all_keys: frozenset[bytes] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        try:
            text.url(self.issuer, most_bytes=256)
        except CapabilityError:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "the issuer is not a canonical URL") from None
        if self.version < 0:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "the version is not a whole number")
        if not 0 <= self.issued_at < self.valid_until <= FOREVER:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a bundle that ends before it begins")
        object.__setattr__(self, "roots", MappingProxyType(dict(self.roots)))
        if not all(0 <= number < _ROOT_IDS for number in self.roots):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a root key id that is no 32-bit number")
        if len(set(self.roots.values())) != len(self.roots):
            # The id in a token is not signed: two ids of one key would make two spellings of one token.
            raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a root key with two ids")
        roles = [self.of_role(role) for role in Role]
        if not all(1 <= len(raws) <= KEYS_OF_A_ROLE for raws in roles):
            raise BadKeyError(FaultCode.KEY_MALFORMED, f"a role without a key, or with more than {KEYS_OF_A_ROLE}")
        everything = frozenset[bytes]().union(*roles)
        object.__setattr__(self, "all_keys", everything)
        if sum(map(len, roles)) != len(everything):
            raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a key with two roles")
        for raw in everything:
            check_raw(raw)
        if any(len(raw) != KEY_BYTES for raw in (*self.roots.values(), *self.attesters)):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a root or attester that is no Ed25519 key")
        stated = self.windows
        object.__setattr__(
            self, "windows", MappingProxyType({raw: stated.get(raw, Window()) for raw in sorted(everything)})
        )

    def of_role(self, role: Role) -> frozenset[bytes]:
        """Keys of a role, inside their windows or not."""
        match role:
            case Role.ROOT:
                return frozenset(self.roots.values())
            case Role.ATTESTER:
                return self.attesters
            case Role.FEED:
                return self.feed
            case Role.REGISTRY:
                return self.registry
            case Role.LEDGER:
                return self.ledger
            case _:
                assert_never(role)

    # --- at a moment [TRB-2], [TRB-3] --------------------------------------------------------------------------------

    def standing(self, raw: bytes, *, signed_at: float, at: float) -> Standing:
        """Standing of a key at `at`, for a text that claims `signed_at`; both in seconds since the epoch."""
        window = self.windows.get(raw)
        if window is None:
            return Standing.UNKNOWN
        if not at >= window.not_before:
            return Standing.NOT_YET
        if not (at < window.not_after and at < self.valid_until):
            return Standing.OVER
        if window.tainted_at is not None and not signed_at < window.tainted_at:
            return Standing.TAINTED
        return Standing.TRUSTED

    def root(self, number: int, at: float) -> bytes | Fault:
        """The root key of this id, when it is trusted at `at`; else `UNKNOWN_ROOT_KEY`.

        Whether it was tainted before it signed is asked with `refusal`, of the time that the token states.
        """
        raw = self.roots.get(number)
        if raw is None:
            return Fault(FaultCode.UNKNOWN_ROOT_KEY, "TRB-2", Standing.UNKNOWN.value)
        standing = self.standing(raw, signed_at=0, at=at)
        if standing in {Standing.TRUSTED, Standing.TAINTED}:
            return raw
        return Fault(FaultCode.UNKNOWN_ROOT_KEY, "TRB-2", standing.value)

    def signers(self, role: Role, at: float) -> frozenset[bytes]:
        """The keys of a role whose signatures of before a taint, if there is one, are accepted at `at`."""
        wanted = {Standing.TRUSTED, Standing.TAINTED}
        return frozenset(r for r in self.of_role(role) if self.standing(r, signed_at=at, at=at) in wanted)

    def refusal(
        self, root_key_id: int, root_signed_at: int, hops: Iterable[tuple[bytes, int]], *, at: float
    ) -> Fault | None:
        """None when every key under a token is trusted at `at` for its signature; else the first fault.

        To be asked each time that a token is presented: an earlier answer about it does not count.

        Args:
            root_key_id: that the token names.
            root_signed_at: when hop 0 was attested, by the authority block.
            hops: for each further hop, the attester's raw key and the time of the attestation.
            at: seconds since the epoch.
        """
        root = self.root(root_key_id, at)
        if isinstance(root, Fault):
            return root
        standing = self.standing(root, signed_at=root_signed_at, at=at)
        if standing is not Standing.TRUSTED:
            return Fault(FaultCode.UNKNOWN_ROOT_KEY, _clause(standing), standing.value)
        for index, (attester, signed_at) in enumerate(hops, start=1):
            standing = self.standing(attester, signed_at=signed_at, at=at)
            if standing is not Standing.TRUSTED or attester not in self.attesters:
                return Fault(FaultCode.HOP_NOT_ATTESTED, _clause(standing), f"hop {index}: {standing.value}")
        return None

    def span(self, root_key_id: int, root_signed_at: int, hops: Iterable[tuple[bytes, int]]) -> tuple[int, int]:
        """Time span in which `refusal` finds nothing against these, its end excluded; (0, 0) for never.

        Args:
            root_key_id: that the token names.
            root_signed_at: when hop 0 was attested, by the authority block.
            hops: for each further hop, the attester's raw key and the time of the attestation.
        """
        start, end = 0, self.valid_until
        root = self.roots.get(root_key_id)
        if root is None:
            return 0, 0
        signed = [(root, root_signed_at), *hops]
        if not self.attesters.issuperset([attester for attester, _ in signed[1:]]):
            return 0, 0
        for raw, signed_at in signed:
            window = self.windows[raw]
            if window.tainted_at is not None and not signed_at < window.tainted_at:
                return 0, 0
            start, end = max(start, window.not_before), min(end, window.not_after)
        return start, end

    # --- as JSON [TRB-1] ---------------------------------------------------------------------------------------------

    def to_members(self) -> dict[str, object]:
        """The JSON object of the bundle, its lists in the order of their keys' text."""
        sets = [role for role in Role if role is not Role.ROOT]
        return {
            "issuer": self.issuer,
            "version": self.version,
            "issued_at": self.issued_at,
            "valid_until": self.valid_until,
            "roots": {str(number): entry(raw, self.windows[raw]) for number, raw in self.roots.items()},
            **{
                str(role): [entry(raw, self.windows[raw]) for raw in sorted(self.of_role(role), key=b64u)]
                for role in sets
            },
        }

    def to_json(self) -> bytes:
        """The canonical JSON (RFC 8785) of the bundle."""
        return strict_json.canonical(self.to_members())

    @classmethod
    def from_json(cls, raw: bytes) -> TrustBundle:
        """The bundle of its JSON.

        Raises:
            StatementError: `STATEMENT_MALFORMED` when it is no strict JSON object.
            BadKeyError: as `from_members`.
        """
        return cls.from_members(strict_json.parse_object(raw))

    @classmethod
    def from_members(cls, members: Mapping[str, object]) -> TrustBundle:
        """The bundle of its JSON object.

        Raises:
            BadKeyError: `KEY_MALFORMED` for other members or forms; as the constructor.
        """
        try:
            stated = read(_Members, members)
        except FormError as error:
            raise BadKeyError(FaultCode.KEY_MALFORMED, str(error)) from None
        lists = (stated.attesters, stated.feed, stated.registry, stated.ledger)
        if any(len({entry.key for entry in entries}) != len(entries) for entries in lists):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a key twice")
        attesters, feed, registry, ledger = (frozenset(entry.key for entry in entries) for entries in lists)
        return cls(
            issuer=stated.issuer,
            version=stated.version,
            roots={int(number): entry.key for number, entry in stated.roots.items()},
            attesters=attesters,
            feed=feed,
            registry=registry,
            ledger=ledger,
            windows={entry.key: entry.window for entry in chain(stated.roots.values(), *lists)},
            issued_at=stated.issued_at,
            valid_until=stated.valid_until,
        )


class _Members(Form, frozen=True):
    issuer: str
    version: int
    issued_at: int
    valid_until: int
    roots: dict[Annotated[str, whole("0|[1-9][0-9]{0,9}")], TrustedKey]
    attesters: Annotated[tuple[TrustedKey, ...], upto(KEYS_OF_A_ROLE)]
    feed: Annotated[tuple[TrustedKey, ...], upto(KEYS_OF_A_ROLE)]
    registry: Annotated[tuple[TrustedKey, ...], upto(KEYS_OF_A_ROLE)]
    ledger: Annotated[tuple[TrustedKey, ...], upto(KEYS_OF_A_ROLE)]


def _clause(standing: Standing) -> str:
    """Clause that refuses a key of this standing."""
    return "TRB-3" if standing is Standing.TAINTED else "TRB-2"
