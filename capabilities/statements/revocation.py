"""The signed revocation index, and the view that a verifier makes of it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Final

from capabilities.keys import jws, keys
from capabilities.statements import statement_form
from capabilities.statements.claims import (
    AgentId,
    HexDigest,
    Id,
    Name,
    Nonce,
    Thumbprint,
    TokenId,
    Url,
    Whole,
    malformed,
    read,
)
from capabilities.values import strict_json
from capabilities.values.form import Form, plain, upto, words

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain

KIND: Final = "revocation"
ENTRIES: Final = 4_096
"""Most entries of one index; one that is cut, here or earlier, is asked for again from its last epoch."""
NEVER_MS: Final = 2**53 - 1
"""Age of a view that was never made."""
MANDATE_S: Final = 604_800
"""Longest life of a mandate, seconds ([STM-16]); `statements.people.mandate` has the same."""
FIRST_HEAD: Final = "0" * 64
"""Head of the first line before its first revocation."""


class Revoked(StrEnum):
    """Kind of thing that can be revoked.

    Revoking a hop kills everything below it; revoking a sponsor, every tree of that person; revoking a mandate, every
    token that was drawn from it.
    """

    TOKEN = "token"  # noqa: S105 - a word, not a secret
    HOP = "hop"
    AGENT = "agent"
    KEY = "key"
    SPONSOR = "sponsor"
    AUDIENCE = "audience"
    MANDATE = "mandate"


IDS: Final = MappingProxyType(
    {
        Revoked.TOKEN: TokenId,
        Revoked.HOP: Id,
        Revoked.AGENT: AgentId,
        Revoked.KEY: Thumbprint,
        Revoked.SPONSOR: Name,
        Revoked.AUDIENCE: Url,
        Revoked.MANDATE: Id,
    }
)
"""Form of each kind of id: every id that a token can name can be revoked, and no other."""


class RevocationEntry(Form, frozen=True):
    """One revocation: since `epoch`, the thing of `kind` with this id (a key's id is its thumbprint) is dead."""

    epoch: Whole
    kind: Annotated[str, words(*Revoked)]
    id: str


class RevocationBase(Form, frozen=True):
    """Beginning of an index without what has ended everywhere ([STM-18]).

    Attributes:
        epoch: up to here the index has only the entries that had not ended when this one was made; 0: it has no base.
        head: of the line's chain at `epoch`.
        through: epoch up to which the index tells everything that has not ended.
    """

    epoch: Whole = 0
    head: HexDigest = FIRST_HEAD
    through: Whole = 0


NO_BASE: Final = RevocationBase()


class RevocationIndex(Form, frozen=True):
    """Answer of a feed about revocations.

    Attributes:
        issuer: canonical URL of the identity provider.
        epoch: the highest epoch of its store when `as_of_ms` was read.
        since: the epoch that was asked for; `entries` are those after it, the oldest first.
        as_of_ms: wall clock of the identity provider before it read the store, milliseconds since the epoch.
        nonce: of the one who asked, echoed.
        registry_version: version of the registry snapshot at that time.
        entries: ascending by epoch, exactly one for each. Where `last` is below `epoch` the index is cut, and the
            rest is to be asked for before it is acted on.
        line: of the store's history: 0, and a higher one after each restore.
        head: of the chain of the line's revocations at `epoch` (`first_head`, `next_head`).
        base: where it was asked for: up to there entries that have ended are left out.
    """

    issuer: Url
    epoch: Whole
    since: Whole
    as_of_ms: Whole
    nonce: Nonce
    registry_version: Whole
    entries: Annotated[tuple[RevocationEntry, ...], upto(ENTRIES)]
    line: Whole = 0
    head: HexDigest = FIRST_HEAD
    base: RevocationBase = NO_BASE

    @property
    def last(self) -> int:
        """The epoch up to which this index tells everything; the index is whole when that is `epoch`."""
        if self.base != NO_BASE:
            return self.base.through
        return self.entries[-1].epoch if self.entries else self.since


@dataclass(frozen=True, slots=True)
class RevocationView:
    """Revocation view: every id that a verifier knows to be revoked, and the age of that knowledge.

    Attributes:
        epoch: of the newest index that went in.
        age_ms: since the nonce of that index was sent, on the verifier's monotonic clock.
        revoked: (kind, id) pairs.
    """

    epoch: int
    age_ms: int
    revoked: frozenset[tuple[str, str]]

    @classmethod
    def never(cls) -> RevocationView:
        """The view of a feed that was never read: nothing is known, and it is older than any lease."""
        return cls(epoch=0, age_ms=NEVER_MS, revoked=frozenset())

    def spares(self, names: frozenset[tuple[str, str]], *, audience: str) -> bool:
        """True where nothing is revoked of the names that `named` found in a chain, nor the audience."""
        return self.revoked.isdisjoint(names) and (_AUDIENCE, audience) not in self.revoked

    def why(self, chain: Chain, *, audience: str | None = None) -> tuple[str, str] | None:
        """The first (kind, id) by which the chain is dead, from the sponsor down, or None.

        Args:
            chain: a chain that passed steps 1 to 8.
            audience: where the token is presented; None asks for every audience of its scope.
        """
        audiences = sorted(chain.scope.audiences) if audience is None else [audience]
        first, second, *rest = _names(chain)
        candidates = (first, second, *((_AUDIENCE, url) for url in audiences), *rest)
        return next((name for name in candidates if name in self.revoked), None)


# As the pairs spell them: a member of an enumeration makes a new text each time that it is asked for one.
_AUDIENCE: Final = str(Revoked.AUDIENCE)
_SPONSOR: Final = str(Revoked.SPONSOR)
_TOKEN: Final = str(Revoked.TOKEN)
_HOP: Final = str(Revoked.HOP)
_AGENT: Final = str(Revoked.AGENT)
_KEY: Final = str(Revoked.KEY)
_MANDATE: Final = str(Revoked.MANDATE)


def named(chain: Chain) -> frozenset[tuple[str, str]]:
    """Every (kind, id) whose revocation kills the chain, audiences apart."""
    return frozenset(_names(chain))


def _names(chain: Chain) -> list[tuple[str, str]]:
    """Sponsor, token, the mandate where there is one, and of each hop its id, agent and key."""
    names = [(_SPONSOR, chain.sponsor.subject), (_TOKEN, chain.token_id)]
    if chain.mandate_id is not None:
        names.append((_MANDATE, chain.mandate_id))
    for hop in chain.hops:
        names += [(_HOP, hop.hop_id), (_AGENT, hop.agent), (_KEY, keys.b64u(keys.thumbprint_bytes(hop.key)))]
    return names


def first_head(line: int) -> str:
    """Head of a line's chain before its first revocation ([STM-14]): the line's number in 64 hex digits."""
    return f"{line:064x}"


def next_head(head: str, epoch: int, kind: str, id_: str) -> str:
    """Head of the chain after one more revocation ([STM-14])."""
    link = {"epoch": epoch, "head": head, "id": id_, "kind": kind}
    return hashlib.sha256(strict_json.canonical(link)).hexdigest()


def check_id(kind: str, id_: str) -> None:
    """Checks that an id has the form of its kind.

    Raises:
        StatementError: `STATEMENT_MALFORMED` otherwise.
    """
    read(IDS[Revoked(kind)], id_)


def sign(index: RevocationIndex, key: PrivateKey) -> str:
    """The signed index."""
    return statement_form.seal(KIND, plain(index), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> RevocationIndex:  # noqa: A001 - read as revocation.open
    """The index, signed by one of these keys, its entries ascending and inside (since, epoch].

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def read_again(text: str) -> RevocationIndex:
    """The index of a text that `open` has taken before, whose key may have gone since.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    return _read(strict_json.parse_object(jws.split(text, most_bytes=len(text)).payload_raw))


def _read(claims: dict[str, object]) -> RevocationIndex:
    index = read(RevocationIndex, claims)
    for entry in index.entries:
        check_id(entry.kind, entry.id)
    epochs = [index.since, *(entry.epoch for entry in index.entries)]
    if epochs != sorted(epochs) or any(epoch <= index.since for epoch in epochs[1:]) or epochs[-1] > index.epoch:
        raise malformed("entries out of order, or outside what was asked")
    base = index.base
    if base != NO_BASE and not (1 <= base.epoch <= index.epoch and epochs[-1] <= base.through <= index.epoch):
        raise malformed("a base outside its index")
    return index


def ended_after_s(kind: str, caps: Caps) -> int | None:
    """Seconds after its revocation when a thing of this kind has ended at every enforcement point; None: never.

    A token and its hops were made before, and live for the longest lifetime; that skew is added twice, once for the
    reader's leniency and once for its clock. From a mandate tokens were drawn before, within its own longest life.
    Parties, keys and audiences are never over: a store that was put back could lend to them again ([STM-18]).
    """
    match Revoked(kind):
        case Revoked.TOKEN | Revoked.HOP:
            return caps.lifetime_s + 2 * caps.skew_s
        case Revoked.MANDATE:
            return MANDATE_S + caps.lifetime_s + 2 * caps.skew_s
        case _:
            return None
