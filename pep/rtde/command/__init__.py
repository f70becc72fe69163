"""Commands of ur_rtde's control interface as typed values, and the registers that carry them."""
