"""Kinds of evidence, one verifier for each: text that is handed in beside an agent's own statement.

The JWS type of what is handed in says which kind it claims to be. It counts as that kind or not at all: none falls back
to kind `key`. `capabilities.token.hop_rules` says what a kind may carry, SECURITY.md what it does not prove.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.keys import keys
from capabilities.statements import release, statement_form, workload, x509_svid
from capabilities.values import strict_json
from capabilities.values.chain import EvidenceKind
from capabilities.values.errors import CapabilityError, FaultCode
from ztpm_idp.domain.codes import Refusal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.attestation import Evidence
    from capabilities.statements.workload import AnyPlatform
    from ztpm_idp.domain.parties import RegisteredAgent
    from ztpm_idp.domain.rules import Rules


@dataclass(frozen=True, slots=True)
class Shown:
    """Result of a verifier.

    Attributes:
        kind: how far the evidence is believed.
        credential: SHA-256 of a bearer that counts once; empty where a nonce of ours is in it.
        until: when the bearer is over, seconds since the epoch.
    """

    kind: EvidenceKind
    credential: bytes = b""
    until: int = 0


class Verifier(Protocol):
    """Verifier of one kind."""

    def __call__(self, rules: Rules, agent: RegisteredAgent, stated: Evidence, at: float) -> Shown | Refusal:
        """Kind that the evidence shows of this agent at `at` (seconds since the epoch), or a refusal."""
        ...


def shown(rules: Rules, agent: RegisteredAgent, stated: Evidence, at: float) -> Shown | Refusal:
    """Kind that an agent's evidence shows, by the verifier of that kind, or a refusal.

    Args:
        rules: with the platforms and publishers that are trusted.
        agent: whose evidence it is.
        stated: the agent's statement, opened with its registered key.
        at: seconds since the epoch.
    """
    try:
        verifier = VERIFIERS.get(_type_of(stated.workload)) if stated.workload else _key
        if verifier is None:
            return _invalid("no kind of evidence that is known here")
        return verifier(rules, agent, stated, at)
    except CapabilityError as error:
        return _invalid(f"workload: {error.code}: {error.detail}")


def _type_of(text: str) -> str:
    """The JWS type of a text, which chooses a verifier and nothing else."""
    named = strict_json.parse_object(keys.unb64u(text.partition(".")[0])).get("typ", _JWT)
    return named if isinstance(named, str) else ""


def _key(_: Rules, __: RegisteredAgent, ___: Evidence, ____: float) -> Shown | Refusal:
    return Shown(EvidenceKind.KEY)


def _jwt(rules: Rules, agent: RegisteredAgent, stated: Evidence, at: float) -> Shown | Refusal:
    """A platform's token: of kind `jwt` where it names key and software ([WLD-5]), else of kind `bearer` ([WLD-8])."""
    platform = _platform(rules, agent)
    if isinstance(platform, Refusal):
        return platform
    found = workload.open(stated.workload, platform, audience=rules.issuer, at=at, caps=rules.caps)
    if found.id != agent.workload:
        return _invalid("the workload token is of another workload than the agent's")
    bearer = workload.digest(stated.workload), found.expires_at
    if not found.key_thumbprint:
        return Shown(EvidenceKind.BEARER, *bearer)
    if found.key_thumbprint != agent.thumbprint:
        return _invalid("the workload token is bound to another key")
    if found.measurement != agent.software_digest:
        return _invalid("the platform measured other software than what is registered")
    return Shown(EvidenceKind.JWT, *bearer)


def _x509(rules: Rules, agent: RegisteredAgent, stated: Evidence, at: float) -> Shown | Refusal:
    """A workload's certificate, and the proof of its key over our nonce and the agent's key ([WLD-7])."""
    platform = _platform(rules, agent)
    if isinstance(platform, Refusal):
        return platform
    if not isinstance(platform, workload.Platform):
        return _invalid("the agent's workload has no X.509-SVID")
    found = x509_svid.open(stated.workload, platform, audience=rules.issuer, nonce=stated.nonce, at=at, caps=rules.caps)
    if found.id != agent.workload:
        return _invalid("the certificate is of another workload than the agent's")
    if found.key_thumbprint != agent.thumbprint:
        return _invalid("the proof is about another key than the agent's")
    return Shown(EvidenceKind.X509)


def _release(rules: Rules, agent: RegisteredAgent, stated: Evidence, at: float) -> Shown | Refusal:
    """A publisher's signed manifest of the software that is registered ([STM-19])."""
    known = frozenset[bytes]().union(*rules.publishers.values())
    if len(stated.workload) > rules.caps.credential_bytes:
        return _invalid(f"a release of over {rules.caps.credential_bytes} bytes")
    found = release.open(stated.workload, known, rules.caps)
    release.check_times(found, at=at, caps=rules.caps)
    signer = statement_form.signer_thumbprint(stated.workload)
    if signer not in map(keys.thumbprint, rules.publishers.get(found.publisher, frozenset())):
        return _invalid("the release is another publisher's than it says")
    if found.measurement != agent.software_digest:
        return _invalid("the release is of other software than what is registered")
    return Shown(EvidenceKind.RELEASE)


_JWT: Final = "JWT"
VERIFIERS: Final[Mapping[str, Verifier]] = {
    _JWT: _jwt,
    "JOSE": _jwt,
    x509_svid.TYPE: _x509,
    statement_form.type_of(release.KIND): _release,
}
"""Verifier by the JWS type of what is handed in; nothing handed in is of kind `key`."""


def _platform(rules: Rules, agent: RegisteredAgent) -> AnyPlatform | Refusal:
    """The platform of the workload that was registered with the agent: never one that evidence names."""
    if not agent.workload:
        return _invalid("the agent is registered without a workload")
    found = rules.platform_of(agent.workload)
    return _invalid("no platform that is trusted now knows the agent's workload") if found is None else found


def _invalid(detail: str) -> Refusal:
    return Refusal(FaultCode.ATTESTATION_INVALID, detail)
