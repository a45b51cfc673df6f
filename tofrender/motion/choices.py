"""Names that functions and options of commands choose from. Nothing here imports Mitsuba."""

WAVEFORMS = ("sine", "triangle", "rectangle")  # Correlations of light and sensor over their phase

WINDOWS = {"hann": "hann", "rectangular": "boxcar", "hamming": "hamming", "blackman": "blackman"}
"""SciPy's names of windows."""

MAX_CYCLES = 1000
MAX_LOOKS = 10_000
