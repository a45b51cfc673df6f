from .calibration import Calibration as Calibration, calibrate as calibrate
from .fitter import Fit as Fit, fit as fit
from .losses import (
    l2_loss as l2_loss,
    phase_loss as phase_loss,
    phasor_loss as phasor_loss,
    scale_free_loss as scale_free_loss,
    wasserstein_loss as wasserstein_loss,
)
