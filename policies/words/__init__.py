"""Words of the package: reason codes, labels, parameters, canonical text, errors."""
