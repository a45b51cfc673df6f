"""Devices in front of a relay wall: laser, capture meter, projector; and the wall itself."""
