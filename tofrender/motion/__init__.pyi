from .doppler import (
    doppler as doppler,
    doppler_rate as doppler_rate,
)
from .range_rate import range_rate as range_rate
