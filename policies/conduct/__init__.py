"""Trust and behaviour: pure reducers over reports of concluded requests."""
