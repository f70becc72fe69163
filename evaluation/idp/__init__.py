"""The identity provider's commands beside a bare endpoint on the same database."""
