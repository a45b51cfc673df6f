from .clouds import point_cloud as point_cloud
from .patterns import scan_pattern as scan_pattern
from .waveforms import lidar as lidar
