"""Tools of an assignment's authors: check all of it, and release it to students."""
