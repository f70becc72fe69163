"""URScript on the simulated controller: compiler, built-in functions, running programs."""
