from .doppler import (
    doppler as doppler,
    doppler_rate as doppler_rate,
)
from .frames import render_frames as render_frames
from .range_rate import range_rate as range_rate
