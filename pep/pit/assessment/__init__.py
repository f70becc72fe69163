"""Assessments: one question to the search, its answer, its remedies, streams."""
