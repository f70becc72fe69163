"""Process that serves the gateway of the configuration it is given."""

from __future__ import annotations

import json
import sys

from pep.point.tool_gateway import ToolGateway
from pep.point.tool_gateway_config import ToolGatewayConfig


def main() -> None:
    """Serves until it is told to end; a line says that every server behind it was heard."""

    def ready(_: ToolGateway) -> None:
        sys.stdout.write(json.dumps({"ready": True}) + "\n")
        sys.stdout.flush()

    ToolGateway(ToolGatewayConfig.read(sys.argv[1]), ready=ready).run()


if __name__ == "__main__":
    main()
