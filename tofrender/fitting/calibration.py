"""Calibration of a multi-zone sensor from histograms of known scenes, by least squares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import xarray as xr
from scipy import optimize

from ..labels import POSES, ZONES, read, require_same_labels
from ..runtime import checks
from ..runtime.progress import status
from ..sensors.multi_zone import Light, MultiZone
from ..signals.pulses import KnotPulse

PARAMETERS = (
    "gains",
    "starts_opl",
    "floors",
    "pulse",
    "bin_width_opl",
    "shift",
    "scale",
    "blur",
    "crosstalk",
)
"""Parameters of a sensor that `calibrate` can fit."""

# Parameters with one value for each zone
ZONED = ("gains", "starts_opl", "floors")
LOGARITHMIC = (
    "gains",
    "floors",
    "pulse",
    "bin_width_opl",
    "scale",
    "blur",
    "crosstalk",
    "albedos",
)
"""Parameters that are above 0, and are fitted by their logarithm."""

LEAST = {"floors": 1e-3, "blur": 1e-3, "crosstalk": 1e-4}
"""Smallest start values of parameters that may be 0."""

MOST = {"blur": 1.0, "crosstalk": 1.0}
"""Largest values of parameters with a limit."""

# Largest logarithm of a fitted value
LARGEST_LOG = 40.0

# A value is not determined if its derivative, relative to the largest derivative, is smaller
NEGLIGIBLE = 1e-9

# Parameters depend on each other if an eigenvalue of J^T J, relative to the largest, is smaller
DEPENDENT = 1e-12

# Step of numerical derivatives of pulses and zones, in the fitted variable
STEP = 1e-5

# Limits of the optimizer. The tolerance is a relative change of the sum of squares
MAX_EVALUATIONS = 200
TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of `calibrate`.

    Args:
        sensor: The sensor with the fitted parameters.
        albedos: Albedo of each part, relative to the first one, by name.
        values: Fitted values along the axis `parameter`, with names like "gains[0]".
        standard_errors: Standard error of each value. It is estimated from the residuals, and
            therefore includes errors of the model. It is infinite for a knot of the pulse that is
            so small that the histograms do not depend on it.
        correlation: Correlation of the estimates, (parameter, other).
        residuals: Measured minus expected counts, divided by the assumed error, (pose, zone, bin).
        chi_square: Mean square of the residuals, per degree of freedom.
    """

    sensor: MultiZone
    albedos: dict[str, float]
    values: xr.DataArray
    standard_errors: xr.DataArray
    correlation: xr.DataArray
    residuals: xr.DataArray
    chi_square: float

    def most_correlated(self, count: int = 5) -> list[tuple[str, str, float]]:
        """Return the pairs of parameters with the largest correlations, the largest first."""
        checks.integer("count", count, 1, checks.MAX_BINS)
        names = self.correlation["parameter"].values
        upper = np.triu(np.nan_to_num(np.abs(self.correlation.values)), 1)
        order = np.argsort(upper, axis=None)[::-1][:count]
        pairs = [np.unravel_index(each, upper.shape) for each in order]
        return [(str(names[i]), str(names[j]), float(self.correlation[i, j])) for i, j in pairs]


