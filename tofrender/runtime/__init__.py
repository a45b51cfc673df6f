"""What everything stands on: the machine and its variants, checks, memory, progress, names."""
