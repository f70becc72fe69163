"""Pictures of an assessment, as PNG and as a page."""
