"""Directory that a leased Python program finds first: what Python runs by itself before the program begins."""
