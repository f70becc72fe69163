"""One request on its way: the call, its authority, and the permit that it may end in."""
