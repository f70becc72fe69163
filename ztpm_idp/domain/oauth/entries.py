"""Ledger entries of OAuth: no code, no token, no capability."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.oauth.events import (
    AccessMade,
    AssentGiven,
    ClientRegistered,
    CodeSpent,
    FamilyEnded,
    RefreshMade,
    RefreshSpent,
    TemplateDeclared,
    TemplateEnded,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from ztpm_idp.domain.oauth.events import OAuthEvent
    from ztpm_idp.domain.signed import SignedRequest

    Json = dict[str, object]


def entry_of(event: OAuthEvent, told: Callable[[SignedRequest], Json]) -> tuple[str, Json] | None:
    """Kind and body of the event's ledger entry; None for an event that other entries imply.

    Args:
        event: of OAuth.
        told: writer of a signed request.
    """
    match event:
        case ClientRegistered(client=client, signed=signed):
            return "oauth-client-registered", {
                "client_id": client.client_id,
                "name": client.name,
                "key": None if client.key is None else thumbprint(client.key),
                "redirects": list(client.redirects),
                "signed": told(signed),
            }
        case TemplateDeclared(template=template, signed=signed):
            return "oauth-scope-declared", {
                "name": template.name,
                "words": template.words,
                "audience": template.audience,
                "limits": template.limits,
                "signed": told(signed),
            }
        case TemplateEnded(name=name, signed=signed):
            return "oauth-scope-ended", {"name": name, "signed": told(signed)}
        case AssentGiven(code=code):
            family = code.family
            return "oauth-assent-given", {
                "family": family.family,
                "client_id": family.client_id,
                "agent": family.agent,
                "sponsor": family.sponsor,
                "method": family.method,
                "authenticated_at": family.authenticated_at,
                "resource": family.resource,
                "scope": family.scope,
                "limits": family.limits,
                "redirect": code.redirect,
            }
        case AccessMade(access=access):
            return "oauth-access-made", {
                "jti": access.jti,
                "token_id": access.token_id,
                "family": access.family,
                "client_id": access.client_id,
                "actors": list(access.actors),
                "sponsor": access.sponsor,
                "audience": access.audience,
                "scope": access.scope,
                "jkt": access.jkt,
                "not_after": access.not_after,
            }
        case FamilyEnded():
            return "oauth-family-ended", {
                "family": event.family,
                "client_id": event.client_id,
                "sponsor": event.sponsor,
                "reason": event.reason,
            }
        case CodeSpent() | RefreshSpent() | RefreshMade():
            return None
        case _:
            assert_never(event)
