"""Parameters of OAuth requests: each once, none empty of meaning, all of them bounded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from urllib.parse import parse_qsl

from ztpm_idp.oauth.problem import OAuthError, OAuthProblem

if TYPE_CHECKING:
    from collections.abc import Mapping

FIELDS: Final = 32
"""Most parameters of one request: those of every extension that we know are fewer."""
FORM_TYPE: Final = "application/x-www-form-urlencoded"


def form_of(raw: bytes, content_type: str) -> dict[str, str]:
    """The parameters of a form.

    Raises:
        OAuthProblem: `invalid_request` for another type, a parameter that comes twice, or no text.
    """
    if content_type.partition(";")[0].strip().lower() != FORM_TYPE:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, f"the content type is {FORM_TYPE}")
    try:
        return parameters(raw.decode("ascii"))
    except UnicodeDecodeError:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "a form is ASCII") from None


def parameters(text: str) -> dict[str, str]:
    """The parameters of a query or form; a parameter without a value counts as absent (RFC 6749 section 3.1).

    Raises:
        OAuthProblem: `invalid_request`, or `invalid_target` for several resources: a token serves one.
    """
    try:
        pairs = parse_qsl(text, keep_blank_values=True, max_num_fields=FIELDS, encoding="utf-8", errors="strict")
    except ValueError:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "parameters that cannot be read") from None
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            error = OAuthError.INVALID_TARGET if name in {"resource", "audience"} else OAuthError.INVALID_REQUEST
            raise OAuthProblem(error, "a parameter comes more than once")
    return {name: value for name, value in pairs if value}


def needed(form: Mapping[str, str], name: str) -> str:
    """The value of a parameter of ours.

    Raises:
        OAuthProblem: `invalid_request` where it is missing.
    """
    found = form.get(name)
    if found is None:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, f"{name} is missing")
    return found
