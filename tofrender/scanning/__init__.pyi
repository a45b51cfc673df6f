from .clouds import point_cloud as point_cloud, true_points as true_points
from .patterns import scan_pattern as scan_pattern
from .waveforms import lidar as lidar
