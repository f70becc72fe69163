"""Rows of logging in: sessions, devices, passkeys that are being made."""
