"""The web application: routes under the issuer's path, refusals as problem details, one provider behind them."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
import traceback
from contextlib import asynccontextmanager
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException

from ztpm_idp.console import acting, front, parties, revoking, trail, tree
from ztpm_idp.console.pages import problem_part
from ztpm_idp.console.viewing import is_part
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.keys.key_files import SignerUnavailableError
from ztpm_idp.login.oidc import OpenIdProvider
from ztpm_idp.login.pages import PageProblem, problem_page
from ztpm_idp.oauth.client_documents import fetch
from ztpm_idp.oauth.looking import Lookups
from ztpm_idp.oauth.problem import OAuthProblem, of_refusal
from ztpm_idp.oauth.problem import answer as oauth_answer
from ztpm_idp.provider.audit import LedgerFollower
from ztpm_idp.provider.confirmations import Confirmations
from ztpm_idp.provider.heartbeat import Heartbeat
from ztpm_idp.provider.metrics import Metrics
from ztpm_idp.provider.metrics_access import MetricsAccess, by_settings
from ztpm_idp.provider.observing import Observing
from ztpm_idp.provider.picture_keeping import keep_pictures
from ztpm_idp.provider.problems import RESPONSES, Problem, answer
from ztpm_idp.provider.provider import Provider
from ztpm_idp.provider.rates import Rates
from ztpm_idp.push.pushing import Pushing
from ztpm_idp.routes import (
    approvals,
    audit,
    conduct,
    devices,
    envelopes,
    latches,
    ledger,
    login,
    mandates,
    oauth,
    oauth_authorize,
    oauth_registry,
    openid,
    passkeys,
    people,
    points,
    registry,
    service,
    tokens,
    upkeep,
)
from ztpm_idp.routes.caller import prefix_of, provider_of
from ztpm_idp.routes.described import described_by
from ztpm_idp.routes.descriptions import Descriptions
from ztpm_idp.routes.pages import open_asks, told_devices
from ztpm_idp.routes.rated import Door
from ztpm_idp.settings import load_policies
from ztpm_idp.store import Store, StoreUnavailableError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Mapping

    from fastapi import Request
    from fastapi.responses import Response
    from starlette.routing import BaseRoute
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from capabilities.statements.workload import AnyPlatform
    from policies.decision.policy import PolicySet
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.keys.watched_file import Beside
    from ztpm_idp.login_settings import LoginProvider
    from ztpm_idp.settings import Settings
    from ztpm_idp.web_push_settings import WebPush
    from ztpm_idp.webhook_settings import Webhook

logger = logging.getLogger(__name__)
_PARTS: Final = (
    service,
    registry,
    people,
    passkeys,
    tokens,
    mandates,
    ledger,
    open_asks,
    told_devices,
    approvals,
    envelopes,
    latches,
    conduct,
    oauth,
    oauth_authorize,
    oauth_registry,
    upkeep,
    login,
    audit,
    openid,
    points,
    devices,
    front,
    tree,
    revoking,
    acting,
    trail,
    parties,
)
"""Modules of the routes."""
UNAVAILABLE_AGAIN_S: Final = 5
"""Seconds to a new try where the store or a signer failed.

