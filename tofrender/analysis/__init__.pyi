from .conversion import (
    phasor_parts as phasor_parts,
)
from .conversion import (
    sum_channels as sum_channels,
)
from .conversion import (
    transient_to_phasor as transient_to_phasor,
)
from .correlation import (
    MultipathError as MultipathError,
)
from .correlation import (
    four_bucket as four_bucket,
)
from .correlation import (
    from_four_bucket as from_four_bucket,
)
from .correlation import (
    multipath_error as multipath_error,
)
from .correlation import (
    true_depth as true_depth,
)
from .unwrapping import (
    unambiguous_range as unambiguous_range,
)
from .unwrapping import (
    unwrap as unwrap,
)
