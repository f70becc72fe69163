"""Credentials of a program's agent, carried in a context variable to the functions that it calls.

    with acting(lent.token, agent.key):
        await framework_agent.run("air the hall")

An agent framework calls functions with the model's arguments and nothing else, in tasks and threads of its own. What
it starts inside has the credentials; a plain thread, which begins with an empty context, has none and is refused. When
the block ends they end, also for tasks that live on. The body of a guarded function has none: an agent that runs
inside of it is a hop of its own and states its own.
"""

from __future__ import annotations

import asyncio
import json
import secrets
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

from capabilities.proof.proof import prove
from pep.request.authority import PresentedRequest

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator, Mapping
    from contextlib import AbstractAsyncContextManager

    from capabilities.keys.keys import PrivateKey

T = TypeVar("T")
R = TypeVar("R")
METHOD: Final = "POST"
_JTI_BYTES: Final = 18


@dataclass(slots=True)
class _Carried:
    """Token and key of the agent that acts; `ended` once its block has been left, in any context."""

    token: str
    key: PrivateKey
    ended: bool = False


_CARRIED: Final[ContextVar[_Carried | None]] = ContextVar("ztpm_carried", default=None)


@contextmanager
def acting(token: str, key: PrivateKey) -> Iterator[None]:
    """Guarded functions called inside act for the holder of the token; the innermost block counts.

    Args:
        token: its text.
        key: the holder's, which signs each call.
    """
    carried = _Carried(token, key)
    before = _CARRIED.set(carried)
    try:
        yield
    finally:
        carried.ended = True
        with suppress(ValueError):  # left in another context, as a generator may be: what is there is not ours
            _CARRIED.reset(before)


@contextmanager
def nobody() -> Iterator[None]:
    """Guarded functions called inside have no credentials."""
    before = _CARRIED.set(None)
    try:
        yield
    finally:
        _CARRIED.reset(before)


def presented(operation: str, arguments: Mapping[str, Any], *, audience: str, at: float) -> PresentedRequest:
    """Credentials of one call: a proof of its own over operation and arguments, or none where nobody acts.

    Args:
        operation: name of it.
        arguments: as they were given.
        audience: canonical URL of the enforcement point.
        at: seconds since the epoch.
    """
    carried = _CARRIED.get()
    if carried is None or carried.ended:
        return PresentedRequest(None, None, METHOD, audience, b"")
    # Only signed and compared: what is no JSON is refused by the mapping, with its argument.
    body = json.dumps({"operation": operation, "arguments": arguments}, sort_keys=True, default=repr).encode()
    proof = prove(
        carried.key,
        method=METHOD,
        url=audience,
        body=body,
        token=carried.token,
        at=int(at),
        jti=secrets.token_urlsafe(_JTI_BYTES),
    )
    return PresentedRequest(carried.token, proof, METHOD, audience, body)


def _runs_here(loop: asyncio.AbstractEventLoop) -> bool:
    """True in the loop's own thread."""
    try:
        return asyncio.get_running_loop() is loop
    except RuntimeError:
        return False


@contextmanager
def from_thread(loop: asyncio.AbstractEventLoop | None, act: AbstractAsyncContextManager[T]) -> Iterator[T]:
    """The act, entered and left on the loop; its inside runs in the calling thread.

    Args:
        loop: of the enforcement point; None while it does not live.
        act: to be done.

    Raises:
        RuntimeError: there is no loop, or it is the calling thread's own.
    """
    if loop is None:
        raise RuntimeError("`async with point.living()` comes first")
    if _runs_here(loop):
        raise RuntimeError("on the loop of its point it would wait for itself: call it in a thread, or make it `async`")

    def there(step: Coroutine[Any, Any, R]) -> R:
        return asyncio.run_coroutine_threadsafe(step, loop).result()

    entered = there(act.__aenter__())
    try:
        yield entered
    except BaseException as error:
        there(act.__aexit__(type(error), error, error.__traceback__))
        raise
    there(act.__aexit__(None, None, None))