SQLite waits as long for another process's write.
"""
NOTICE: Final = b"ztpm-notice"
"""Header of every answer to an administrator while a recovery by the root key waits."""


@cache
def _routes(prefix: str) -> tuple[BaseRoute, ...]:
    """All routes, made once for every application with that prefix: making them takes longer than what most are asked.

    Args:
        prefix: path of the issuer.
    """
    whole = APIRouter()
    for part in _PARTS:
        whole.include_router(part.router, prefix=prefix, responses=RESPONSES)
    whole.include_router(oauth.well_known, responses=RESPONSES)
    return tuple(whole.routes)


def create_app(
    settings: Settings,
    keys: IdpKeys,
    *,
    platform: AnyPlatform | None = None,
    policies: PolicySet | None = None,
    oauth_keys: OAuthKeys | None = None,
    login_providers: Iterable[LoginProvider] = (),
    webhooks: Iterable[Webhook] = (),
    web_push: WebPush | None = None,
    publishers: Mapping[str, frozenset[bytes]] = MappingProxyType({}),
    metrics_access: MetricsAccess | None = None,
    now: Callable[[], float] = time.time,
    ticks: Callable[[], float] = time.monotonic,
    watch: Callable[[Provider], Iterable[Beside]] = lambda _: (),
) -> FastAPI:
    """The identity provider as an ASGI application.

    The store is opened, and its schema migrated, when the application starts.

    Args:
        settings: checked already; see `ztpm_idp.settings`.
        keys: the five private keys.
        platform: the platform whose word on workloads is trusted from the start; None: there is none.
        publishers: raw public keys by name of each whose releases are trusted.
        policies: the set that decides on delegations; None: the shipped set that the settings name.
        oauth_keys: of the authorization server; None: there is none here.
        login_providers: OpenID providers at which people may log in.
        webhooks: that are told of open questions and latches.
        web_push: the way to people's devices; None: there is none.
        metrics_access: right to read `/metrics`; None: on this machine alone, and nowhere behind a TLS proxy.
        now: wall clock, seconds since the epoch.
        ticks: monotonic clock of rates, seconds.
        watch: names what runs beside, so that files and keys take effect while it serves (`ztpm_idp.watching`).
    """
    path = "/" + settings.issuer.split("/", 3)[3]
    metrics = Metrics(time.perf_counter)
    decided_by = load_policies(settings) if policies is None else policies

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        store = await Store.open(settings.database_url)
        try:
            app.state.provider = Provider(
                settings,
                keys,
                store,
                now,
                platform=platform,
                policies=decided_by,
                oauth=oauth_keys,
                publishers=publishers,
                metrics=metrics,
            )
            app.state.heartbeat = Heartbeat(app.state.provider)
            app.state.confirmations = Confirmations(store)
            app.state.lookups = Lookups(app.state.provider)
            app.state.ledger_follower = LedgerFollower(store)
            app.state.pushing = Pushing(app.state.provider, webhooks, web_push=web_push, metrics=metrics)
            app.state.login_providers = {
                each.stated.name: OpenIdProvider(
                    each, redirect_uri=f"{settings.issuer}/login/providers/{each.stated.name}/callback", now=now
                )
                for each in login_providers
            }
            watched = (each.run() for each in watch(app.state.provider))
            own = app.state.ledger_follower.run(), app.state.pushing.run(), keep_pictures(app.state.provider)
            async with _beside(*own, *watched), store.listening(app.state.provider.hinted):
                yield
        finally:
            await store.close()

    app = FastAPI(
        title="ZTPM identity provider",
        version="1",
        lifespan=lifespan,
        # No page that loads scripts from elsewhere: the description is for tools.
        docs_url=None,
        openapi_url=f"{path}/openapi.json",
        redoc_url=None,
        redirect_slashes=False,
        # Off: the framework's own records would hold exception messages, and so texts of callers.
        telemetry={
            "tracing": False,
            "metrics": False,
            "logs": False,
            "operation_spans": False,
            "auto_configure": False,
        },
    )
    app.router.routes.extend(_routes(path))
    app.openapi = lambda: described_by(app, [part.router for part in _PARTS], prefix=path)  # type: ignore[method-assign]
    app.state.fetch_document = fetch
    app.state.rates = Rates(settings.rates, ticks)
    app.state.metrics = metrics
    app.state.metrics_access = by_settings(settings) if metrics_access is None else metrics_access
    app.add_exception_handler(PageProblem, _page_problem)
    app.add_exception_handler(Problem, _problem)
    app.add_exception_handler(OAuthProblem, _oauth_problem)
    app.add_exception_handler(StoreUnavailableError, _unavailable)
    app.add_exception_handler(SignerUnavailableError, _unsigned)
    app.add_exception_handler(HTTPException, _http)
    app.add_middleware(Door, prefix=path, rates=app.state.rates)
    app.add_middleware(Descriptions, prefix=path)
    app.add_middleware(_Shield)
    app.add_middleware(Observing, metrics=metrics, random=secrets.token_bytes)
    return app


@asynccontextmanager
async def _beside(*work: Coroutine[None, None, None]) -> AsyncIterator[None]:
    """Work that goes on beside the service and ends with it."""
    tasks = [asyncio.create_task(each) for each in work]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _problem(request: Request, error: Exception) -> Response:
    if not isinstance(error, Problem):
        raise TypeError
    request.state.code = error.code.value
    if error.code is IdpCode.RATE_EXCEEDED and _of_clients(request):
        return await _oauth_problem(request, of_refusal(error.code, error.detail, again_s=error.again_s))
    return answer(error.code, error.detail, error.explanation, again_s=error.again_s)


def _of_clients(request: Request) -> bool:
    """True for an endpoint whose refusals have the form of OAuth."""
    return request.scope["path"].removeprefix(prefix_of(provider_of(request))) in oauth.OF_CLIENTS


async def _oauth_problem(request: Request, error: Exception) -> Response:
    if not isinstance(error, OAuthProblem):
        raise TypeError
    request.state.code = error.error
    response = oauth_answer(error)
    response.headers.update(oauth.CROSS)
    return response


async def _page_problem(request: Request, error: Exception) -> Response:
    if not isinstance(error, PageProblem):
        raise TypeError
    request.state.code = error.code.value
    return problem_part(request, error) if is_part(request) else problem_page(error)


async def _unavailable(request: Request, error: Exception) -> Response:
    cause = error.__cause__
    logger.error("the store failed: %s", type(cause).__name__)
    return await _not_now(request, IdpCode.STORE_UNAVAILABLE)


async def _unsigned(request: Request, error: Exception) -> Response:
    logger.error("a key does not sign: %s", error)
    return await _not_now(request, IdpCode.SIGNER_UNAVAILABLE)


async def _not_now(request: Request, code: IdpCode) -> Response:
    """The refusal of something that is missing for the moment, in the form of the endpoint."""
    request.state.code = code.value
    if _of_clients(request):
        return await _oauth_problem(
            request, of_refusal(code, "nothing was done, as far as is known", again_s=UNAVAILABLE_AGAIN_S)
        )
    route = request.scope.get("route")
    if isinstance(route, APIRoute) and not route.include_in_schema:
        return problem_page(PageProblem(code, again_s=UNAVAILABLE_AGAIN_S))
    return answer(code, again_s=UNAVAILABLE_AGAIN_S)


async def _http(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException) or error.status_code != 405:
        return answer(IdpCode.PATH_UNKNOWN)
    # The framework names the methods of the first route of a path alone.
    path = request.scope["path"].removeprefix(prefix_of(provider_of(request)))
    routes = [route for part in _PARTS for route in part.router.routes if isinstance(route, APIRoute)]
    allow = {method for route in routes if route.path_regex.match(path) for method in route.methods or ()}
    return answer(IdpCode.METHOD_NOT_ALLOWED, allow=allow or {"GET"})  # the description is no route of ours


class _Shield:
    """Turns an error of ours into a response before the server logs its message, and tells administrators of notices.

    That message may hold text that a caller sent.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def tell(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                if notice := scope.get("state", {}).get("notice"):
                    message["headers"] = [*message["headers"], (NOTICE, notice.encode("ascii"))]
            await send(message)

        try:
            await self._app(scope, receive, tell)
        except Exception as error:
            if scope["type"] != "http":
                raise
            places = [f"{frame.filename}:{frame.lineno}" for frame in traceback.extract_tb(error.__traceback__)]
            # No traceback: its message may hold a caller's text.
            path = " < ".join(reversed(places[-6:]))
            logger.error("unexpected %s at %s", type(error).__name__, path)  # noqa: TRY400
            if started:
                raise _CutOffError from None
            await answer(IdpCode.INTERNAL)(scope, receive, send)


class _CutOffError(Exception):
    """An answer that had begun could not be ended."""
