"""What stands before a relay wall: laser, meter, projector; and what the wall is."""
