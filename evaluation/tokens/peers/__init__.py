"""Time that a capability takes to check, ours and the peers', in one run on one machine.

Each peer is one module that turns a workload into measured cells; `timing` runs the cells of one scope and depth in
turns, so that any disturbance of the machine disturbs all of them alike. A peer that is not installed is a row that
says so. `docs/benchmarks.md` says how to read the figures.
"""
