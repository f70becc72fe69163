"""Description of the authorization server (RFC 8414), and of the provider's own resource (RFC 9728)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.keys import jws
from ztpm_idp.oauth.issuing import CODE, CREDENTIALS, EXCHANGE, REFRESH

if TYPE_CHECKING:
    from collections.abc import Sequence

ALGORITHMS: Final = [jws.EDDSA, jws.ES256]
"""Algorithms of proofs and assertions; the key decides which."""
AUTHORIZE: Final = "/oauth/authorize"
TOKEN: Final = "/oauth/token"  # noqa: S105  a path
INTROSPECT: Final = "/oauth/introspect"
REVOKE: Final = "/oauth/revoke"
JWKS: Final = "/oauth/jwks"
AT_SERVER: Final = "/.well-known/oauth-authorization-server"
AT_OPENID: Final = "/.well-known/openid-configuration"
"""Second place of the description, for clients that look where OpenID providers have theirs."""
AT_RESOURCE: Final = "/.well-known/oauth-protected-resource"


def of_server(issuer: str, *, scopes: Sequence[str], documents: bool) -> dict[str, object]:
    """The metadata of the authorization server.

    Args:
        issuer: base URL.
        scopes: names of the scope templates.
        documents: whether client metadata documents are switched on.
    """
    return {
        "issuer": issuer,
        "authorization_endpoint": issuer + AUTHORIZE,
        "token_endpoint": issuer + TOKEN,
        "jwks_uri": issuer + JWKS,
        "introspection_endpoint": issuer + INTROSPECT,
        "revocation_endpoint": issuer + REVOKE,
        "scopes_supported": list(scopes),
        "response_types_supported": ["code"],
        "response_modes_supported": ["query"],
        "grant_types_supported": [CODE, REFRESH, CREDENTIALS, EXCHANGE],
        "token_endpoint_auth_methods_supported": ["none", "private_key_jwt"],
        "token_endpoint_auth_signing_alg_values_supported": ALGORITHMS,
        "revocation_endpoint_auth_methods_supported": ["none", "private_key_jwt"],
        "revocation_endpoint_auth_signing_alg_values_supported": ALGORITHMS,
        "code_challenge_methods_supported": ["S256"],
        "dpop_signing_alg_values_supported": ALGORITHMS,
        "authorization_response_iss_parameter_supported": True,
        "client_id_metadata_document_supported": documents,
        "authorization_details_types_supported": ["ztpm_delegation"],
    }


def of_resource(issuer: str) -> dict[str, object]:
    """The metadata of the provider's own endpoints, which take DPoP-bound tokens and proofs alone."""
    return {
        "resource": issuer,
        "authorization_servers": [issuer],
        "dpop_bound_access_tokens_required": True,
        "dpop_signing_alg_values_supported": ALGORITHMS,
    }