def calibrate(
    sensor: MultiZone,
    renders: Annotated[xr.Dataset | Mapping[str, xr.Dataset], POSES],
    histograms: Annotated[xr.Dataset | np.ndarray, ZONES],
    *,
    parameters: Sequence[str] = PARAMETERS,
    relative_error: float = 0.05,
    first_bin: int = 0,
    last_bin: int | None = None,
) -> Calibration:
    """Fit the parameters of a multi-zone sensor to histograms of known scenes.

    The fit minimizes the sum of (n - e)^2 / s^2 over poses, zones and bins, with measured counts n
    and expected counts e. The variance

        s^2 = max(n, 1) (1 + relative_error^2 m)

    includes photon noise and an error of the model: relative_error times the geometric mean of n
    and the largest count m of the pose. Therefore peaks and tails contribute, and all poses have
    similar weights.

    The method is Levenberg-Marquardt (`scipy.optimize.least_squares`). Derivatives by linear
    parameters are exact. Derivatives of the zones' weights and of the pulse are central differences
    in double precision.

    Args:
        sensor: Start values. Gains and floors start at values estimated from the histograms.
        renders: The known scenes, as from `render_poses`, see `MultiZone.expected`. Several parts
            by name, each rendered alone with the same albedo, are added with fitted albedos.
        histograms: Measured counts (poses, zones, bins), a NumPy array or a Dataset with `counts`.
            A Dataset must have the poses of the renders, with the same labels in the same order.
        parameters: Names of the fitted parameters. Other parameters are kept. "pulse" means the
            values of a `KnotPulse`.
        relative_error: Error of the model over the counts, 0 to 1.
        first_bin: First bin that is compared.
        last_bin: Last bin that is compared, by default the sensor's last bin.

    Returns:
        The sensor, and the standard errors and correlations of its parameters, see `Calibration`.

    Raises:
        ValueError: An argument is invalid, or the histograms do not determine the parameters. The
            message names parameters that could be kept.

    Example:
        >>> import mitsuba as mi, numpy as np, tofrender
        >>> film = {"type": "transient_hdr_film", "width": 6, "height": 5, "temporal_bins": 200}
        >>> film |= {"start_opl": 0.0, "bin_width_opl": 0.007, "rfilter": {"type": "box"}}
        >>> scene = {"type": "scene", "laser": {"type": "point", "position": [0, 0, 0]}}
        >>> scene["wall"] = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(9)}
        >>> scene["camera"] = {"type": "perspective", "fov": 44, "film": film}
        >>> scene["integrator"] = {"type": "transient_path", "max_depth": 2}
        >>> poses = np.tile(np.diag([-1.0, 1.0, -1.0, 1.0]), (3, 1, 1))  # Look along -z
        >>> poses[:, 2, 3] = [0.3, 0.4, 0.5]
        >>> views = tofrender.motion.render_poses(
        ...     scene, poses, attached=["laser"], spp=4, progress=False
        ... )
        >>> sensor = tofrender.sensors.MultiZone.preset("tmf8820")
        >>> measured = sensor.expected(views)
        >>> found = calibrate(sensor, views, measured, parameters=["gains", "starts_opl"])
        >>> bool(np.allclose(found.sensor.gains, sensor.gains, rtol=1e-3))
        True
    """
    # Check the arguments. A Dataset is a mapping, too
    checks.instance("sensor", sensor, MultiZone, "a MultiZone")
    names = _parameters(parameters, sensor)
    error = checks.number("relative_error", relative_error, low=0, high=1)
    parts = {"scene": renders} if isinstance(renders, xr.Dataset) else renders
    checks.instance("renders", parts, Mapping, "a Dataset of render_poses, or parts by name")
    checks.require("renders", parts, len(parts) > 0, "a Dataset of render_poses, or parts by name")
    lights = {name: Light.of(each) for name, each in parts.items()}
    poses = {"pose": next(iter(parts.values()))["pose"].values}
    for name, each in parts.items():
        require_same_labels(each, poses, f"renders of {name}", "the first part")
    if isinstance(histograms, xr.Dataset):
        measured = read(histograms, ZONES, "histograms")
        require_same_labels(measured, poses, "histograms", "renders")
        histograms = measured["counts"].values
    counts = _counts(histograms, lights, sensor)
    last = sensor.bins - 1 if last_bin is None else last_bin
    last = checks.integer("last_bin", last, 0, sensor.bins - 1)
    first = checks.integer("first_bin", first_bin, 0, last)

    # Minimize the squared residuals
    problem = _Problem(sensor, lights, counts, names, error, slice(first, last + 1))
    with status("Calibrating"):
        problem.require_determined(problem.start)
        solve: Any = optimize.least_squares
        found = solve(
            problem.residuals,
            problem.start,
            jac=problem.jacobian,
            method="lm",
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            max_nfev=MAX_EVALUATIONS,
        )
        if found.status == 0:
            raise ValueError(
                f"the calibration did not converge in {MAX_EVALUATIONS} evaluations. Fit fewer "
                "parameters first, and start from the result"
            )
    return problem.calibration(found.x)


def _parameters(parameters: Any, sensor: MultiZone) -> list[str]:
    """Return the names of parameters in the order of `PARAMETERS`."""
    if isinstance(parameters, str):
        raise ValueError(f"parameters = {parameters!r}: must be a list of names")
    for each in parameters:
        checks.one_of("parameters", each, PARAMETERS)
    if "pulse" in parameters and not isinstance(sensor.pulse, KnotPulse):
        raise ValueError(
            "parameters has 'pulse', but the pulse of the sensor has no knots. Use a KnotPulse, or "
            "remove 'pulse'"
        )
    return [name for name in PARAMETERS if name in parameters]


