from .conversion import (
    phasor_parts as phasor_parts,
    sum_channels as sum_channels,
    transient_to_phasor as transient_to_phasor,
)
from .correlation import (
    MultipathError as MultipathError,
    four_bucket as four_bucket,
    from_four_bucket as from_four_bucket,
    multipath_error as multipath_error,
    true_depth as true_depth,
    true_normals as true_normals,
)
from .degrees_of_polarization import (
    angle_of_linear_polarization as angle_of_linear_polarization,
    degree_of_circular_polarization as degree_of_circular_polarization,
    degree_of_linear_polarization as degree_of_linear_polarization,
    degree_of_polarization as degree_of_polarization,
)
from .rebinning import rebin as rebin
from .unwrapping import unambiguous_range as unambiguous_range, unwrap as unwrap
