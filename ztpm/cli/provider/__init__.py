"""Commands that speak to an identity provider."""
