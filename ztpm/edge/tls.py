"""Certificate and key of a listener, read again when their files change: new connections have the new ones.

Connections that are there go on under what they began with. What cannot be taken changes nothing and is told: by a
line of the log, and by `fault` for who asks whether the service is well.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable
    from pathlib import Path

PERIOD_TICKS: Final = 10
"""Ticks of uvicorn, ten of which are a second, between two looks."""
_LOG: Final = logging.getLogger(__name__)
_Stamp = tuple[int, int, int] | None


class TlsFiles:
    """TLS context of a listener, and the two files that it is made of.

    Args:
        certificate, key: PEM files.
        make: reads both into a new context; raises OSError (of which `ssl.SSLError` is one) or ValueError.
        check: refuses what should not serve although it could, by ValueError.
        told: is given the present fault, or None, with each look.

    Attributes:
        context: of new connections.
        fault: reason for which the files as they are now are not acted on; None: they are.
    """

    def __init__(
        self,
        certificate: Path,
        key: Path,
        *,
        make: Callable[[], ssl.SSLContext],
        check: Callable[[], object] = lambda: None,
        told: Callable[[str | None], object] = lambda _: None,
    ) -> None:
        self._files = certificate, key
        self._make, self._check, self._told = make, check, told
        self._taken = self._refused = self._stamps()
        self.context = make()
        self.fault: str | None = None

    def look(self) -> None:
        """Looks once; files that changed are read together, and taken whole or not at all."""
        stamps = self._stamps()
        if stamps == self._taken:
            self.fault = None
        else:
            self._read(stamps)
        self._told(self.fault)

    def _read(self, stamps: tuple[_Stamp, ...]) -> None:
        try:
            self._check()
            context = self._make()
        except (OSError, ValueError) as error:
            # One file is written before the other: only what stays so is a fault.
            if stamps == self._refused:
                self._complain(error)
            self._refused = stamps
            return
        if stamps != self._stamps():
            return  # what was checked may not be what was read: the next look sees it whole
        self.context, self._taken, self.fault = context, stamps, None
        _LOG.warning("%s: changed, and shown to new connections", self._files[0])

    def _complain(self, error: Exception) -> None:
        why = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
        if self.fault != why:
            _LOG.error("%s, %s: not taken, the ones before are still shown: %s", *self._files, why)
        self.fault = why

    def _stamps(self) -> tuple[_Stamp, ...]:
        return tuple(map(_stamp, self._files))


def _stamp(file: Path) -> _Stamp:
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
