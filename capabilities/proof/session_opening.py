"""Opening a session for a stream: one proof at its start, and keys that stand for it afterwards.

    holder: pending = begin(...)     sends pending.body and pending.proof, beside the token, to the verifier's address
    verifier: answer(...)            after steps 1 to 9 for the token; gives its half of the session and a text
    holder: conclude(pending, text)  gives the other half

Clauses [SES-1] to [SES-5] in docs/spec.md. Positions in the middle of the connection, and what each is worth:

* Opening a session as the holder takes the leaf key: the opening is the body of an ordinary proof, which names the
  token, the verifier's address and, in the body, the holder's X25519 key of one use. Nobody can put another key there.
* Making frames to the verifier takes that one-use key. So a relay in the middle can hold frames back, cut them off or
  open nothing at all, but it never has the verifier take a frame that the holder did not seal.
* Answering as the verifier takes the verifier's static key, when the holder was told that key beforehand (in `begin`).
  Without one, an attacker on the way can answer in the verifier's stead with a key of its own: then the holder sees
  what the attacker wants it to see, and its frames reach no verifier. The robot is safe, the holder is deceived. So a
  session without a static key is fit only where the way itself is authenticated (TLS, a pipe to a child, loopback with
  the peer's user checked). The opening says which key the holder expects, so that nobody can argue a verifier out of
  signing.
* A static key that is stolen later opens no past session: the keys of one use are gone.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.proof import key_agreement
from capabilities.proof.key_agreement import KEY_BYTES, NONCE_BYTES, PROFILE, Transcript
from capabilities.proof.proof import Proof, check_proof, prove, token_digest
from capabilities.proof.session_frames import Session
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, CapabilityError, Fault, FaultCode, StatementError

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

METHOD: Final = "POST"
_OPENING: Final = frozenset({"audience", "key", "nonce", "profile", "token", "verifier"})
_ANSWER: Final = frozenset({"key", "mac", "nonce", "not_after", "profile", "signature"})
_MOST_BYTES: Final = 2_048
"""Most bytes of an opening or an answer.

