"""Description of a guarded server as an OAuth resource (RFC 9728), wherever stock clients look for it.

It needs no answer of the identity provider, and is told while that is away. There is nothing secret in it and no cookie
behind it, so pages of clients in browsers may read it, too.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from capabilities.keys import jws
from pep.mcp.http_request import answer

if TYPE_CHECKING:
    from starlette.types import Scope, Send

ALGORITHMS: Final = (jws.EDDSA, jws.ES256)
"""Algorithms of proofs; the holder's key decides which."""
WELL_KNOWN: Final = "/.well-known/oauth-protected-resource"
_ANY_ORIGIN: Final = (b"access-control-allow-origin", b"*")
_PREFLIGHT: Final = (
    _ANY_ORIGIN,
    (b"access-control-allow-methods", b"GET, HEAD"),
    (b"access-control-allow-headers", b"*"),
    (b"access-control-max-age", b"600"),
)
_ALLOW: Final = (b"allow", b"GET, HEAD, OPTIONS")


class ResourceDescription:
    """The description of one server.

    Args:
        audience: canonical URL of the server.
        issuer: of the tokens: the authorization server.
        bearer: True where access tokens of OAuth clients are taken, also ones that are bound to no key.

    Attributes:
        url: at which the server's challenges say that it is.
    """

    def __init__(self, *, audience: str, issuer: str, bearer: bool) -> None:
        parts = urlsplit(audience)
        # Clients that know nothing of RFC 9728's path look at the root, and some leave a slash behind.
        places = {WELL_KNOWN, WELL_KNOWN + parts.path}
        self._paths = frozenset(places | {f"{place}/" for place in places})
        self.url = f"{parts.scheme}://{parts.netloc}{WELL_KNOWN}{parts.path}"
        self._text = json.dumps(
            {
                "resource": audience,
                "authorization_servers": [issuer],
                "bearer_methods_supported": ["header"] if bearer else [],
                "dpop_bound_access_tokens_required": not bearer,
                "dpop_signing_alg_values_supported": list(ALGORITHMS),
            }
        ).encode()

    def is_at(self, scope: Scope) -> bool:
        """True for a path at which the description is."""
        return scope["path"] in self._paths

    async def tell(self, scope: Scope, send: Send) -> None:
        """Answers a request for the description; strangers may ask, too."""
        match scope["method"]:
            case "GET":
                await answer(send, 200, self._text, [_ANY_ORIGIN])
            case "HEAD":
                await answer(send, 200, self._text, [_ANY_ORIGIN], bodiless=True)
            case "OPTIONS":
                await send({"type": "http.response.start", "status": 204, "headers": list(_PREFLIGHT)})
                await send({"type": "http.response.body", "body": b""})
            case _:
                await answer(send, 405, b"", [_ALLOW])
