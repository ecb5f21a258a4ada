"""What the grids of a file are (`roles`), the `layouts` of its arrays, and their axes and units (`conventions`)."""
