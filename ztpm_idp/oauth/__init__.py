"""The authorization server: OAuth 2.1 as MCP clients speak it, over the provider's own domain."""
