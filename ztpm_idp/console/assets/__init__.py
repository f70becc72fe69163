"""Files that pages fetch: the drawing library, the viewer of pictures, the look. Read as resources, never imported."""
