"""Gateway in front of MCP servers that nobody changed: a relay, behind the same guard as any tool server's own."""
