"""Signer beside a gateway that speaks AuthZEN: it proves the gateway's key for each evaluation, and passes it on.

    python -m ztpm.point.evaluation_signer --point https://plant.example --key gateway.key --listen 127.0.0.1:8931

A gateway that exists knows no DPoP. It asks here, on its own machine, as it asks any policy decision point. Who reaches
this port asks in the gateway's name, and so learns what a gateway may; what an agent may, the agent's own proof says.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import secrets
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import httpx2

from capabilities import tracing
from capabilities.proof.proof import prove
from pep.base import key_file
from pep.base.clock import SystemClock
from pep.base.errors import ConfigError, PepFault
from pep.base.tcp_place import tcp_place
from pep.mcp.http_request import JSON, answer, headers_of, read_body
from pep.point.config_text import is_loopback
from pep.point.evaluation_layer import ONE, PROBLEM, REQUEST_ID, SEVERAL, WELL_KNOWN
from ztpm.codes.code_table import code_table, status_of
from ztpm.codes.unavailable import UnavailableError, line_of, unavailable
from ztpm.edge.log import tell
from ztpm.edge.places import Bounds
from ztpm.edge.server import EdgeServer

if TYPE_CHECKING:
    from collections.abc import Mapping

    from starlette.types import Receive, Scope, Send

    from capabilities.keys.keys import PrivateKey
    from pep.base.ports import Clock

LISTEN: Final = "127.0.0.1:8931"
"""Address where nothing is said."""
BOUNDS: Final = Bounds(strangers=64, by_address=64)
"""Most connections: all come from one address."""
TIMEOUT_S: Final = 5.0
"""Longest wait for an answer: more than an enforcement point takes for any request."""
ANSWER_BYTES: Final = 1_048_576
"""Longest answer: 32 evaluations of some kilobytes each."""
UNREACHABLE: Final = "POINT_UNREACHABLE"


class EvaluationSigner:
    """ASGI app that signs evaluations.

    Args:
        http: client of the enforcement point.
        point: origin of the enforcement point.
        key: of the gateway, registered as an enforcement point of the same audience.
        host: "HOST:PORT" at which this app answers; a request for another host is none for it.
        clock: its wall time is in the proofs.
    """

    def __init__(self, http: httpx2.AsyncClient, *, point: str, key: PrivateKey, host: str, clock: Clock) -> None:
        self._http = http
        self._point = point
        self._key = key
        self._host = host
        self._clock = clock

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection."""
        if scope["type"] != "http":
            return
        headers, path, method = headers_of(scope), scope["path"], scope["method"]
        body = await read_body(receive)
        if body is None:
            return
        if headers.get("host") != self._host:
            # The page of a browser whose name was led here is no gateway.
            await answer(send, 421, b"")
        elif path == WELL_KNOWN and method == "GET":
            await answer(send, 200, self._endpoints())
        elif path not in {ONE, SEVERAL}:
            await answer(send, 404, b"")
        elif method != "POST":
            await answer(send, 405, b"", [(b"allow", b"POST")])
        else:
            await self._pass_on(send, path, headers, body)

    def _endpoints(self) -> bytes:
        own = f"http://{self._host}"
        told = {"policy_decision_point": own, "access_evaluation_endpoint": own + ONE}
        return json.dumps({**told, "access_evaluations_endpoint": own + SEVERAL}).encode()

    async def _pass_on(self, send: Send, path: str, headers: Mapping[str, str | None], body: bytes) -> None:
        """Passes a request on, signed; of its headers the two that an enforcement point reads, and no credentials."""
        url = self._point + path
        proof = prove(
            self._key,
            method="POST",
            url=url,
            body=body,
            token=None,
            at=int(self._clock.wall_s()),
            jti=secrets.token_urlsafe(18),
        )
        passed = {name: value for name in ("content-type", REQUEST_ID) if (value := headers.get(name)) is not None}
        content = bytearray()
        try:
            async with (
                asyncio.timeout(TIMEOUT_S),
                self._http.stream("POST", url, content=body, headers={**passed, "dpop": proof}) as response,
            ):
                async for part in response.aiter_bytes():
                    content += part
                    if len(content) > ANSWER_BYTES:
                        raise httpx2.DecodingError("too long")
        except (httpx2.HTTPError, TimeoutError):
            title = code_table()[UNREACHABLE].cause
            kind = f"urn:ztpm:problem:{UNREACHABLE.lower()}"
            told = {"type": kind, "title": title, "status": 502, "code": UNREACHABLE, "detail": title}
            await answer(send, 502, json.dumps(told).encode(), media=PROBLEM)
            return
        echoed = response.headers.get(REQUEST_ID)
        given = [] if echoed is None else [(REQUEST_ID.encode(), echoed.encode("latin-1"))]
        media = response.headers.get("content-type", JSON.decode()).encode("latin-1")
        await answer(send, response.status_code, bytes(content), given, media=media)


