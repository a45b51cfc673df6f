"""Allowed values of arguments of functions and options of commands, without importing Mitsuba."""

WAVEFORMS = ("sine", "triangle", "rectangle")
"""Waveforms of the correlation of light and sensor, as a function of phase."""

WINDOWS = {"hann": "hann", "rectangular": "boxcar", "hamming": "hamming", "blackman": "blackman"}
"""Windows of the Fourier transform, with SciPy's names."""

MAX_CYCLES = 1000
MAX_LOOKS = 10_000
