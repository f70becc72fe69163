"""The two clocks of a running PEP."""

from __future__ import annotations

import time


class SystemClock:
    """The machine's clocks, as the `Clock` port wants them."""

    def wall_s(self) -> float:
        """Seconds since the epoch."""
        return time.time()

    def monotonic_ms(self) -> int:
        """Milliseconds of the clock that never goes back."""
        return time.monotonic_ns() // 1_000_000
