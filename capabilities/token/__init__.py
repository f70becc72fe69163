"""The token: its blocks, their checks, minting, delegating and the steps of verification."""
