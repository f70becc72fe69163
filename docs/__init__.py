"""Pages for readers, and the generator of those that are tables of the code."""
