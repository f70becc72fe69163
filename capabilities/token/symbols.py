"""The texts of a block by their number: those that every block knows, and its own."""

from __future__ import annotations

from typing import Final

from capabilities.values.errors import FaultCode, TokenError

# Texts that every block knows, by their number (eclipse-biscuit/biscuit, specification, "symbol table").
KNOWN: Final = tuple(
    "read write resource operation right time role owner tenant namespace user team service admin email group member "  # noqa: SIM905 - a table
    "ip_address client client_ip domain path version cluster node hostname nonce query".split()
)
OWN: Final = 1024
"""Number of a block's own first text."""


class Texts:
    """The texts of a block by their number."""

    __slots__ = ("_own",)

    def __init__(self, own: tuple[str, ...]) -> None:
        self._own = own

    def __getitem__(self, number: int) -> str:
        return text_of(self._own, number)


def text_of(symbols: tuple[str, ...], number: int) -> str:
    """The text of a number in a block with these texts of its own.

    Raises:
        TokenError: `CHAIN_BROKEN` when it has none.
    """
    if number < len(KNOWN):
        return KNOWN[number]
    if OWN <= number < OWN + len(symbols):
        return symbols[number - OWN]
    raise TokenError(FaultCode.CHAIN_BROKEN, "a text that the block does not have")
