"""State of the service: alive, ready, and the keys to trust."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import Response

from capabilities.statements import trust as signed
from ztpm_idp.routes.caller import heartbeat_of, provider_of

router = APIRouter()


@router.get("/healthz")
async def healthz() -> dict[str, bool]:
    """The process answers."""
    return {"alive": True}


@router.get("/readyz")
async def readyz(request: Request) -> dict[str, bool]:
    """The store can commit, now."""
    await heartbeat_of(request).beat()
    return {"ready": True}


@router.get("/trust")
async def trust(request: Request) -> Response:
    """The public keys of this provider, by role.

    Fetch it over a channel that you trust, once; it is where trust begins.
    """
    return Response(provider_of(request).rules.trust.to_json(), media_type="application/json")


@router.get("/trust/signed")
async def signed_trust(request: Request) -> dict[str, list[str]]:
    """Trust bundle, signed by each trusted registry key, for callers who trust an earlier bundle."""
    provider = provider_of(request)
    keys = provider.keys
    return {"statements": [signed.sign(provider.rules.trust, key) for key in (keys.registry, *keys.former_registry)]}
