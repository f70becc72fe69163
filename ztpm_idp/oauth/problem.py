"""Refusals in the form of OAuth (RFC 6749 section 5.2), with our reason code in the description."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from starlette.responses import Response

from capabilities.values.errors import FaultCode
from ztpm_idp.domain.codes import IdpCode

if TYPE_CHECKING:
    from ztpm_idp.domain.codes import Code

NO_STORE: Final = {"Cache-Control": "no-store", "Pragma": "no-cache"}
_UNAUTHORISED: Final = 401


class OAuthError(StrEnum):
    """Errors of the token, introspection and revocation endpoints, and of authorization responses."""

    INVALID_REQUEST = "invalid_request"
    INVALID_CLIENT = "invalid_client"
    INVALID_GRANT = "invalid_grant"
    INVALID_SCOPE = "invalid_scope"
    INVALID_TARGET = "invalid_target"
    """RFC 8707."""
    UNAUTHORIZED_CLIENT = "unauthorized_client"
    UNSUPPORTED_GRANT_TYPE = "unsupported_grant_type"
    UNSUPPORTED_RESPONSE_TYPE = "unsupported_response_type"
    UNSUPPORTED_TOKEN_TYPE = "unsupported_token_type"  # noqa: S105  RFC 7009's word
    ACCESS_DENIED = "access_denied"
    INVALID_DPOP_PROOF = "invalid_dpop_proof"
    USE_DPOP_NONCE = "use_dpop_nonce"
    """RFC 9449."""
    TEMPORARILY_UNAVAILABLE = "temporarily_unavailable"
    SERVER_ERROR = "server_error"


OF_CODE: Final[dict[Code, OAuthError]] = {
    IdpCode.SCOPE_UNKNOWN: OAuthError.INVALID_SCOPE,
    IdpCode.SCOPE_UNFIT: OAuthError.INVALID_SCOPE,
    FaultCode.NOT_NARROWER: OAuthError.INVALID_SCOPE,
    FaultCode.ABOVE_CEILING: OAuthError.INVALID_SCOPE,
    IdpCode.TARGET_REFUSED: OAuthError.INVALID_TARGET,
    IdpCode.CLIENT_UNKNOWN: OAuthError.INVALID_CLIENT,
    IdpCode.MANDATE_UNKNOWN: OAuthError.UNAUTHORIZED_CLIENT,
    IdpCode.MANDATE_NOT_YOURS: OAuthError.UNAUTHORIZED_CLIENT,
    IdpCode.MANDATE_OVER: OAuthError.UNAUTHORIZED_CLIENT,
    IdpCode.MANDATE_REVOKED: OAuthError.UNAUTHORIZED_CLIENT,
    IdpCode.BODY_MALFORMED: OAuthError.INVALID_REQUEST,
    IdpCode.QUERY_MALFORMED: OAuthError.INVALID_REQUEST,
    IdpCode.BODY_TOO_LARGE: OAuthError.INVALID_REQUEST,
    IdpCode.STORE_UNAVAILABLE: OAuthError.TEMPORARILY_UNAVAILABLE,
    IdpCode.SIGNER_UNAVAILABLE: OAuthError.TEMPORARILY_UNAVAILABLE,
    IdpCode.ALLOWANCE_SPENT: OAuthError.TEMPORARILY_UNAVAILABLE,
    IdpCode.RATE_EXCEEDED: OAuthError.TEMPORARILY_UNAVAILABLE,
}
"""Error of each reason code; of any other that a grant is refused for, `invalid_grant`."""
_STATUS: Final = {OAuthError.INVALID_CLIENT: _UNAUTHORISED, OAuthError.TEMPORARILY_UNAVAILABLE: 503}
_TOO_MANY: Final = frozenset(
    {IdpCode.MANDATE_TOKENS_LIVE, IdpCode.REFUSALS_SPENT, IdpCode.ALLOWANCE_SPENT, IdpCode.RATE_EXCEEDED}
)


class OAuthProblem(Exception):  # noqa: N818  RFC 9457's word
    """A refusal on its way to a client.

    Attributes:
        error: code of OAuth.
        description: for developers, ASCII; holds no secret and no text of the caller.
        headers: further headers of the answer.
        status: of HTTP.
    """

    def __init__(
        self, error: OAuthError, description: str, *, headers: dict[str, str] | None = None, status: int | None = None
    ) -> None:
        super().__init__(f"{error}: {description}")
        self.error = error
        self.description = description
        self.headers = headers or {}
        self.status = status or _STATUS.get(error, 400)


def of_refusal(code: Code, detail: str, *, again_s: int | None = None) -> OAuthProblem:
    """The refusal of a reason code; `again_s` is when to send the same request again."""
    error = OF_CODE.get(code, OAuthError.INVALID_GRANT)
    status = 429 if code in _TOO_MANY else None
    headers = None if again_s is None else {"Retry-After": str(again_s)}
    return OAuthProblem(error, f"{code.value}: {detail}" if detail else code.value, headers=headers, status=status)


def answer(problem: OAuthProblem) -> Response:
    """The answer of a refusal."""
    description = "".join(each if " " <= each <= "~" and each not in '"\\' else "?" for each in problem.description)
    body = {"error": problem.error.value, "error_description": description}
    headers = NO_STORE | problem.headers
    if problem.status == _UNAUTHORISED:
        headers["WWW-Authenticate"] = f'Bearer error="{problem.error.value}"'
    return Response(json.dumps(body), status_code=problem.status, headers=headers, media_type="application/json")
