"""Bodies of requests as strict models: a body that passes is clean, bounded and of the right type."""

from __future__ import annotations

from typing import Annotated, Any, Final, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator

from capabilities.keys.keys import check_raw, unb64u
from capabilities.statements import revocation
from capabilities.statements.people.assertion import CREDENTIAL_BYTES
from capabilities.statements.people.picture import PICTURE_BYTES
from capabilities.token import hop_rules
from capabilities.values import text
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import EvidenceKind
from capabilities.values.errors import BadKeyError, ScopeError, StatementError
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.provider.body_json import LARGEST_BYTES, BodyError, parse_json

TEXT_BYTES: Final = 512
"""Longest purpose or reason, as in a token (`Caps.purpose_bytes`)."""
DRAWN_S: Final = max(hop_rules.longest_s(kind, DEFAULT) for kind in EvidenceKind)
"""Longest life of a drawn token, in seconds, that may be asked for."""
CREDENTIAL_CHARACTERS: Final = -(-CREDENTIAL_BYTES * 4 // 3)
"""Longest id of a credential in base64url."""
URL_BYTES: Final = 256
"""Longest URL, as in a token (`Caps.text_bytes`)."""


def _clean(value: str) -> str:
    """Text for people, as a token may carry it, and visible at both ends."""
    try:
        text.prose(value, most_bytes=TEXT_BYTES)
    except ScopeError as error:
        raise ValueError(error.detail) from None
    if value != value.strip():
        raise ValueError("space at an end")
    return value


def _key(value: str) -> str:
    try:
        check_raw(unb64u(value))
    except BadKeyError as error:
        raise ValueError(error.detail) from None
    return value


def _workload(value: str) -> str:
    try:
        return text.workload_id(value) if value else ""
    except ScopeError as error:
        raise ValueError(error.detail) from None


def _url(value: str) -> str:
    try:
        text.url(value, most_bytes=URL_BYTES)
    except ScopeError as error:
        raise ValueError(error.detail) from None
    if not value.startswith(("http://", "https://")):
        raise ValueError("not an HTTP URL")
    return value


def _issuer(value: str) -> str:
    if not value.startswith(("https://", "http://")):
        raise ValueError("not an HTTP URL")
    return value


Name = Annotated[str, StringConstraints(pattern=text.REGISTERED)]
ToolName = Annotated[str, StringConstraints(pattern=text.OPERATION)]
Text = Annotated[str, Field(min_length=1, max_length=TEXT_BYTES), AfterValidator(_clean)]
ShortText = Annotated[str, Field(min_length=1, max_length=128), AfterValidator(_clean)]
KeyText = Annotated[str, Field(min_length=43, max_length=44), AfterValidator(_key)]
LoginIssuer = Annotated[str, StringConstraints(pattern=r"^[!-~]{1,256}$"), AfterValidator(_issuer)]
"""Issuer of an OpenID provider, exactly as it spells itself."""
LoginSubject = Annotated[str, StringConstraints(pattern=r"^[!-~]{1,255}$")]
"""Subject of an identity token (OpenID Connect Core section 2), of visible characters alone."""
Digest = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Workload = Annotated[str, Field(max_length=text.WORKLOAD_BYTES), AfterValidator(_workload)]
Url = Annotated[str, Field(max_length=URL_BYTES), AfterValidator(_url)]
Statement = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+$", max_length=4_096)
]
"""Compact JWS; its content is checked where it is opened."""
EvidenceText = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+$", max_length=12_288)
]
"""As `Statement`, with room for the certificates of an X.509-SVID (`Caps.credential_bytes`), in base64 once more."""
AskText = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+$", max_length=131_072)
]
"""A signed ask: the longest one, of 64 contributors and 32 parameters with the longest names, still fits."""
PictureText = Annotated[str, StringConstraints(pattern=r"^[ -~]*$", max_length=PICTURE_BYTES)]
"""The text of a picture, read strictly by the domain."""
MandateText = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+$", max_length=131_072)
]
"""A signed mandate: the longest scope of a token, spelled out and in base64, still fits."""
MarkText = Annotated[
    str,
    StringConstraints(pattern=r"^[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+$", max_length=DEFAULT.statement_bytes),
]
"""A signed mark, of any length that a statement may have."""
Json = dict[str, Any]


class Body(BaseModel):
    """Base of every body: exact types, no extra field, finite numbers, never changed."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False, hide_input_in_errors=True)


class PersonBody(Body):
    """A person to register."""

    id: Name
    name: ShortText
    key: KeyText
    roles: Annotated[list[Annotated[PersonRole, Field(strict=False)]], Field(min_length=1, max_length=len(PersonRole))]


class KeyBody(Body):
    """A further key of the caller's own."""

    key: KeyText


class LoginBody(Body):
    """A login at another provider for a person."""

    person: Name
    issuer: LoginIssuer
    subject: LoginSubject


class EndLoginBody(Body):
    """A login at another provider that ends."""

    issuer: LoginIssuer
    subject: LoginSubject


class DeviceBody(Body):
    """A command line that asks for its key to be confirmed; the key is the one that signs the request."""

    name: ShortText


class DevicePollBody(Body):
    """A command line that asks how it stands."""

    device_code: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]{43}$")]


class AssertionBody(Body):
    """Assertion of a passkey as a browser has it, in base64url; of P-256 the signature is DER."""

    credential: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$", max_length=CREDENTIAL_CHARACTERS)]
    authenticator: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$", max_length=256)]
    client: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$", max_length=1_024)]
    signature: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$", max_length=128)]


class PasskeyVoteBody(Body):
    """A vote, and the assertion that makes it one."""

    vote: Json
    assertion: AssertionBody