def _counts(histograms: Any, lights: Mapping[str, Light], sensor: MultiZone) -> np.ndarray:
    """Check measured counts and return them as float64 (poses, zones, bins)."""
    counts = checks.finite("histograms", checks.real_array("histograms", histograms, np.float64))
    shapes = {name: light.radiance.shape[0] for name, light in lights.items()}
    zones = len(sensor.gains)
    for name, poses in shapes.items():
        valid = counts.shape == (poses, zones, sensor.bins)
        allowed = f"({poses}, {zones}, {sensor.bins}): the poses of {name}, zones and bins"
        checks.shape("histograms", counts, valid, allowed)
    checks.require("histograms", float(counts.min()), counts.min() >= 0, "0 or more")
    # All parts must have the same pixels and bins
    first = next(iter(lights.values()))
    for name, light in lights.items():
        same = light.radiance.shape == first.radiance.shape
        for axis in ("opl", "edges_x", "edges_y"):
            same = same and np.allclose(getattr(light, axis), getattr(first, axis))
        if not same:
            raise ValueError(f"renders: {name} has other pixels or bins than the first part")
    return counts


def _weighted(albedos: np.ndarray, signals: list[np.ndarray]) -> np.ndarray:
    """Return the sum of the signals of parts, weighted by their albedos."""
    total = np.zeros_like(signals[0])
    for albedo, signal in zip(albedos, signals, strict=True):
        total += albedo * signal
    return total


