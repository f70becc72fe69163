"""Tool servers behind the gate.

The public name is the function `guard` of the module of that name:

    from pep.mcp.guard import guard

`pep.mcp.guard` is the module: a name of this package cannot be both. Importing the package alone loads no SDK.
"""
