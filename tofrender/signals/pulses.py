"""Pulses: temporal profiles of emitted light.

A pulse is a density over the offset t from the pulse's center, in meters of optical path:

    eval(t)      density p(t) [1/m]
    cdf(t)       integral of p up to t; differences are exact energies of bins
    sample(xi)   (t, weight) for a uniform random number xi, with E[weight f(t)] = integral of p f
    support      (first, last) offset [m]; outside of this interval, p is 0 or negligible

All three functions accept Dr.Jit floats or numbers, and return the same type (`weight` is always a
Dr.Jit float). `sample` is finite for every xi in [0, 1], including both ends. Widths are from 1e-12
to 1e12 m. Arguments out of range raise a ValueError.
"""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.archives import read_array


class Pulse(Protocol):
    """Interface of pulses; see the docstring of the module."""

    @property
    def support(self) -> tuple[float, float]: ...  # noqa: D102

    def eval(self, t: mi.Float) -> mi.Float: ...  # noqa: D102

    def cdf(self, t: mi.Float) -> mi.Float: ...  # noqa: D102

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]: ...  # noqa: D102


def _like(given: Any, result: Any) -> Any:
    """Convert a result of type Dr.Jit float to a number if the argument `given` was a number."""
    return result[0] if isinstance(given, Real) else result


class GaussianPulse:
    """Normalized Gaussian p(t) = exp(-t^2 / (2 s^2)) / (s sqrt(2 pi)).

    Args:
        width_opl: Standard deviation s [m], a number or a Dr.Jit float with gradients.

    Attributes:
        width: s as a Dr.Jit float.
        normalization: 1 / (s sqrt(2 pi)) [1/m].

    Example:
        >>> pulse = GaussianPulse(width_opl=0.05)
        >>> round(float(pulse.eval(0.0)), 4)
        7.9788
        >>> float(pulse.cdf(0.0))
        0.5
    """

    def __init__(self, width_opl: float | mi.Float) -> None:
        given: Any = width_opl if dr.is_array_v(width_opl) and dr.width(width_opl) == 1 else None
        self._width: Any = None if given is None else dr.copy(given)
        self._set_width(width_opl if given is None else given[0])

    @property
    def width(self) -> mi.Float:
        """Standard deviation [m] as a Dr.Jit float, the same variable in each call.

        Gradients may be enabled on this variable. After assigning a value to it, call `take_width`.
        """
        if type(self._width) is not mi.Float:
            self._width = mi.Float(self.width_opl)
        return self._width

    def take_width(self) -> None:
        """Update `width_opl` and `normalization` to the value of `width`."""
        self._set_width(dr.slice(self.width))

    def _set_width(self, number: Any) -> None:
        self.width_opl = checks.width("width_opl", number)
        self.normalization = 1.0 / (self.width_opl * math.sqrt(2.0 * math.pi))

    def __copy__(self) -> GaussianPulse:
        return GaussianPulse(self.width_opl if self._width is None else self._width)

    @property
    def _variable_width(self) -> Any:
        """Return the width if it has gradients, or if a fit changes it; otherwise return None."""
        width = self._width
        if dr.grad_enabled(width) or (width is not None and width.state == dr.VarState.Evaluated):
            return width
        return None

    @property
    def support(self) -> tuple[float, float]:
        """Interval of five standard deviations to each side [m]; 6e-7 of the energy is outside."""
        return (-5.0 * self.width_opl, 5.0 * self.width_opl)

    def eval(self, t: mi.Float) -> mi.Float:
        """Return the density [1/m] at the offset `t` [m]."""
        z = t / self.width_opl
        height = self.normalization
        width = self._variable_width
        if width is not None:
            z = t / width
            height = dr.rcp(width * math.sqrt(2.0 * math.pi))
        return height * dr.exp(-0.5 * z * z)

    def cdf(self, t: mi.Float) -> mi.Float:
        """Return the fraction of the energy up to `t` [m]: (1 + erf(t / (s sqrt 2))) / 2."""
        variable = self._variable_width
        width: Any = self.width_opl if variable is None else variable
        return 0.5 + 0.5 * dr.erf(t / (width * math.sqrt(2.0)))

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return the offset s sqrt(2) erfinv(2 xi - 1) [m] and the weight 1.

        erfinv is infinite at both ends, and samplers with 24 bits sometimes return 0. Therefore
        `xi` is limited to the interval from 2^-24 to 1 - 2^-24, so that every offset is finite.
        """
        edge = 2.0**-24
        argument = dr.clip(2.0 * xi - 1.0, -1.0 + 2 * edge, 1.0 - 2 * edge)
        return self.width_opl * math.sqrt(2.0) * dr.erfinv(argument), mi.Float(1.0)

    def __repr__(self) -> str:
        return f"GaussianPulse(width_opl={self.width_opl:g})"


class BoxPulse:
    """Box p(t) = 1 / w over [-w/2, w/2], such as a laser that is on for w/c, or an open gate.

    Args:
        width_opl: Full width w [m].

    Attributes:
        normalization: 1 / w [1/m].

    Example:
        >>> pulse = BoxPulse(width_opl=0.5)
        >>> pulse.eval(0.1), pulse.eval(0.3), pulse.cdf(0.125)
        (2.0, 0.0, 0.75)
    """

    def __init__(self, width_opl: float) -> None:
        self.width_opl = checks.width("width_opl", width_opl)
        self.normalization = 1.0 / self.width_opl

    @property
    def support(self) -> tuple[float, float]:
        """Ends of the box [m]."""
        return (-0.5 * self.width_opl, 0.5 * self.width_opl)

    def eval(self, t: mi.Float) -> mi.Float:
        """Return the density [1/m] at the offset `t` [m]; both ends belong to the box."""
        density: Any = self.normalization
        return dr.select(dr.abs(t) <= 0.5 * self.width_opl, density, 0.0)

    def cdf(self, t: mi.Float) -> mi.Float:
        """Return the fraction of the energy up to `t` [m]: t / w + 1/2, limited to [0, 1]."""
        return dr.clip(t / self.width_opl + 0.5, 0.0, 1.0)

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return the offset w (xi - 1/2) [m] and the weight 1."""
        return self.width_opl * (dr.clip(xi, 0.0, 1.0) - 0.5), mi.Float(1.0)

    def __repr__(self) -> str:
        return f"BoxPulse(width_opl={self.width_opl:g})"


