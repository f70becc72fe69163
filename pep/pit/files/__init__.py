"""World and motion files, read strictly, and their published schemas."""
