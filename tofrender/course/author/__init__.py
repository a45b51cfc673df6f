"""Tools for authors: check an assignment, and release it to students."""