def origin_of(point: str) -> str:
    """The origin of an enforcement point as a person states it.

    Raises:
        ConfigError: `CONFIG_INVALID` for another URL than that of an origin, or plain HTTP to another machine.
    """
    parts = urlsplit(point)
    host = parts.hostname or ""
    if parts.scheme not in {"http", "https"} or not host or parts.path.strip("/") or parts.query or parts.username:
        raise ConfigError(PepFault.CONFIG_INVALID, "--point must be an origin, such as https://plant.example")
    if parts.scheme == "http" and not is_loopback(host):
        raise ConfigError(PepFault.CONFIG_INVALID, "--point: plain HTTP on loopback only")
    return f"{parts.scheme}://{parts.netloc}"


def address_of(listen: str) -> tuple[str, int]:
    """Host and TCP port to listen at.

    Raises:
        ConfigError: `CONFIG_INVALID` for another address than one of this machine alone.
    """
    host, port = tcp_place(listen, name="--listen")
    if not is_loopback(host):
        raise ConfigError(PepFault.CONFIG_INVALID, f"--listen must be on loopback, such as {LISTEN}")
    return host, port


async def serve(*, point: str, key: Path, listen: str) -> None:
    """Serves until SIGINT or SIGTERM.

    Args:
        point: origin of the enforcement point.
        key: path of the gateway's encrypted key.
        listen: "HOST:PORT".

    Raises:
        ConfigError: `CONFIG_INVALID`.
        UnavailableError: the address cannot be had.
    """
    origin, (host, port) = origin_of(point), address_of(listen)
    signing = key_file.read_key(key, name="--key")
    async with httpx2.AsyncClient(timeout=TIMEOUT_S, trust_env=False) as http:
        app = EvaluationSigner(http, point=origin, key=signing, host=listen, clock=SystemClock())
        await EdgeServer(app, host=host, port=port, bounds=BOUNDS, lifespan="off", log_level="error").serve()


def main() -> None:
    """Command line of the signer; its exit status is that of the code that it tells."""
    parser = argparse.ArgumentParser(prog="python -m ztpm.point.evaluation_signer", description="Signs evaluations.")
    parser.add_argument("--point", required=True, metavar="ORIGIN")
    parser.add_argument("--key", type=Path, required=True)
    parser.add_argument("--listen", default=LISTEN, metavar="HOST:PORT")
    options = parser.parse_args()
    tell(sys.stderr, context=tracing.context)
    try:
        asyncio.run(serve(point=options.point, key=options.key, listen=options.listen))
    except ConfigError as error:
        parser.exit(status_of(error.code), f"{line_of(error.code, error.detail)}\n")
    except (UnavailableError, OSError) as error:
        told = unavailable(error) if isinstance(error, OSError) else error
        parser.exit(status_of(told.code), f"{line_of(told.code, told.sentence)}\n")


if __name__ == "__main__":
    main()
