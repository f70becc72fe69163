"""Steps of the schema until its twelfth, which every database in use has taken."""