class RegistrationBody(Body):
    """Credential that a browser has made, as `PublicKeyCredential.toJSON` gives it."""

    credential: Json


class PasskeyBody(Body):
    """A passkey that the caller has enrolled, and wants to have: by its raw public key, as it was shown."""

    enrolment_id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{32}$")]
    key: KeyText


class LatchBody(Body):
    """An enforcement point's signed latch."""

    latch: Statement


class ClearingBody(Body):
    """A person's signed clearing of a latch."""

    clearing: Statement


class PasskeyClearingBody(Body):
    """A clearing, and the assertion that makes it one."""

    clearing: Json
    assertion: AssertionBody


class EnvelopeBody(Body):
    """An approver's signed envelope."""

    envelope: Statement


class RolesBody(Body):
    """All the roles that a person has from then on."""

    person: Name
    roles: Annotated[list[Annotated[PersonRole, Field(strict=False)]], Field(min_length=1, max_length=len(PersonRole))]


class EndBody(Body):
    """A person to end."""

    person: Name
    reason: Text


class RecoveryBody(Body):
    """An administrator to recover: a new person, or one that gets this key in place of all others."""

    person: Name
    name: ShortText
    key: KeyText


class ReasonBody(Body):
    """Reason for an end."""

    reason: Text


class MarkBody(Body):
    """An enforcement point's mark, or a part of it."""

    mark: MarkText


class ResumeBody(Body):
    """The end of a restore; `unheard` are the enforcement points that were not heard."""

    unheard: Annotated[list[Name], Field(max_length=256)]


class AgentBody(Body):
    """An agent to register."""

    id: Name
    key: KeyText
    software_digest: Digest
    model: ShortText
    role: Name
    sponsor: Name
    workload: Workload = ""


class EvidenceBody(Body):
    """A stand-alone attestation."""

    evidence: EvidenceText


class TrustBody(Body):
    """An agent's static trust, in thousandths."""

    permille: Annotated[int, Field(ge=0, le=1_000)]


class RestoreBody(Body):
    """Reason for which an agent is restored; with `relearn` its baseline is learned anew."""

    reason: Text
    relearn: bool = False


class PepBody(Body):
    """An enforcement point to register."""

    id: Name
    key: KeyText
    audiences: Annotated[list[Url], Field(min_length=1, max_length=16)]


class SensorBody(Body):
    """A sensor to register."""

    id: Name
    key: KeyText
    calibration: Digest
    transit_ms: Annotated[int, Field(ge=0, le=10_000)]
    audience: Url


class ToolBody(Body):
    """A tool's reviewed definition."""

    audience: Url
    name: ToolName
    definition_digest: Digest
    operation: ToolName
    base_tier: Annotated[int, Field(ge=0, le=4)]


class ToolActBody(Body):
    """A tool of an audience to suspend, restore or retire."""

    audience: Url
    name: ToolName
    reason: Text


class ReplacedKeyBody(Body):
    """Another key of a party."""

    key: KeyText
    reason: Text


class NothingBody(Body):
    """An empty object."""


class IssueRequest(Body):
    """Request that a sponsor signs; the agent's evidence names its canonical form."""

    agent: Name
    purpose: Text
    scope: Json


class IssueBody(Body):
    """A request for a token."""

    request: IssueRequest
    evidence: EvidenceText


class DelegateRequest(Body):
    """Request that a holder signs; the delegate's evidence names its canonical form."""

    delegate: Name
    purpose: Text
    restriction: Json


class DelegateBody(Body):
    """A request for a further hop."""

    request: DelegateRequest
    evidence: EvidenceText


class MandateBody(Body):
    """A sponsor's signed mandate."""

    mandate: MandateText


class DrawRequest(Body):
    """Request of an agent to draw a token; its own evidence names the canonical form."""

    mandate_id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{32}$")]
    lifetime_s: Annotated[int, Field(ge=1, le=DRAWN_S)]


class DrawBody(Body):
    """A request for a token from a mandate."""

    request: DrawRequest
    evidence: EvidenceText


class RevocationBody(Body):
    """Subject of a revocation: an id that the signed index can tell, as enforcement points read it."""

    kind: Annotated[RevocationKind, Field(strict=False)]
    id: Annotated[str, Field(min_length=1, max_length=256)]
    reason: Text

    @model_validator(mode="after")
    def _is_told(self) -> Self:
        try:
            revocation.check_id(self.kind, self.id)
        except StatementError as error:
            raise ValueError(error.detail) from None
        return self


class RecordsBody(Body):
    """A batch of a journal."""

    records: Annotated[list[Json], Field(min_length=1, max_length=1_000)]


class PictureBody(Body):
    """The text of a picture that a record names."""

    picture: PictureText


class AskBody(Body):
    """An enforcement point's signed ask, with the text of the picture that it names, or "" where it names none."""

    ask: AskText
    picture: PictureText = ""


class VoteBody(Body):
    """A person's signed answer to an ask."""

    vote: Statement


class OpeningBody(Body):
    """A person's signed opening."""

    opening: Statement


_FIELDS: Final = frozenset(name for model in Body.__subclasses__() for name in model.model_fields)
"""Names of our own fields: a name that a stranger invented is not repeated to any caller."""

B = TypeVar("B", bound=Body)


def parse_body(model: type[B], raw: bytes) -> B:
    """The body as `model`.

    Raises:
        BodyError: as `parse_json`; `BODY_MALFORMED` for what the model refuses, naming the field and the fault but
            never the value.
    """
    value = parse_json(raw, limit_bytes=LARGEST_BYTES)
    try:
        return model.model_validate(value)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"] if isinstance(part, int) or part in _FIELDS)[:120]
        raise BodyError(IdpCode.BODY_MALFORMED, f"{where or 'body'}: {first['type']}") from None