class SampledPulse:
    """Measured pulse: a normalized density that is constant in each of n equal bins.

    Args:
        values: Relative energy in each bin, shape (n,), 0 or more, at least one above 0.
        start_opl: Offset at the start of the first bin [m].
        bin_width_opl: Width of a bin [m].

    Attributes:
        density: Normalized density in each bin [1/m], NumPy array of shape (n,).

    Example:
        >>> pulse = SampledPulse([1.0, 3.0], start_opl=0.0, bin_width_opl=0.5)
        >>> pulse.density.tolist()
        [0.5, 1.5]
        >>> pulse.eval(0.75), pulse.cdf(0.5)
        (1.5, 0.25)
    """

    def __init__(
        self, values: Sequence[float] | np.ndarray, start_opl: float, bin_width_opl: float
    ) -> None:
        # Check the values
        try:
            energy = checks.real_array("values", values, np.float64)
        except ValueError:
            allowed = "must be a list of finite numbers, 0 or more"
            raise ValueError(f"values = {checks.quote(values)}: {allowed}") from None
        if energy.ndim != 1 or energy.size == 0:
            raise ValueError(f"values with shape {energy.shape}: must be a list of numbers")
        if not np.all(np.isfinite(energy)) or np.any(energy < 0):
            worst = energy[~np.isfinite(energy) | (energy < 0)][0]
            raise ValueError(f"values: contain {worst:g}; all must be finite numbers, 0 or more")
        if not np.any(energy > 0):
            raise ValueError("values: all are 0; at least one must be above 0")

        # Normalize the density; the sum of large energies could overflow
        self.start_opl = checks.meters("start_opl", start_opl)
        self.bin_width_opl = checks.width("bin_width_opl", bin_width_opl)
        energy = energy / energy.max()
        mass = energy / energy.sum()
        self.density = mass / self.bin_width_opl
        self._cumulative = np.concatenate([[0.0], np.cumsum(mass)])
        self._cumulative[-1] = 1.0

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> SampledPulse:
        r"""Read a measured pulse from a file.

        Args:
            path: A file of one of two kinds.
                `.npz`: arrays `values` of shape (n,), `start_opl` and `bin_width_opl` [m].
                `.csv` or `.txt`: a row with center [m] and value for each of at least two bins,
                separated by commas, semicolons or blanks. The centers are evenly spaced, up to a
                hundredth of a bin. The first row may contain names, and `#` starts a comment.

        Raises:
            FileNotFoundError: If the file does not exist.
            ValueError: If the file does not contain a pulse.

        Example:
            >>> import tempfile
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     path = Path(folder, "laser.csv")
            ...     _ = path.write_text("opl_m,value\n0.25,1\n0.75,3\n")
            ...     SampledPulse.from_file(path)
            SampledPulse(2 values, start_opl=0, bin_width_opl=0.5)
        """
        readers = {".npz": _read_npz, ".csv": _read_table, ".txt": _read_table}
        path = checks.path("path", path)
        where = f"path = {str(path)!r}"
        if path.suffix.lower() not in readers:
            raise ValueError(f"{where}: must end in .npz, .csv or .txt")
        if not path.is_file():
            raise FileNotFoundError(f"{where}: does not exist. Pass an existing file")
        try:
            return cls(*readers[path.suffix.lower()](path))
        except OSError as error:
            raise ValueError(f"{where}: cannot be read, {error.strerror}") from None
        except UnicodeDecodeError:
            raise ValueError(f"{where}: must be text in UTF-8") from None
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None

    @property
    def support(self) -> tuple[float, float]:
        """Start of the first bin and end of the last bin [m]."""
        return (self.start_opl, self.start_opl + self.density.size * self.bin_width_opl)

    def eval(self, t: mi.Float) -> mi.Float:
        """Return the density [1/m] at the offset `t` [m]."""
        position = (mi.Float(t) - self.start_opl) / self.bin_width_opl
        inside = (position >= 0) & (position < self.density.size)
        density = dr.gather(mi.Float, mi.Float(self.density), mi.UInt32(position), inside)
        return _like(t, density)

    def cdf(self, t: mi.Float) -> mi.Float:
        """Return the fraction of the energy up to the offset `t` [m]."""
        # Find the bin, and interpolate the cumulative energy
        n = self.density.size
        position = dr.clip((mi.Float(t) - self.start_opl) / self.bin_width_opl, 0, n)
        k = dr.minimum(mi.UInt32(position), n - 1)
        table = mi.Float(self._cumulative)
        low = dr.gather(mi.Float, table, k)
        high = dr.gather(mi.Float, table, k + 1)
        return _like(t, dr.lerp(low, high, position - k))

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return the offset [m] by inversion of the cdf, and the weight 1."""
        # Find the bin
        u = dr.clip(mi.Float(xi), 0, 1)
        table = mi.Float(self._cumulative)
        last = self.density.size - 1
        k = dr.binary_search(0, last, lambda i: dr.gather(mi.Float, table, i + 1) <= u)

        # Invert the linear cdf within the bin
        low = dr.gather(mi.Float, table, k)
        high = dr.gather(mi.Float, table, k + 1)
        within = dr.clip(dr.select(high > low, (u - low) / (high - low), 0), 0, 1)
        t = self.start_opl + (k + within) * self.bin_width_opl
        return _like(xi, t), mi.Float(1.0)

    def __repr__(self) -> str:
        return (
            f"SampledPulse({self.density.size} values, start_opl={self.start_opl:g}, "
            f"bin_width_opl={self.bin_width_opl:g})"
        )


class KnotPulse(SampledPulse):
    """Pulse through knots, whose logarithm is linear between them, normalized.

    A few knots describe a steep rise and a long tail. The density is 0 outside the knots, and

        p(t) = v_i (v_{i+1} / v_i)^((t - t_i) / (t_{i+1} - t_i))   between the knots i and i + 1.

    Each bin of the `SampledPulse` contains the exact integral of p.

    Args:
        opl: Offsets t of the knots [m], shape (n,), rising, 2 knots or more.
        values: Relative densities v at the knots, shape (n,), each above 0.
        steps: Bins in the smallest distance between two knots, 1 to 1024.

    Attributes:
        knots: Offsets of the knots [m], NumPy array of shape (n,).
        values: Relative densities at the knots, NumPy array of shape (n,).

    Example:
        >>> pulse = KnotPulse([0.0, 0.1, 0.5], [0.01, 1.0, 0.02])
        >>> pulse.support, round(float(pulse.cdf(0.5)), 6)
        ((0.0, 0.5), 1.0)
    """

    def __init__(
        self,
        opl: Sequence[float] | np.ndarray,
        values: Sequence[float] | np.ndarray,
        steps: int = 16,
    ) -> None:
        knots = checks.finite("opl", checks.real_array("opl", opl, np.float64))
        levels = checks.finite("values", checks.real_array("values", values, np.float64))
        rises = knots.ndim == 1 and knots.size > 1 and bool((np.diff(knots) > 0).all())
        checks.require("opl", opl, rises, "2 or more offsets in meters that rise")
        checks.shape("values", levels, levels.shape == knots.shape, f"of {knots.size} numbers")
        checks.require("values", values, bool((levels > 0).all()), "above 0 at each knot")
        steps = checks.integer("steps", steps, 1, 1024)

        # Integrate the density up to the edge of each bin
        smallest = float(np.diff(knots).min())
        count = math.ceil((knots[-1] - knots[0]) / smallest * steps)
        checks.require("opl", opl, count <= checks.MAX_BINS, "closer to even steps")
        edges = np.linspace(knots[0], knots[-1], count + 1)
        cumulative = _integral_of_exponentials(knots, levels / levels.max(), edges)
        super().__init__(np.diff(cumulative), float(edges[0]), float(edges[1] - edges[0]))
        self.knots = knots
        self.values = levels

    def __repr__(self) -> str:
        return f"KnotPulse({self.knots.tolist()}, {self.values.tolist()})"


def _integral_of_exponentials(
    knots: np.ndarray, levels: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Integrate a function with a linear logarithm from the first knot up to each edge."""
    widths = np.diff(knots)
    slopes = np.diff(np.log(levels))

    def fraction(slope: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the integral of exp(slope u) over u from 0 to x."""
        small = np.abs(slope) < 1e-9
        safe = np.where(small, 1.0, slope)
        return np.where(small, x, np.expm1(safe * x) / safe)

    whole = levels[:-1] * widths * fraction(slopes, np.ones_like(slopes))
    before = np.concatenate([[0.0], np.cumsum(whole)])
    k = np.clip(np.searchsorted(knots, edges, side="right") - 1, 0, widths.size - 1)
    x = (edges - knots[k]) / widths[k]
    return before[k] + levels[k] * widths[k] * fraction(slopes[k], x)


def _read_npz(path: Path) -> tuple[np.ndarray, float, float]:
    """Read values, start [m] and bin width [m] from an `.npz` file."""
    names = ("values", "start_opl", "bin_width_opl")
    allowed = f"must be an .npz file with the arrays {', '.join(names)}"
    try:
        # `np.load` would accept other kinds of file too
        with zipfile.ZipFile(path) as archive:
            missing = [name for name in names if f"{name}.npy" not in archive.namelist()]
            if missing:
                raise ValueError(f"{missing[0]} is missing; {allowed}")
            values, start, width = (read_array(archive, name) for name in names)
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError):
        raise ValueError(f"the file is damaged or of another kind; {allowed}") from None
    for name, number in (("start_opl", start), ("bin_width_opl", width)):
        if number.size != 1:
            raise ValueError(f"{name} with shape {number.shape}: must be one number")
    return values, start.item(), width.item()


def _read_table(path: Path) -> tuple[np.ndarray, float, float]:
    """Read values, start [m] and bin width [m] from rows with center and value of a bin."""
    # Read the rows; the first row may contain names
    rows: list[list[float]] = []
    for line, text in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1):
        words = text.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        row = [_number(word) for word in words]
        numbers = [number for number in row if number is not None]
        if len(row) == len(numbers) == 2 and math.isfinite(numbers[0]):
            rows.append(numbers)
        elif rows or numbers:
            raise ValueError(f"line {line} = {text[:40]!r}: must be two numbers, opl [m] and value")
    if len(rows) < 2:
        raise ValueError(f"found {len(rows)} rows; must be at least two, each opl [m] and value")

    # Find the spacing of the centers
    opl, values = np.array(rows).T
    step = (opl[-1] - opl[0]) / (opl.size - 1)
    uneven = np.abs(opl - np.linspace(opl[0], opl[-1], opl.size)) > 0.01 * step
    if step <= 0 or uneven.any():
        worst = opl[np.argmax(uneven)] if step > 0 else opl[-1]
        raise ValueError(f"opl = {worst:g}: opl must increase in even steps, here {step:g} meters")
    return values, float(opl[0] - 0.5 * step), float(step)


def _number(word: str) -> float | None:
    """Convert a word to a number, or return None if it is not a number."""
    try:
        return float(word)
    except ValueError:
        return None


def convolve(first: Pulse, second: Pulse) -> Pulse:
    """Return the convolution of two pulses, for example of a laser and a detector.

    The convolution of two Gaussians is a Gaussian. Other pulses are convolved in 4096 bins of their
    joint support. The mean of the result is the sum of both means.

    Example:
        >>> convolve(GaussianPulse(0.03), GaussianPulse(0.04))
        GaussianPulse(width_opl=0.05)
    """
    if isinstance(first, GaussianPulse) and isinstance(second, GaussianPulse):
        return GaussianPulse(math.hypot(first.width_opl, second.width_opl))

    # Energy of both pulses in equal bins
    low = first.support[0] + second.support[0]
    step = (first.support[1] + second.support[1] - low) / 4096
    masses = [_masses(pulse, step) for pulse in (first, second)]

    # The sum of offsets in the bins [i, i+1) and [j, j+1) is in [i+j, i+j+2), half of it in each
    # bin
    joint = np.convolve(masses[0], masses[1])
    joint = 0.5 * (np.append(joint, 0.0) + np.insert(joint, 0, 0.0))

    # Correct the mean: a pulse that is narrower than a bin fills a whole bin
    mean = low + step * (joint @ (np.arange(joint.size) + 0.5)) / joint.sum()
    return SampledPulse(joint, low + _mean(first) + _mean(second) - mean, step)


def _masses(pulse: Pulse, step: float) -> np.ndarray:
    """Return the energy of a pulse in bins of width `step` [m] that cover its support."""
    low, high = pulse.support
    edges = low + step * np.arange(math.ceil((high - low) / step) + 1)
    values: Any = pulse.cdf(mi.Float(edges))
    return np.clip(np.diff(np.array(values, dtype=np.float64)), 0.0, None)


def _mean(pulse: Pulse) -> float:
    """Return the mean offset of a pulse [m], computed from 4096 bins of its support."""
    low, high = pulse.support
    step = (high - low) / 4096
    masses = _masses(pulse, step)
    return low + step * float(masses @ (np.arange(masses.size) + 0.5) / masses.sum())
