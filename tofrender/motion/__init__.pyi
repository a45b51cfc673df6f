from .doppler_camera import doppler as doppler, doppler_rate as doppler_rate
from .fmcw import Fmcw as Fmcw
from .frames import render_frames as render_frames
from .range_rate_film import range_rate as range_rate
from .sensor_poses import render_poses as render_poses
