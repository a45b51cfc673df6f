from .bounds import depth_bound as depth_bound, echo_bounds as echo_bounds
from .cameras import GatedCamera as GatedCamera, StreakCamera as StreakCamera
from .capture_errors import reconstruction_errors as reconstruction_errors
from .echo_detection import echoes as echoes
from .estimators import estimate_depth as estimate_depth
from .itof import Itof as Itof
from .multi_zone import MultiZone as MultiZone
from .pile_up import coates as coates, coates_variance as coates_variance
from .radiometry import expected_photons as expected_photons
from .response import Response as Response
from .sensor_config import sense as sense
from .spad import Spad as Spad
