"""Statements about content that is put before an agent."""
