"""Sensors: the capture meter that scans a relay wall."""
