"""State of the service: alive, ready, and the keys to trust."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import Response

from ztpm_idp.routes.caller import heartbeat_of, provider_of

router = APIRouter()


@router.get("/healthz")
async def healthz() -> dict[str, bool]:
    """The process answers."""
    return {"alive": True}


@router.get("/readyz")
async def readyz(request: Request) -> dict[str, Any]:
    """The store can commit, now.

    `faults` names each setting whose file changed and cannot be acted on, with the reason; what was read before counts.
    """
    await heartbeat_of(request).beat()
    faults = provider_of(request).faults
    return {"ready": True, **({"faults": dict(faults)} if faults else {})}


@router.get("/trust")
async def trust(request: Request) -> Response:
    """The public keys of this provider, by role.

    Fetch it over a channel that you trust, once; it is where trust begins.
    """
    return Response(provider_of(request).rules.trust.to_json(), media_type="application/json")


@router.get("/trust/signed")
async def signed_trust(request: Request) -> dict[str, list[str]]:
    """Trust bundle, signed by each trusted registry key, for callers who trust an earlier bundle."""
    return {"statements": list(provider_of(request).signed_trust())}
