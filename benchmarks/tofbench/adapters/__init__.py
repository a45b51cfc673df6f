"""One module for each renderer; only these import renderers."""
