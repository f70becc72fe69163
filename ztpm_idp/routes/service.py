"""State of the service: alive, ready, and the keys to trust."""

from __future__ import annotations

import logging
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse, Response

from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.provider import figures
from ztpm_idp.provider.problems import Problem, answer
from ztpm_idp.routes.caller import heartbeat_of, provider_of
from ztpm_idp.store.errors import StoreUnavailableError

logger = logging.getLogger(__name__)
router = APIRouter()


@router.get("/livez")
@router.get("/healthz")
async def livez() -> dict[str, bool]:
    """The process answers; nothing else is asked, so that no fault of the store has it started again."""
    return {"alive": True}


@router.get("/readyz", response_model=None)
async def readyz(request: Request) -> dict[str, Any] | Response:
    """The store can commit, now; else 503 with the cause.

    `faults` names each setting whose file changed and cannot be acted on, with the reason; what was read before counts.
    A store that is being restored is ready: enforcement points must reach it for its restore to end.
    """
    provider = provider_of(request)
    try:
        await heartbeat_of(request).beat()
        async with provider.store.read() as view:
            restoring = bool((await view.counters()).restoring)
    except StoreUnavailableError as error:
        cause = type(error.__cause__ or error).__name__
        logger.error("not ready, the store cannot commit: %s", cause)  # noqa: TRY400 - no text of the error
        unready = {"ready": False, "causes": {"store": cause}}
        return answer(IdpCode.STORE_UNAVAILABLE, f"the store cannot commit: {cause}", members=unready)
    beside = {"faults": dict(provider.faults)} if provider.faults else {}
    return {"ready": True, **beside, **({"restoring": True} if restoring else {})}


@router.get("/metrics", response_class=PlainTextResponse)
async def metrics(request: Request) -> Response:
    """Figures of this process, and of the store as it is now, in Prometheus' text form.

    Read from the provider's own machine alone, or with the bearer token of `metrics_token_file`.
    """
    state = request.app.state
    client = "" if request.client is None else request.client.host
    given = request.headers.getlist("authorization")
    forwarded = "x-forwarded-for" in request.headers or "forwarded" in request.headers
    if not state.metrics_access.may_read(client, given[0] if len(given) == 1 else None, forwarded=forwarded):
        raise Problem(IdpCode.NOT_PERMITTED, "figures are read on this machine, or with the token of the settings")
    text = await figures.text(state.metrics, provider_of(request), heartbeat_of(request))
    return Response(text, media_type=figures.MEDIA_TYPE, headers={"Cache-Control": "no-store"})


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
