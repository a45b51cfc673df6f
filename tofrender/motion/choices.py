"""Names that functions and options of commands choose from. Nothing here imports Mitsuba."""

WAVEFORMS = {"sine": 0, "triangle": 2, "rectangle": 1}
"""Correlation of light and sensor by the power with which its odd harmonics k fall off."""

WINDOWS = {"hann": "hann", "rectangular": "boxcar", "hamming": "hamming", "blackman": "blackman"}
"""SciPy's names of windows."""

MAX_CYCLES = 1000
MAX_LOOKS = 10_000
