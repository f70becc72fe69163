"""The databases: PostgreSQL and SQLite, their migration and their copies."""
