"""Identity provider for measurements: its keys come from a seed, and it can also sign forbidden blocks.

`mint` and `delegate` issue as the library does. `forge` signs a hop past every rule of issuing, as a broken or bribed
attester would; verification alone stands against it.
"""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capabilities.keys import keys
from capabilities.keys.trust import TrustBundle
from capabilities.statements.revocation import RevocationView
from capabilities.token import biscuit, block
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind, HopGrant, Sponsor

if TYPE_CHECKING:
    from capabilities.values.errors import Fault
    from capabilities.values.scope import Restriction, Scope

AT: Final = 1_800_000_000
"""The instant of every measurement, seconds since the epoch."""
ATTESTED_AT: Final = AT - 20
ISSUER: Final = "https://idp.example/ztpm"
CELLS: Final = tuple(f"https://cell-{n}.example/mcp" for n in range(4))
"""Audiences; a verifier of this module is the first."""
LEASE_MS: Final = 2_000
VIEW: Final = RevocationView(epoch=1, age_ms=0, revoked=frozenset())
SPONSOR: Final = Sponsor(ISSUER, "alice", "operator-key", ATTESTED_AT)
_TOKEN_ID: Final = keys.b64u(b"a measured token")


@dataclass(frozen=True)
class Issuer:
    """Keys of one identity provider, the same ones for the same seed.

    Attributes:
        seed: of every key.
        root_key_id: in its trust bundle.
    """

    seed: str
    root_key_id: int = 7
    trust: TrustBundle = field(init=False)

    def __post_init__(self) -> None:
        roles = ("attester", "attester-2", "feed", "registry", "ledger", "root", "root-2")
        raw = {role: keys.public_raw(self.key(role)) for role in roles}
        bundle = TrustBundle(
            issuer=ISSUER,
            version=1,
            roots={self.root_key_id: raw["root"], self.root_key_id + 1: raw["root-2"]},
            attesters=frozenset({raw["attester"], raw["attester-2"]}),
            feed=frozenset({raw["feed"]}),
            registry=frozenset({raw["registry"]}),
            ledger=frozenset({raw["ledger"]}),
        )
        object.__setattr__(self, "trust", bundle)

    def key(self, name: str) -> Ed25519PrivateKey:
        """The private key of a role or of an agent."""
        return _key(f"{self.seed} {name}")[0]

    def holder(  # statement of a block about one holder
        self,
        agent: str,
        delegator: str,
        *,
        role: str = "",
        purpose: str = "pick",
        kind: EvidenceKind = EvidenceKind.KEY,
    ) -> HopGrant:
        """Statement about a holder: key and hop id are those of its name."""
        return HopGrant(
            hop_id=hashlib.sha256(agent.encode(errors="surrogatepass")).hexdigest()[:32],
            agent=agent,
            key=_key(f"{self.seed} agent {agent!r}")[1],
            delegator=delegator,
            purpose=purpose,
            request_digest=bytes(32),
            attestation=Attestation(kind, bytes(32), ATTESTED_AT),
            role=role,
        )

    def mint(self, scope: Scope, hop: HopGrant | None = None, *, token_id: str = _TOKEN_ID) -> bytes:
        """A token of one block. Raises `CapabilityError` as the library does."""
        return mint(
            root=self.key("root"),
            root_key_id=self.root_key_id,
            token_id=token_id,
            sponsor=SPONSOR,
            hop=hop or self.holder("first", SPONSOR.subject),
            scope=scope,
            caps=DEFAULT,
        )

    def delegate(
        self, token: bytes, chain: Chain, hop: HopGrant, restriction: Restriction, *, attester: str = "attester"
    ) -> bytes:
        """The token with one more hop. Raises `CapabilityError` as the library does."""
        return delegate(
            token,
            chain=chain,
            attester=self.key(attester),
            trust=self.trust,
            hop=hop,
            restriction=restriction,
            caps=DEFAULT,
        )

    def forge(self, token: bytes, parent: Scope, index: int, hop: HopGrant, restriction: Restriction) -> bytes:
        """The token with a hop that no rule was asked about, signed with the attester's real key."""
        made = block.HopBlock(index, hop, restriction)
        opened = biscuit.open_token(token, self.trust.roots[self.root_key_id])
        return biscuit.append_hop(opened, block.fact(made), block.checks(made, parent), attester=self.key("attester"))

    def verifier(self) -> Verifier:
        """A verifier that trusts this issuer."""
        return Verifier(self.trust, DEFAULT)


@functools.lru_cache(maxsize=4_096)
def _key(words: str) -> tuple[Ed25519PrivateKey, bytes]:
    """The private key of these words and its public one."""
    private = Ed25519PrivateKey.from_private_bytes(hashlib.sha256(words.encode()).digest())
    return private, keys.public_raw(private)


def verified(verifier: Verifier, token: bytes, *, at: float = AT, audience: str = CELLS[0]) -> Chain | Fault:
    """Answer of the whole of `verify` to a token."""
    return verifier.verify(token, at=at, audience=audience, view=VIEW, lease_ms=LEASE_MS)


def chain_of(verifier: Verifier, token: bytes) -> Chain:
    """The chain of a token that was just issued.

    Raises:
        RuntimeError: when it does not verify, so that nothing that is measured would mean anything.
    """
    found = verified(verifier, token)
    if not isinstance(found, Chain):
        raise RuntimeError(f"an issued token is refused: {found.code} {found.clause} {found.detail}")  # noqa: TRY004
    return found
