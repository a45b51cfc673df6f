"""Scenes, inputs, processes and comparisons that tests of several packages share."""
