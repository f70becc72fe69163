"""Stores of admission: memory rows and high-water marks in SQLite, a collection in ChromaDB."""
