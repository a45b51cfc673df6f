"""Films: where contributions land."""
