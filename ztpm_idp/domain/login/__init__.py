"""Logging in: sessions of people, links that begin one, session-bound keys, and logins at other providers."""
