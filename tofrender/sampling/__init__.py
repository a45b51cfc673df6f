"""Random numbers and point sets."""
