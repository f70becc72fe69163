"""Tool server of a cell whose robot is behind a gateway: it verifies callers and passes calls on.

    python -m ztpm.point.tool_proxy --config door.toml

It has no robot, no physics and no tools; the gateway has them, and verifies everything again. The passphrase of the
PEP's key comes from the environment (`ZTPM_PASSPHRASE`). When it listens it prints one JSON line with `"ready": true`.
With `--reports` it tells the process that started it the age of its revocation view (ztpm/base/report_server.py).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from pep.mcp.dpop import DPoPLayer
from pep.mcp.forward import Forward, client
from pep.mcp.mapping import ARM_TOOLS
from pep.point.parts import opened
from pep.request.edge import Edge
from ztpm.point.enforcement_point import EnforcementPoint, main_of
from ztpm.point.tool_proxy_config import ToolProxyConfig, read_door_config

if TYPE_CHECKING:
    import httpx2

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from policies.decision.policy import PolicySet


class ToolProxy(EnforcementPoint):
    """All parts of one tool server without a robot, composed.

    Args:
        config: of it.
        trust: the issuer's public keys.
        key: of this PEP; it signs the tickets.
        policies: policies with the greatest age of the revocation view, by operation.
        http: client of the identity provider.
    """

    def __init__(
        self,
        config: ToolProxyConfig,
        *,
        trust: TrustBundle,
        key: PrivateKey,
        policies: PolicySet,
        http: httpx2.AsyncClient,
    ) -> None:
        super().__init__(config, trust=trust, key=key, http=http)
        self._edge = Edge(policies=policies, journal=self.journal)
        self._gateway = client()
        forward = Forward(
            self._gateway,
            edge=self._edge,
            tools=ARM_TOOLS,
            audience=config.audience,
            url=config.gateway_url,
            pep_id=config.pep_id,
            key=key,
            clock=self.clock,
        )
        self.app = DPoPLayer(
            forward,
            authority=self.authority,
            edge=self._edge,
            tools=ARM_TOOLS,
            audience=config.audience,
            issuer=config.issuer,
            clock=self.clock,
        )

    @property
    def edge(self) -> Edge:
        """Leases and records; there is no gate here."""
        return self._edge

    async def close(self) -> None:
        """Closes every connection to the gateway, so that no forwarded call goes on."""
        await self._gateway.aclose()


async def serve(config: ToolProxyConfig, *, reports: bool = False) -> None:
    """Runs the tool server to its end; `reports` as for `EnforcementPoint.run`.

    Args:
        config: of it.
        reports: it has told of itself.

    Raises:
        PepError: when a part cannot be had; nothing was served then.
    """
    server = ToolProxy(config, **opened(config))
    server.recover()
    await server.run(reports=reports)


def main() -> None:
    """Command line of the tool server."""
    parser = argparse.ArgumentParser(
        prog="python -m ztpm.point.tool_proxy",
        description="The MCP tool server of a cell whose robot is behind a gateway.",
    )
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--reports", action="store_true", help="answer questions on standard input")
    options = parser.parse_args()
    main_of(
        lambda: serve(read_door_config(options.config), reports=options.reports),
        config=options.config,
        service="ztpm-tools",
    )


if __name__ == "__main__":
    main()
