"""Steps 1 to 10 for each caller: token against revocation view, proof against token and request, replay."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.keys.keys import b64u, thumbprint_bytes
from capabilities.proof import freshness
from capabilities.proof.dpop import check_plain
from capabilities.proof.proof import Proof, check_proof
from capabilities.statements.revocation import Revoked
from capabilities.token.token_text import token_from_text
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, FaultCode
from pep.base.access_token import disagreement
from pep.journal.replay_cache import proof_name
from policies.evidence.evidence import NOT_COLLECTED, NotCollected

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.token.verify import Verifier
    from capabilities.values.caps import Caps
    from pep.base.access_token import Looked
    from pep.base.ports import Clock, ReplayStore, RevocationFeed

PROOF_CLAUSE: Final = "TOK-10"
AUTHZEN_CLAUSE: Final = "AZN-1"
NO_TOKEN: Final = Fault(FaultCode.TOKEN_MISSING, "TOK-1", "no token was presented")


@dataclass(frozen=True, slots=True)
class PresentedRequest:
    """Credentials of a request as they came over the wire, unverified.

    Attributes:
        token: text of the token, or None when none was presented.
        proof: text of the proof, or None.
        method, url: HTTP method, and the configured canonical URL (never the `Host` header's).
        body: the exact bytes.
    """

    token: str | None
    proof: str | None
    method: str
    url: str
    body: bytes


@dataclass(frozen=True, slots=True)
class Credentials:
    """Result of verifying a caller's credentials.

    Attributes:
        token: bytes of the token, or None when there was none to read.
        chain: the verified chain, or the fault of steps 1 to 9.
        proof: True after step 10, its fault, or `NOT_COLLECTED` after an earlier fault.
        proof_name: name of the proof in the replay store (hex), or "" when no proof was verified.
    """

    token: bytes | None
    chain: Chain | Fault | NotCollected = NOT_COLLECTED
    proof: bool | Fault | NotCollected = NOT_COLLECTED
    proof_name: str = ""

    @property
    def fault(self) -> Fault | None:
        """The first fault, or None when token and proof hold."""
        if isinstance(self.chain, Fault):
            return self.chain
        if isinstance(self.proof, Fault):
            return self.proof
        if isinstance(self.chain, Chain) and self.proof is True:
            return None
        return NO_TOKEN

    @property
    def holder(self) -> str | None:
        """Agent that holds the token, where token and proof hold."""
        return self.chain.leaf.agent if isinstance(self.chain, Chain) and self.proof is True else None


NOBODY: Final = Credentials(None, NO_TOKEN)
"""The caller of a transport that carries no credentials."""


class Authority:
    """Verifier of callers' credentials, with the live revocation view.

    Args:
        verifier: steps 1 to 9, cached by digest.
        feed: the revocation view and its age.
        replay: proof ids seen.
        clock: both clocks.
        caps: bounds.
        audience: canonical URL of this server.
        started_s: earliest time of an accepted proof ([PRF-8], `freshness.earliest_iat_s`): the replay store began with
            what the journal remembers and nothing else.
    """

    def __init__(
        self,
        *,
        verifier: Verifier,
        feed: RevocationFeed,
        replay: ReplayStore,
        clock: Clock,
        caps: Caps,
        audience: str,
        started_s: float,
    ) -> None:
        self.verifier = verifier
        self._feed = feed
        self._replay = replay
        self._clock = clock
        self._caps = caps
        self._audience = audience
        self._started_s = started_s

    def check(self, presented: PresentedRequest, *, lease_ms: int) -> Credentials:
        """The caller's credentials, with the first fault of steps 1 to 10.

        Args:
            presented: the caller's credentials, unverified.
            lease_ms: oldest acceptable revocation view.
        """
        if presented.token is None:
            return NOBODY
        token = token_from_text(presented.token, self._caps)
        if isinstance(token, Fault):
            return Credentials(None, token)
        chain = self.verify(token, lease_ms=lease_ms)
        match chain:
            case Fault():
                return Credentials(token, chain)
            case Chain():
                return self._prove(presented, Credentials(token, chain), chain)
            case _:
                assert_never(chain)

    def check_access(self, presented: PresentedRequest, looked: Looked, *, bearer: bool, lease_ms: int) -> Credentials:
        """Credentials of an OAuth client, with the first fault of the capability and of the proof that it needs.

        Args:
            presented: the access token and, where it is bound, a plain proof; unverified.
            looked: the identity provider's answer about that token.
            bearer: presented as `Bearer`, not as `DPoP`.
            lease_ms: oldest acceptable revocation view.
        """
        token = token_from_text(looked.capability, self._caps)
        if isinstance(token, Fault):
            return Credentials(None, token)
        chain = self.verify(token, lease_ms=lease_ms)
        if isinstance(chain, Fault):
            return Credentials(token, chain)
        # [OAT-3] [OAT-5]
        wrong = disagreement(looked, chain, audience=self._audience)
        if wrong is not None:
            return Credentials(token, wrong)
        so_far = Credentials(token, chain)
        # [OAT-4]
        if looked.jkt is None:
            if not bearer:
                return replace(so_far, proof=Fault(FaultCode.PROOF_WRONG_KEY, "OAT-4", "the token is bound to no key"))
            return replace(so_far, proof=True)
        if bearer or presented.proof is None:
            return replace(so_far, proof=Fault(FaultCode.PROOF_MISSING, "OAT-4", "the token is bound to a key"))
        proof = check_plain(
            presented.proof,
            method=presented.method,
            url=presented.url,
            token=presented.token,
            at=self._clock.wall_s(),
            caps=self._caps,
        )
        if isinstance(proof, Fault):
            return replace(so_far, proof=proof)
        if proof.thumbprint != looked.jkt:
            return replace(so_far, proof=Fault(FaultCode.PROOF_WRONG_KEY, "OAT-4", "the proof is by another key"))
        used = Proof(proof.jti, proof.iat, proof.key, b"")
        return replace(so_far, proof=self._once(used) or True, proof_name=proof_name(proof.key, proof.jti).hex())

    def check_pep(self, presented: PresentedRequest, peps: Mapping[str, bytes]) -> str | Fault:
        """Id of the enforcement point that sends a request with its own key and without a token.

        Args:
            presented: a proof by that key; unverified.
            peps: raw public key of each registered enforcement point of this audience, by its id, as of now.
        """
        if presented.proof is None:
            return Fault(FaultCode.PROOF_MISSING, AUTHZEN_CLAUSE, "no token and no proof were presented")
        proof = check_proof(
            presented.proof,
            key=None,
            method=presented.method,
            url=presented.url,
            body=presented.body,
            token=None,
            at=self._clock.wall_s(),
            caps=self._caps,
        )
        if isinstance(proof, Fault):
            return proof
        pep = next((id_ for id_, key in peps.items() if key == proof.key), None)
        if pep is None:
            return Fault(FaultCode.PROOF_WRONG_KEY, AUTHZEN_CLAUSE, "the key of no enforcement point of this audience")
        if (str(Revoked.KEY), b64u(thumbprint_bytes(proof.key))) in self._feed.view().revoked:
            return Fault(FaultCode.REVOKED, AUTHZEN_CLAUSE, "the key is revoked")
        return self._once(proof) or pep

    def verify(self, token: bytes, *, lease_ms: int) -> Chain | Fault:
        """Steps 1 to 9 as of now; signatures are cached, times and revocation are not."""
        return self.verifier.verify(
            token, at=self._clock.wall_s(), audience=self._audience, view=self._feed.view(), lease_ms=lease_ms
        )

    def standing(self, credentials: Credentials, *, lease_ms: int) -> Chain | Fault:
        """Steps 1 to 9 as of now, for a caller whose credentials were verified; else the fault that they had."""
        if credentials.token is None or credentials.fault is not None:
            return credentials.fault or NO_TOKEN
        return self.verify(credentials.token, lease_ms=lease_ms)

    def _prove(self, presented: PresentedRequest, so_far: Credentials, chain: Chain) -> Credentials:
        """[TOK-10] proof of possession by the leaf's key, and replay.

        The id is stored even where the request is denied later.
        """
        if presented.proof is None:
            return replace(so_far, proof=Fault(FaultCode.PROOF_MISSING, PROOF_CLAUSE, "no proof was presented"))
        proof = check_proof(
            presented.proof,
            key=chain.leaf.key,
            method=presented.method,
            url=presented.url,
            body=presented.body,
            token=presented.token,
            at=self._clock.wall_s(),
            caps=self._caps,
        )
        match proof:
            case Fault():
                return replace(so_far, proof=proof)
            case Proof():
                return replace(
                    so_far, proof=self._once(proof) or True, proof_name=proof_name(proof.key, proof.jti).hex()
                )
            case _:
                assert_never(proof)

    def _once(self, proof: Proof) -> Fault | None:
        # [PRF-8] The store forgets with the process. What had an effect is in the journal and comes back from there;
        # the rest is covered here.
        fault = freshness.before_start(proof.iat, earliest_s=self._started_s)
        if fault is not None:
            return fault
        # [PRF-7] single use
        expires_ms = self._clock.monotonic_ms() + freshness.retention_ms(self._caps)
        if not self._replay.first_use(proof.jti, key=proof.key, expires_ms=expires_ms):
            return Fault(FaultCode.REPLAYED, PROOF_CLAUSE, "the proof was used before")
        return None
