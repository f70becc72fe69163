"""The API as OpenAPI describes it: queries, forms, media types and proofs, for clients and for tests that read it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute

from capabilities.statements.claims import NONCE
from capabilities.statements.people.answers import STATES
from ztpm_idp.domain.audit import KEY_CHARACTERS
from ztpm_idp.oauth.form import FORM_TYPE
from ztpm_idp.oauth.problem import OAuthError
from ztpm_idp.provider.audit import MOST_ENTRIES
from ztpm_idp.provider.problems import RESPONSES
from ztpm_idp.provider.wire import URL_BYTES
from ztpm_idp.routes import caller

if TYPE_CHECKING:
    from collections.abc import Iterable

    from fastapi import APIRouter, FastAPI
    from fastapi.dependencies.models import Dependant

_TEXT: Final = {"type": "string"}
_JSON: Final[dict[str, Any]] = {}
_NUMBER: Final = {"type": "string", "pattern": "^(0|[1-9][0-9]{0,14})$"}
_WORD: Final = {"type": "string", "minLength": 1, "maxLength": KEY_CHARACTERS}
QUERY: Final[dict[str, dict[str, Any]]] = {
    "since": _NUMBER,
    "news": {"type": "string", "enum": ["1"]},
    "base": _NUMBER,
    "first": _NUMBER,
    "last": _NUMBER,
    "entry": _NUMBER,
    "old": _NUMBER,
    "since_ms": _NUMBER,
    "until_ms": _NUMBER,
    "after": _NUMBER,
    "most": {"type": "string", "pattern": f"^([1-9][0-9]{{0,2}}|{MOST_ENTRIES})$"},
    "form": {"type": "string", "enum": ["rows", "lines", "cef"]},
    "hash": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
    "nonce": {"type": "string", "pattern": f"^{NONCE.pattern}$"},
    "audience": {"type": "string", "format": "uri", "minLength": 1, "maxLength": URL_BYTES},
    "state": {"type": "string", "enum": sorted(STATES)},
    "kind": _WORD,
    "actor": _WORD,
    "agent": _WORD,
    "token": _WORD,
    "object": _WORD,
    "request": _WORD,
    "trace": _WORD,
}
"""Schema of each query parameter of the API; a route takes no other than it names, and each once."""
PROOF: Final = "proof"
"""Name of the one security scheme: a proof of possession of the caller's key, over exactly this request."""
SCHEMES: Final = {
    PROOF: {
        "type": "apiKey",
        "in": "header",
        "name": "DPoP",
        "description": "A DPoP proof (RFC 9449) by a key that is registered, with the SHA-256 of the body as `bdg`.",
    }
}


def query(*needed: str, optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """The OpenAPI description of the query parameters that a route reads itself."""
    return {
        "parameters": [
            {"name": name, "in": "query", "required": name in needed, "schema": QUERY[name]}
            for name in (*needed, *optional)
        ]
    }


def form_body(*needed: str, optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """The OpenAPI description of a form of OAuth: each parameter once, an empty one as if it were absent."""
    schema = {
        "type": "object",
        "properties": {key: {"type": "string", "minLength": 1} for key in needed} | dict.fromkeys(optional, _TEXT),
        "required": list(needed),
    }
    return {"requestBody": {"required": True, "content": {FORM_TYPE: {"schema": schema}}}}


def media(*types: str) -> dict[str, Any]:
    """The OpenAPI description of an answer in one of several forms."""
    return {
        "responses": {
            "200": {"content": {each: {"schema": _JSON if each == "application/json" else _TEXT} for each in types}}
        }
    }


_REFUSED: Final = {
    "type": "object",
    "required": ["error", "error_description"],
    "properties": {
        "error": {"type": "string", "enum": sorted(OAuthError)},
        "error_description": {"type": "string"},
    },
}
OAUTH: Final[dict[int | str, dict[str, Any]]] = {
    group: said | {"content": said["content"] | {"application/json": {"schema": _REFUSED}}}
    for group, said in RESPONSES.items()
}
"""Description of the refusals of OAuth's endpoints (RFC 6749 section 5.2)."""


def described_by(app: FastAPI, routers: Iterable[APIRouter], *, prefix: str) -> dict[str, Any]:
    """The whole description, in which each route that reads a proof says so.

    Args:
        app: the application, all routes included.
        routers: of its routes below the prefix.
        prefix: path of the issuer.
    """
    whole = get_openapi(title=app.title, version=app.version, routes=app.routes)
    whole.setdefault("components", {})["securitySchemes"] = SCHEMES
    for router in routers:
        for route in router.routes:
            if isinstance(route, APIRoute) and _proven(route.dependant):
                for method in route.methods or ():
                    whole["paths"].get(prefix + route.path, {}).get(method.lower(), {})["security"] = [{PROOF: []}]
    return whole


def _proven(dependant: Dependant) -> bool:
    """True where a proof is read: every dependency of `ztpm_idp.routes.caller` reads one."""
    return getattr(dependant.call, "__module__", "") == caller.__name__ or any(map(_proven, dependant.dependencies))
