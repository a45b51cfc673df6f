"""Random numbers for rendering."""
