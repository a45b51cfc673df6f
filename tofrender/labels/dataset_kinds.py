"""Kinds of Datasets in arguments and results: variables, axes and their order.

A public function declares the kind of a parameter by an annotation, for example
`dataset: Annotated[xr.Dataset, FILM]`. The tests of labels find all functions by it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, eq=False)
class Kind:
    """Kind of Dataset.

    Attributes:
        name: Name of such a Dataset in messages.
        variables: Required variables with their axes, in the order that `read` returns.
        optional: Further variables with their axes. If `closed`, other variables are refused.
        bins: Axis of the time bins, or "" without bins. The coordinate `opl` contains the centers.
        real: Axes with rising real numbers as coordinates instead of indices.
        closed: Whether variables with other names are refused.
    """

    name: str
    variables: Mapping[str, tuple[str, ...]]
    optional: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    bins: str = ""
    real: tuple[str, ...] = ()
    closed: bool = False

    @property
    def all_variables(self) -> dict[str, tuple[str, ...]]:
        """Required and optional variables with their axes."""
        return {**self.variables, **self.optional}


_PIXELS = ("y", "x")
_IMAGE = (*_PIXELS, "channel")
_FILM = (*_PIXELS, "opl", "channel")
_SHOTS = ("shot",)

PIXELS = Kind("a DataArray with the axes y and x", variables={"array": _PIXELS})
"""A number for each pixel."""

IMAGE = Kind("a DataArray with the axes y, x and channel", variables={"array": _IMAGE})
"""A picture. Polarized pictures have the axis `stokes` before `channel`."""

LIGHT = Kind("a DataArray with the axes y, x, opl and channel", variables={"array": _FILM})
"""Time-resolved light without the other variables of a film."""

BINNED = Kind(
    "a DataArray with an axis bin or opl", variables={"array": (*_PIXELS, "bin")}, bins="bin"
)
"""Numbers in time bins. Other axes may have any names."""

STOKES_VECTORS = Kind("a DataArray with an axis stokes", variables={"array": _IMAGE})
"""Stokes vectors. Other axes may have any names."""

_ERRORS = {"transient_error": _FILM, "steady_error": _IMAGE}

FILM = Kind(
    "a Dataset of render",
    variables={"transient": _FILM, "steady": _IMAGE},
    optional={
        **_ERRORS,
        "raw": _FILM,
        "half_difference": _FILM,
        "direct": _FILM,
        "features": (*_PIXELS, "feature"),
    },
    bins="opl",
    closed=True,
)
"""Result of `render`. Polarized films have the axis `stokes` before `channel`."""

TRANSIENT = Kind(
    "a Dataset of render",
    variables={"transient": _FILM},
    optional={"steady": _IMAGE, **_ERRORS},
    bins="opl",
)
"""Time-resolved light of `render`, or of a single or confocal capture."""

FRAMES = Kind(
    "frames of render_frames",
    variables={"transient": ("frame", *_FILM)},
    optional={
        "steady": ("frame", *_IMAGE),
        "transient_error": ("frame", *_FILM),
        "steady_error": ("frame", *_IMAGE),
    },
    bins="opl",
)
"""Films of a moving scene, one after the other."""

POSES = Kind(
    "a Dataset of render_poses",
    variables={"transient": ("pose", *_FILM)},
    optional={"steady": ("pose", *_IMAGE)},
    bins="opl",
)
"""Films of one scene from several poses of the camera."""

PYRAMID = Kind(
    "a result of strategy_pyramid",
    variables={"steady": ("weighting", "strategy", *_IMAGE)},
    optional={"transient": ("weighting", "strategy", *_FILM)},
    bins="opl",
)
"""Light of each strategy of bidirectional path tracing."""

CAPTURE = Kind("a capture", variables={"transient": _FILM}, bins="opl")
"""Result of `capture`. The mode decides on the axes of the laser, see `nlos.captures`."""

RATES = Kind(
    "a Dataset of expected_photons",
    variables={"rate": (*_PIXELS, "bin"), "background": _PIXELS},
    bins="bin",
)
"""Expected photons per pixel, bin and laser cycle."""

COUNTS = Kind(
    "a Dataset of Spad.histogram",
    variables={"counts": (*_PIXELS, "bin")},
    optional={"expected": (*_PIXELS, "bin")},
    bins="bin",
)
"""Photon counts per pixel and bin."""

_GATES = ("delay_opl", *_PIXELS)
_SWEEPS = ("y", "sweep", "x")
_TAPS = ("frequency", "tap", *_PIXELS)

GATES = Kind(
    "a Dataset of GatedCamera",
    variables={"images": _GATES},
    optional={"expected": _GATES},
    real=("delay_opl",),
)
"""Images of a gated camera [electrons]."""

STREAK = Kind(
    "a Dataset of StreakCamera",
    variables={"images": _SWEEPS},
    optional={"expected": _SWEEPS},
    real=("sweep",),
)
"""Screens of a streak camera [electrons], one for each row of the slit."""

PHASORS = Kind(
    "phasors",
    variables=dict.fromkeys(("I", "Q"), ("frequency", *_IMAGE)),
    real=("frequency",),
)
"""Real and imaginary parts of phasors."""

ZONES = Kind("a Dataset of MultiZone", variables={"counts": ("pose", "zone", "bin")})
"""Photon counts of a multi-zone sensor. The bins of each zone start elsewhere."""

TAPS = Kind(
    "a Dataset of Itof.frames or Itof.expected",
    variables={"taps": _TAPS},
    optional={"saturated": _PIXELS, "expected": _TAPS, "depth": _PIXELS},
    real=("frequency",),
)
"""Taps of a correlation camera [electrons]."""

SENSED = (COUNTS, TAPS, GATES, STREAK)
"""What `sense` returns."""

PATTERN = Kind(
    "a Dataset of scan_pattern",
    variables={"azimuth": _SHOTS, "elevation": _SHOTS, "time": _SHOTS},
)
"""Directions [rad] and times [s] of the shots of a lidar."""

WAVEFORMS = Kind(
    "a Dataset of lidar",
    variables={
        "rate": (*_SHOTS, "bin"),
        "background": _SHOTS,
        "true_range": _SHOTS,
        "time": _SHOTS,
        "direction": (*_SHOTS, "axis"),
        "origin": ("axis",),
    },
    bins="bin",
)
"""Waveforms of the shots of a lidar. The origin has the axis `shot` too if the lidar moves."""

RANGE_RATES = Kind(
    "a Dataset of range_rate",
    variables={"radiance": (*_PIXELS, "opl", "rate", "channel")},
    optional={"steady": _IMAGE},
    real=("opl", "rate"),
)
"""Light by path length [m] and by its rate of change [m/s]."""

SPECTRA = Kind(
    "a Dataset of Fmcw.spectra",
    variables={"up": (*_PIXELS, "beat"), "down": (*_PIXELS, "beat")},
    real=("beat",),
)
"""Power of up and down chirps by the frequency of the beat [Hz]."""

DOPPLER = Kind(
    "a Dataset of doppler",
    variables={
        "homodyne": (*_PIXELS, "part", "channel"),
        "heterodyne": (*_PIXELS, "part", "channel"),
    },
    optional={"steady": _IMAGE},
)
"""Parts "I" and "Q" of the means over an exposure."""

VOLUME = Kind(
    "a Dataset of reconstruct",
    variables={"intensity": ("z", *_PIXELS)},
    optional={"frame_origin": ("xyz",), "frame_axes": ("axis", "xyz")},
    real=("z", *_PIXELS),
)
"""Intensities of voxels. Their coordinates are in m."""

DEPTH_ERRORS = Kind(
    "a Dataset of reconstruction_errors",
    variables=dict.fromkeys(("error", "found"), ("reconstruction", "photons_per_cycle", "seed")),
    real=("photons_per_cycle",),
)
"""Errors of reconstructions by method, signal level and seed."""

RECORDS = Kind("a data set with transients", variables={"transient": ("record", *_FILM)})
"""Renders of a data set. The axis `record` is missing after the choice of a record."""

CAPTURES = Kind(
    "a data set with captures",
    variables={"capture": ("record", "wall_y", "wall_x", "capture_opl", "channel")},
)
"""Captures of a data set. The mode decides on the axes of the laser, see `nlos.captures`."""

PATHS = Kind(
    "a result of paths_of",
    variables={
        "opl": ("path",),
        "radiance": ("path", "channel"),
        "vertex_opl": ("path", "vertex"),
        "on_film": ("path", "vertex", "xy"),
    },
)
"""Light paths of a pixel. The names of shapes have the axes `path` and `vertex`, too."""

CLOUD = Kind("a Dataset of point_cloud", variables=dict.fromkeys("xyz", ("point",)))
"""Points [m], with further columns along the axis `point`."""

EXPLORED = (TRANSIENT, FRAMES, PYRAMID, CAPTURE, RANGE_RATES, VOLUME, PHASORS, *SENSED)
"""What `explore` and `report` show."""
