"""Migrations from v0027 on."""