class _Problem:
    """Residuals and derivatives of a calibration, as functions of a vector of variables.

    Positive parameters are represented by their logarithm, and lengths are measured in bins.
    """

    def __init__(
        self,
        sensor: MultiZone,
        lights: Mapping[str, Light],
        counts: np.ndarray,
        names: list[str],
        relative_error: float,
        bins: slice,
    ) -> None:
        self.parts = list(lights)
        self.lights = list(lights.values())
        self.radiance = [light.radiance for light in self.lights]
        self.counts = counts
        self.names = names
        self.bins = bins

        # Error of each count
        compared = np.maximum(counts[..., bins], 1)
        largest = compared.max(axis=(1, 2), keepdims=True)
        self.error = np.sqrt(compared * (1 + relative_error**2 * largest))

        # Start values, as variables
        self.first = self._with_estimates(sensor)
        self.unit_opl = sensor.bin_width_opl
        self.sizes = {name: self._variables(self.first, name).size for name in names}
        self.sizes["albedos"] = len(self.parts) - 1
        variables = [self._variables(self.first, name) for name in names]
        self.start = np.concatenate([*variables, np.zeros(self.sizes["albedos"])])
        self.labels = self._labels()

    def _with_estimates(self, sensor: MultiZone) -> MultiZone:
        """Estimate gains and floors that are fitted from the sums of the histograms."""
        if "floors" in self.names:
            # Floors are a small quantile
            floors = np.quantile(self.counts[..., self.bins], 0.02, axis=(0, 2))
            sensor = replace(sensor, floors=np.maximum(floors, 0.1))
        if "gains" in self.names:
            # Gains are ratios of the sums
            model = replace(sensor, floors=0 * sensor.floors)
            expected = self._expected(model, np.ones(len(self.parts)))
            light = (self.counts - sensor.floors[:, None])[..., self.bins].sum(axis=(0, 2))
            total = expected[..., self.bins].sum(axis=(0, 2))
            dark = np.flatnonzero(total <= 0)
            if dark.size:
                raise ValueError(
                    f"zone {dark[0]} receives no light in the compared bins of the renders. Check "
                    "starts_opl, the zones and the window of the renders"
                )
            sensor = replace(sensor, gains=sensor.gains * np.maximum(light, 1) / total)
        return sensor

    def _variables(self, sensor: MultiZone, name: str) -> np.ndarray:
        """Return a parameter of a sensor as fitted variables."""
        if name == "pulse":
            pulse: Any = sensor.pulse
            return np.log(np.delete(pulse.values, self._top(pulse)) / pulse.values.max())
        value = np.ravel(np.asarray(getattr(sensor, name), np.float64))
        if name == "starts_opl":
            return value / self.unit_opl
        if name in LOGARITHMIC:
            return np.log(np.maximum(value, LEAST.get(name, 0.0)))
        return value

    @staticmethod
    def _top(pulse: KnotPulse) -> int:
        """Return the index of the knot with the largest value.

        This value is not fitted, because the pulse is normalized.
        """
        return int(np.argmax(pulse.values))

    def _with(self, sensor: MultiZone, name: str, variables: np.ndarray) -> MultiZone:
        """Return a sensor with one parameter replaced by the values of its variables."""
        # A pulse: insert the fixed knot
        if name == "pulse":
            pulse: Any = self.first.pulse
            limited = np.clip(variables, -LARGEST_LOG, LARGEST_LOG)
            values = np.insert(np.exp(limited), self._top(pulse), 1.0)
            return replace(sensor, pulse=KnotPulse(pulse.knots, values))

        # Other parameters
        value = variables
        if name == "starts_opl":
            value = variables * self.unit_opl
        if name in LOGARITHMIC:
            # Trial steps can be far too long, and are then rejected by their large residuals
            value = np.exp(np.clip(variables, -LARGEST_LOG, LARGEST_LOG))
            value = np.minimum(value, MOST.get(name, np.inf))
        return replace(
            sensor, **{name: value if self.sizes[name] > 1 or name in ZONED else value[0]}
        )

    def _split(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Return the variables of each parameter."""
        ends = np.cumsum(list(self.sizes.values()))[:-1]
        return dict(zip(self.sizes, np.split(x, ends), strict=True))

    def sensor_and_albedos(self, x: np.ndarray) -> tuple[MultiZone, np.ndarray]:
        """Return the sensor and the albedos of parts for given variables."""
        given = self._split(x)
        sensor = self.first
        for name in self.names:
            sensor = self._with(sensor, name, given[name])
        return sensor, np.exp(np.concatenate([[0.0], given["albedos"]]))

    def _signals(self, weights: np.ndarray) -> list[np.ndarray]:
        """Return the signals of zones of each part, (poses, zones, opl)."""
        flat = weights.reshape(len(weights), -1)
        return [
            np.matmul(flat, each.reshape(len(each), flat.shape[1], -1)) for each in self.radiance
        ]

    def _expected(self, sensor: MultiZone, albedos: np.ndarray) -> np.ndarray:
        """Return expected counts (poses, zones, bins)."""
        signals = self._signals(sensor.weights(self.lights[0]))
        total = _weighted(albedos, signals)
        return sensor.binned(sensor.responses(self.lights[0].opl), sensor.crossed(total))

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return expected minus measured counts over their error, flat."""
        expected = self._expected(*self.sensor_and_albedos(x))
        return ((expected - self.counts)[..., self.bins] / self.error).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals, (residuals, variables)."""
        # Evaluate the model
        sensor, albedos = self.sensor_and_albedos(x)
        light = self.lights[0]
        weights = sensor.weights(light)
        signals = self._signals(weights)
        total = _weighted(albedos, signals)
        crossed = sensor.crossed(total)
        responses = sensor.responses(light.opl)
        without_floor = replace(sensor, floors=0 * sensor.floors)
        zones = len(sensor.gains)
        columns: list[np.ndarray] = []

        def own_zone(counts: np.ndarray) -> None:
            """Add a column of the Jacobian for each zone, for variables that change only this zone.

            Args:
                counts: Derivative of the counts of each zone by the variable of this zone, (poses,
                    zones, bins).
            """
            for zone in range(zones):
                column = np.zeros_like(counts)
                column[:, zone] = counts[:, zone]
                columns.append(column)

        def of_weights(signal: np.ndarray) -> np.ndarray:
            """Return the change of counts by a change of signals."""
            return without_floor.binned(responses, sensor.crossed(signal))

        def of_responses(change: np.ndarray) -> np.ndarray:
            """Return the change of counts by a change of responses."""
            return without_floor.binned(change, crossed)

        # Add the columns of each parameter
        variables = self._split(x)
        for name in self.names:
            if name == "gains":
                own_zone(without_floor.binned(responses, crossed))
            elif name == "floors":
                own_zone(np.broadcast_to(sensor.floors[:, None], self.counts.shape))
            elif name == "starts_opl":
                change = self._difference(sensor, name, variables[name], None)
                own_zone(of_responses(change))
            elif name == "crosstalk":
                spread = np.broadcast_to(total.sum(axis=1, keepdims=True), total.shape)
                columns.append(without_floor.binned(responses, sensor.crosstalk * spread))
            elif name in ("pulse", "bin_width_opl"):
                for k in range(self.sizes[name]):
                    columns.append(of_responses(self._difference(sensor, name, variables[name], k)))
            else:
                for k in range(self.sizes[name]):
                    change = self._difference(sensor, name, variables[name], k)
                    changed = self._signals(change)
                    signal = _weighted(albedos, changed)
                    columns.append(of_weights(signal))

        # Add the columns of albedos
        for albedo, signal in zip(albedos[1:], signals[1:], strict=True):
            columns.append(of_weights(albedo * signal))
        stacked = np.stack([(c[..., self.bins] / self.error).ravel() for c in columns], axis=1)
        return stacked

    def _difference(
        self, sensor: MultiZone, name: str, variables: np.ndarray, k: int | None
    ) -> np.ndarray:
        """Return the derivative of responses or weights by a variable.

        Args:
            sensor: The sensor.
            name: Name of the parameter.
            variables: Variables of the parameter.
            k: Index of the variable, None to change all variables together.
        """
        light = self.lights[0]
        of_pulse = name in ("pulse", "bin_width_opl", "starts_opl")

        def evaluate(changed: np.ndarray) -> np.ndarray:
            """Return the responses or the weights for changed variables."""
            other = self._with(sensor, name, changed)
            return other.responses(light.opl) if of_pulse else other.weights(light)

        step = np.zeros_like(variables)
        step[slice(None) if k is None else k] = STEP
        return (evaluate(variables + step) - evaluate(variables - step)) / (2 * STEP)

    def _labels(self) -> list[str]:
        """Return the name of each variable."""
        labels: list[str] = []
        for name in self.names:
            size = self.sizes[name]
            if name == "pulse":
                pulse: Any = self.first.pulse
                kept = [k for k in range(pulse.knots.size) if k != self._top(pulse)]
                labels += [f"pulse[{k}]" for k in kept]
            else:
                labels += [f"{name}[{k}]" for k in range(size)] if size > 1 else [name]
        return labels + [f"albedo {name}" for name in self.parts[1:]]

    def require_determined(self, x: np.ndarray) -> None:
        """Raise a ValueError if the histograms do not determine all variables."""
        # Are there enough bins?
        jacobian = self.jacobian(x)
        if len(jacobian) < x.size:
            raise ValueError(
                f"{len(jacobian)} bins do not determine {x.size} parameters. Pass more poses, or "
                "fit fewer parameters"
            )

        # Does each variable have an effect?
        norms = np.linalg.norm(jacobian, axis=0)
        without = [label for label, norm in zip(self.labels, norms, strict=True) if norm == 0]
        if without:
            raise ValueError(
                f"the histograms do not depend on {', '.join(without[:5])}. Keep these parameters, "
                "or pass renders in which these zones, knots or parts receive light"
            )

        # Are the variables independent?
        unit = jacobian / norms
        values, vectors = np.linalg.eigh(unit.T @ unit)
        if values[0] < DEPENDENT * values[-1]:
            direction = np.abs(vectors[:, 0])
            several = [self.labels[k] for k in np.argsort(direction)[::-1][:4]]
            raise ValueError(
                f"the histograms do not determine {', '.join(several)} separately. Keep one of "
                "these parameters, or pass more poses"
            )

    def calibration(self, x: np.ndarray) -> Calibration:
        """Return the result, with standard errors and correlations."""
        sensor, albedos = self.sensor_and_albedos(x)
        residuals = self.residuals(x)
        jacobian = self.jacobian(x)
        freedom = max(residuals.size - x.size, 1)
        chi_square = float(residuals @ residuals / freedom)

        # Invert J^T J of unit columns, which is better conditioned. Negligible knots have no effect
        # on the histograms, and are not determined
        norms = np.linalg.norm(jacobian, axis=0)
        known = np.flatnonzero(norms > NEGLIGIBLE * norms.max())
        scaled = jacobian[:, known] / norms[known]
        covariance = np.linalg.inv(scaled.T @ scaled)
        spread = np.sqrt(np.diag(covariance))
        correlation = np.full((x.size, x.size), np.nan)
        correlation[np.ix_(known, known)] = covariance / spread[:, None] / spread
        errors = np.full(x.size, np.inf)
        errors[known] = np.sqrt(chi_square) * spread / norms[known]

        # Convert the variables to values of the parameters
        values = x.copy()
        start = 0
        for name, size in self.sizes.items():
            part = slice(start, start + size)
            start += size
            if name == "starts_opl":
                values[part] *= self.unit_opl
                errors[part] *= self.unit_opl
            elif name in LOGARITHMIC:
                values[part] = np.exp(x[part])
                errors[part] *= values[part]

        # Label the result
        coords = {"parameter": self.labels}
        shape = (*self.counts.shape[:2], -1)
        bins = np.arange(self.counts.shape[2])[self.bins]
        return Calibration(
            sensor=sensor,
            albedos=dict(zip(self.parts, map(float, albedos), strict=True)),
            values=xr.DataArray(values, coords, dims="parameter"),
            standard_errors=xr.DataArray(errors, coords, dims="parameter"),
            correlation=xr.DataArray(
                correlation, coords | {"other": self.labels}, dims=("parameter", "other")
            ),
            residuals=xr.DataArray(
                -residuals.reshape(shape), {"bin": bins}, dims=("pose", "zone", "bin")
            ),
            chi_square=chi_square,
        )