The longest has an audience of 256 bytes or a signature of some 300.
"""


@dataclass(frozen=True, slots=True)
class PendingSession:
    """Session that the holder has begun and no verifier has answered.

    It holds a secret: use it once, then forget it.

    Attributes:
        body: the opening, the exact body of the request that carries it.
        proof: text of the proof of that request.
        audience, token, holder_key, verifier_key: as in `Transcript`.
        private, nonce: the holder's own.
    """

    body: bytes
    proof: str
    audience: str
    token: str
    holder_key: bytes
    verifier_key: bytes
    private: bytes = field(repr=False)
    nonce: bytes


@dataclass(frozen=True, slots=True)
class AnsweredSession:
    """A session that the verifier has opened.

    Attributes:
        text: for the holder.
        session: the verifier's end.
        proof: of the opening. It is good for one session: the caller remembers it ([PRF-7]) before it sends the text.
        not_after: when the session ends, seconds since the epoch.
    """

    text: bytes
    session: Session
    proof: Proof
    not_after: int


def begin(
    *,
    key: PrivateKey,
    url: str,
    audience: str,
    token: str,
    verifier_key: bytes | None,
    private: bytes,
    nonce: bytes,
    at: int,
    jti: str,
) -> PendingSession:
    """A session is begun, by the holder of `key`.

    Args:
        key: of the token's leaf hop.
        url: address of the verifier that takes openings, canonical.
        audience: canonical URL of the verifier, as in the token.
        token: its text.
        verifier_key: raw static key of the verifier, from a registry; None only where the way is authenticated.
        private: 32 random bytes, never used before.
        nonce: 32 random bytes, never used before.
        at: seconds since the epoch.
        jti: id of the proof.
    """
    opening: dict[str, object] = {
        "profile": PROFILE,
        "audience": audience,
        "token": token_digest(token),
        "key": keys.b64u(key_agreement.public_of(private)),
        "nonce": keys.b64u(nonce),
        "verifier": "" if verifier_key is None else keys.thumbprint(verifier_key),
    }
    body = strict_json.canonical(opening)
    return PendingSession(
        body=body,
        proof=prove(key, method=METHOD, url=url, body=body, token=token, at=at, jti=jti),
        audience=audience,
        token=token_digest(token),
        holder_key=keys.public_raw(key),
        verifier_key=verifier_key or b"",
        private=private,
        nonce=nonce,
    )


def answer(
    body: bytes,
    proof: str,
    *,
    holder_key: bytes,
    url: str,
    audience: str,
    token: str,
    signer: PrivateKey | None,
    private: bytes,
    nonce: bytes,
    not_after: int,
    at: float,
    most_missing: int,
    caps: Caps,
) -> AnsweredSession | Fault:
    """Verifier's end of the session that this opening asks for, and the text for the holder; or the first fault.

    The token was verified (steps 1 to 9) for `audience`, and its leaf's key is `holder_key`. As long as the session is
    open, the caller asks steps 7 to 9 again as for any request, and closes it when they no longer hold.

    Args:
        body: of the request, exactly as it came.
        proof: text of its proof.
        holder_key: raw key of the token's leaf hop.
        url: the verifier's own configured address for openings.
        audience: the verifier's own canonical URL.
        token: text of the token.
        signer: the verifier's static key, or None.
        private: 32 random bytes, never used before.
        nonce: as `private`.
        not_after: when the session ends at the latest, seconds since the epoch: the end of the token's window.
        at: seconds since the epoch.
        most_missing: as for `Session`.
        caps: the bounds.
    """
    # [SES-1] the opening is the body of a proof by the leaf's key, for this address and token, just now
    proven = check_proof(proof, key=holder_key, method=METHOD, url=url, body=body, token=token, at=at, caps=caps)
    if isinstance(proven, Fault):
        return proven
    # [SES-2] an opening for this verifier and this token, which expects the key that this verifier has
    verifier_key = b"" if signer is None else keys.public_raw(signer)
    wanted = {
        "profile": PROFILE,
        "audience": audience,
        "token": token_digest(token),
        "verifier": keys.thumbprint(verifier_key) if verifier_key else "",
    }
    try:
        opening = _members(body, _OPENING)
        public, holder_nonce = _raw(opening["key"], KEY_BYTES), _raw(opening["nonce"], NONCE_BYTES)
        if any(opening[name] != value for name, value in wanted.items()):
            return Fault(FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-2")
    except CapabilityError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "SES-2", error.detail)
    # [SES-4] it ends with the token, or sooner
    ends = session_end(not_after, at=at, caps=caps)
    if not at < ends:
        return Fault(FaultCode.PROOF_STALE, "SES-4")
    # [SES-3] the keys
    transcript = Transcript(
        audience=audience,
        token=wanted["token"],
        proof=proven.digest,
        holder_key=holder_key,
        verifier_key=verifier_key,
        holder_public=public,
        holder_nonce=holder_nonce,
        verifier_public=key_agreement.public_of(private),
        verifier_nonce=nonce,
        not_after=ends,
    )
    try:
        derived = key_agreement.derive(key_agreement.agree(private, public), transcript)
    except BadKeyError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "SES-3", error.detail)
    # [SES-5] the answer
    signature = "" if signer is None else key_agreement.sign(transcript, signer)
    text = strict_json.canonical(
        {
            "profile": PROFILE,
            "key": keys.b64u(transcript.verifier_public),
            "nonce": keys.b64u(nonce),
            "not_after": ends,
            "signature": signature,
            "mac": keys.b64u(key_agreement.confirmation(derived, transcript, signature)),
        }
    )
    session = Session(
        sending=derived.to_holder,
        receiving=derived.to_verifier,
        at=at,
        not_after=ends,
        most_missing=most_missing,
        caps=caps,
    )
    return AnsweredSession(text, session, proven, ends)


def session_end(not_after: float, *, at: float, caps: Caps) -> int:
    """[SES-4] End of a session that is opened or renewed now, seconds since the epoch.

    Args:
        not_after: end of the token's window, seconds since the epoch.
        at: seconds since the epoch.
        caps: the bounds.
    """
    return min(math.floor(not_after), math.floor(at) + caps.session_lifetime_s)


def conclude(pending: PendingSession, text: bytes, *, at: float, most_missing: int, caps: Caps) -> Session | Fault:
    """The holder's end of the session that this answer opens; or the first fault, and then no session.

    Args:
        pending: the session as begun.
        text: the answer, exactly as it came.
        at: seconds since the epoch.
        most_missing: as for `Session`.
        caps: the bounds.
    """
    # [SES-5] an answer in its one spelling
    try:
        members = _members(text, _ANSWER)
        public, nonce = _raw(members["key"], KEY_BYTES), _raw(members["nonce"], NONCE_BYTES)
        mac = _raw(members["mac"], KEY_BYTES)
    except CapabilityError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "SES-5", error.detail)
    ends, signature = members["not_after"], members["signature"]
    if not isinstance(ends, int) or isinstance(ends, bool) or not isinstance(signature, str):
        return Fault(FaultCode.PROOF_MALFORMED, "SES-5", "a member of a wrong type")
    if members["profile"] != PROFILE:
        return Fault(FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-5")
    # [SES-4] not over yet, and not longer than a session may be
    if not at < ends <= at + caps.skew_s + caps.session_lifetime_s:
        return Fault(FaultCode.PROOF_STALE, "SES-4")
    # [SES-3] the keys
    transcript = Transcript(
        audience=pending.audience,
        token=pending.token,
        proof=hashlib.sha256(pending.proof.encode()).digest(),
        holder_key=pending.holder_key,
        verifier_key=pending.verifier_key,
        holder_public=key_agreement.public_of(pending.private),
        holder_nonce=pending.nonce,
        verifier_public=public,
        verifier_nonce=nonce,
        not_after=ends,
    )
    try:
        derived = key_agreement.derive(key_agreement.agree(pending.private, public), transcript)
    except BadKeyError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "SES-3", error.detail)
    # [SES-5] signed by the expected verifier, or by nobody where none is expected; and it has these keys
    fault = key_agreement.check_answer(derived, transcript, signature, mac)
    if fault is not None:
        return fault
    return Session(
        sending=derived.to_verifier,
        receiving=derived.to_holder,
        at=at,
        not_after=ends,
        most_missing=most_missing,
        caps=caps,
    )


def _members(raw: bytes, names: frozenset[str]) -> dict[str, object]:
    """The members of an object in canonical form that has exactly these; else `STATEMENT_MALFORMED` is raised."""
    if len(raw) > _MOST_BYTES:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "too large")
    members = strict_json.parse_object(raw)
    if members.keys() != names or strict_json.canonical(members) != raw:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not the members of this object in their one spelling")
    return members


def _raw(value: object, size: int) -> bytes:
    """The bytes of a base64url text of this size; `KEY_MALFORMED` is raised for anything else."""
    raw = keys.unb64u(value) if isinstance(value, str) else b""
    if len(raw) != size:
        raise BadKeyError(FaultCode.KEY_MALFORMED, f"not {size} bytes in base64url")
    return raw
