"""The compiled engine: the numpy engine's search over again, as loops that numba turns into machine code.

It answers the same questions with the same bounds (docs/physics.md, PHY-9, PHY-17) as `pep.pit.path.straight_path`,
`pep.pit.path.line_trace`, `pep.pit.path.course` and `pep.pit.search.certify`, some hundred times faster and without
holding the interpreter's lock. Those remain the reference to read and what runs where numba is not installed; tests
hold both to each other.
"""
