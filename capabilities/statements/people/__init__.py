"""Statements by people, and the questions to them."""
