"""Passkeys of people: whose an assertion is, and whether a new credential may be one.

Registration is verified by the `webauthn` library; assertions by `capabilities`, as enforcement points verify them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from webauthn import generate_registration_options, options_to_json, verify_registration_response
from webauthn.helpers import decode_credential_public_key
from webauthn.helpers.cose import COSEAlgorithmIdentifier as Algorithm
from webauthn.helpers.decode_credential_public_key import DecodedEC2PublicKey, DecodedOKPPublicKey
from webauthn.helpers.exceptions import WebAuthnException
from webauthn.helpers.structs import (
    AttestationConveyancePreference,
    AttestationFormat,
    AuthenticatorSelectionCriteria,
    ResidentKeyRequirement,
    UserVerificationRequirement,
)

from capabilities.keys import keys
from capabilities.statements.people.assertion import (
    CREDENTIAL_BYTES,
    Assertion,
    RelyingParty,
    Word,
    challenge,
    check,
    login_challenge,
    of_browser,
    relying_party,
)
from capabilities.values.errors import BadKeyError, StatementError
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.parties import RegisteredPerson, Standing
from ztpm_idp.provider.problems import Problem

if TYPE_CHECKING:
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.provider.wire import AssertionBody

ALGORITHMS: Final = [Algorithm.EDDSA, Algorithm.ECDSA_SHA_256]
"""Algorithms of passkeys, the best first.

RS256 is not one: a key here is Ed25519 or P-256, and no RSA key has a form in the registry.
"""
_FORMATS: Final = frozenset({AttestationFormat.NONE, AttestationFormat.PACKED})
"""Attestation formats that a browser gives where none is asked for: none, or the credential's own signature."""
_RP_NAME: Final = "ZTPM"
_EC2_P256: Final = 1
_OKP_ED25519: Final = 6
"""Curves of COSE keys (RFC 9053 section 7.1)."""


@dataclass(frozen=True, slots=True)
class Asserted:
    """A person's passkey that is one now, with what it asserts."""

    person: RegisteredPerson
    key: bytes
    assertion: Assertion


@dataclass(frozen=True, slots=True)
class Credential:
    """A credential that a browser has made: its id in base64url, and its raw public key."""

    id: str
    key: bytes


def party_of(provider: Provider) -> RelyingParty:
    """The relying party of this provider.

    Raises:
        Problem: `PASSKEYS_UNAVAILABLE`.
    """
    party = relying_party(provider.settings.issuer)
    if party is None:
        raise Problem(IdpCode.PASSKEYS_UNAVAILABLE)
    return party


async def asserted(provider: Provider, said: AssertionBody) -> Asserted:
    """The person whose passkey is said to assert something; the assertion is still to be checked.

    Raises:
        Problem: `PASSKEY_UNKNOWN`, or the fault of a signature that is none.
    """
    async with provider.store.read() as view:
        known = await view.people.passkey(said.credential)
        person = None if known is None else await view.party_of_key(known[1])
    if known is None or not isinstance(person, RegisteredPerson) or person.standing is not Standing.ACTIVE:
        raise Problem(IdpCode.PASSKEY_UNKNOWN)
    if known[1] not in person.passkey_keys:
        raise Problem(IdpCode.PASSKEY_UNKNOWN)
    try:
        parts = (keys.unb64u(part) for part in (said.authenticator, said.client, said.signature))
        return Asserted(person, known[1], of_browser(*parts, key=known[1]))
    except (BadKeyError, StatementError) as error:
        raise Problem(error.code, error.detail) from None


async def verified_login(provider: Provider, said: AssertionBody, *, nonce: str) -> RegisteredPerson:
    """The person whose passkey asserts the login with this nonce, which its caller uses once.

    Args:
        provider: of the store and the issuer.
        said: as the browser sent it.
        nonce: the provider's, fresh for this login; the browser's challenge is `assertion.login_challenge` of it.

    Raises:
        Problem: `PASSKEYS_UNAVAILABLE`, `PASSKEY_UNKNOWN`, `STATEMENT_MALFORMED`, `STATEMENT_WRONG_KIND` or
            `STATEMENT_UNTRUSTED`.
    """
    party, found = party_of(provider), await asserted(provider, said)
    expected = login_challenge(provider.settings.issuer, nonce)
    try:
        check(found.assertion, expected=expected, party=party, key=found.key)
    except StatementError as error:
        raise Problem(error.code, error.detail) from None
    return found.person


def enrolment_challenge(enrolment_id: str, person: str) -> bytes:
    """The challenge of a registration, 32 bytes."""
    return challenge(Word.ENROLMENT, {"enrolment_id": enrolment_id, "person": person})


def options(party: RelyingParty, person: RegisteredPerson, enrolment_id: str) -> dict[str, Any]:
    """Options of a registration, for `PublicKeyCredential.parseCreationOptionsFromJSON`."""
    made = generate_registration_options(
        rp_id=party.rp_id,
        rp_name=_RP_NAME,
        user_id=person.id.encode(),
        user_name=person.id,
        user_display_name=person.name,
        challenge=enrolment_challenge(enrolment_id, person.id),
        attestation=AttestationConveyancePreference.NONE,
        authenticator_selection=AuthenticatorSelectionCriteria(
            resident_key=ResidentKeyRequirement.REQUIRED, user_verification=UserVerificationRequirement.REQUIRED
        ),
        supported_pub_key_algs=ALGORITHMS,
    )
    shown: dict[str, Any] = json.loads(options_to_json(made))
    return shown


def registered(party: RelyingParty, said: dict[str, Any], *, expected: bytes) -> Credential:
    """The credential of a registration that holds.

    Nothing is learnt of the authenticator: attestation is not asked for, and none is believed.

    Args:
        party: the pinned relying party.
        said: as the browser sent it.
        expected: the challenge.

    Raises:
        Problem: `PASSKEY_REFUSED`.
    """
    try:
        verified = verify_registration_response(
            credential=said,
            expected_challenge=expected,
            expected_rp_id=party.rp_id,
            expected_origin=party.origin,
            require_user_verification=True,
            supported_pub_key_algs=ALGORITHMS,
        )
        key = _raw(decode_credential_public_key(verified.credential_public_key))
    except (WebAuthnException, BadKeyError, ValueError, TypeError, KeyError, AttributeError) as error:
        # The library's own errors, and those of its parsers on what no browser sends.
        raise Problem(IdpCode.PASSKEY_REFUSED, type(error).__name__) from None
    if verified.fmt not in _FORMATS:
        raise Problem(IdpCode.PASSKEY_REFUSED, "an attestation that nobody asked for")
    if not 0 < len(verified.credential_id) <= CREDENTIAL_BYTES:
        raise Problem(IdpCode.PASSKEY_REFUSED, f"a credential id over {CREDENTIAL_BYTES} bytes")
    return Credential(keys.b64u(verified.credential_id), key)


def _raw(decoded: object) -> bytes:
    """The raw key of a COSE key."""
    match decoded:
        case DecodedEC2PublicKey(crv=curve) if curve == _EC2_P256:
            return keys.p256_raw(decoded.x, decoded.y)
        case DecodedOKPPublicKey(crv=curve) if curve == _OKP_ED25519:
            return keys.check_raw(decoded.x)
        case _:
            raise ValueError("neither P-256 nor Ed25519")
