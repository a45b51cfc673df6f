"""The integrators that see around a corner."""
