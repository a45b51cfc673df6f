from .fitter import Fit as Fit, fit as fit
from .losses import (
    l2_loss as l2_loss,
    phasor_loss as phasor_loss,
    wasserstein_loss as wasserstein_loss,
)
