"""Base layer: variants and plugins of Mitsuba, checks, memory, files, progress, figures."""
