"""Signals in time: units, pulses, modulations, and the convention of phasors."""
