"""Two pictures on either side of a divider: techniques of the course, or files."""
