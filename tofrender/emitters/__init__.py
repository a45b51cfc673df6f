"""Emitters: the projector that lights a relay wall."""
