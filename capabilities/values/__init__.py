"""Values of authority: units, bounds, scopes and their order, strict JSON, the error tree."""
