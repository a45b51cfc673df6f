"""What an assignment's authors do: check that all of it holds, and release it to students."""
