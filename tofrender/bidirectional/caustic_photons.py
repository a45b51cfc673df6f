"""Caustic photons: paths from emitters that start with a delta lobe and end on a smooth one.

They are paths of the kind `CAUSTIC` (see `paths.path_kinds`). A photon meets a mirror or clear
glass first, and continues by its delta lobes. Later vertices connect to the lens, by their
smooth lobes. Few directions of emission lead to such paths. A table aims at them: the uniform
numbers of emission sampling form a unit cube, which is cut into cells, and a pilot finds how much
light of each cell arrives in the picture. A photon's cell is sampled with the probability

    p(cell) = 0.9 light(cell) / light + 0.1 / cells

and its weight is divided by p(cell) cells. This is importance sampling in primary sample space
(Kelemen et al. 2002): the density of emission itself stays unchanged, whatever the emitter is.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.contribution import Contribution
from ..paths.protocols import Measurement, Parts
from ..paths.records import Connection, Limits, Path, Vertex
from ..paths.scattering import Materials
from ..paths.space import Vacuum
from ..paths.walk import step, walk
from ..runtime.backend import tracing_lock
from ..signals.polarization import intensity
from .emission import Emission
from .lens import Lens
from .lens_connections import LensEndpoint, LightPathHistory
from .mis import BidirectionalMIS

PILOT = 1 << 16  # photons of the pilot
PILOT_SEED = 0xA13
DIRECTIONS = 32  # cells along each axis of the square that directions are sampled from
POSITIONS = ((1, 4), (4, 2), (64, 1))  # emitters at most, and cells along an axis for positions
AIMED = 0.9  # part of the photons that are aimed; the others start in any cell
RR_DEPTH = 2  # vertices from which on Russian roulette may end a photon


class EmissionTable:
    """Cells of the unit cube from which emission is sampled, with a probability for each.

    The cells divide the number that chooses the emitter, the two numbers of a position and the two
    numbers of a direction.

    Args:
        emitters: Number of the scene's emitters.
    """

    def __init__(self, emitters: int) -> None:
        fitting = [cells for most, cells in POSITIONS if emitters <= most]
        self.emitters = emitters if fitting else 1
        self.positions = fitting[0] if fitting else 1
        self.size = self.emitters * self.positions**2 * DIRECTIONS**2
        self.distribution: mi.DiscreteDistribution | None = None  # None if all cells are alike

    def aim(self, light: np.ndarray) -> None:
        """Choose the cells' probabilities by the light that arrives from each."""
        # Smooth over neighboring directions, since the pilot is short
        shape = (-1, DIRECTIONS, DIRECTIONS)
        cells = light.astype(float).reshape(shape)
        padded = np.pad(cells, ((0, 0), (1, 1), (1, 1)), mode="edge")
        along_u = padded[:, 2:, 1:-1] + padded[:, :-2, 1:-1]
        along_v = padded[:, 1:-1, 2:] + padded[:, 1:-1, :-2]
        smoothed = (0.5 * cells + 0.125 * (along_u + along_v)).ravel()

        # Mix with the uniform distribution, so that no light is left out
        aimed = smoothed / smoothed.sum()
        self.distribution = mi.DiscreteDistribution(
            mi.Float(AIMED * aimed + (1 - AIMED) / self.size)
        )

    def sample(
        self, sampler: mi.Sampler
    ) -> tuple[mi.UInt32, mi.Float, mi.Point2f, mi.Point2f, mi.Float]:
        """Sample a cell, and the numbers that emission is sampled by.

        Returns the cell, the numbers for emitter, position and direction, and their density in the
        unit cube.
        """
        u = sampler.next_1d()
        if self.distribution is None:
            cell = dr.minimum(mi.UInt32(u * self.size), self.size - 1)
            density = mi.Float(1)
        else:
            cell, probability = self.distribution.sample_pmf(u)
            density = probability * self.size

        # The position of the cell in the cube
        direction = cell % (DIRECTIONS**2)
        rest = cell // (DIRECTIONS**2)
        position = rest % (self.positions**2)
        emitter = rest // (self.positions**2)

        # A uniform point of the cell
        xi = (mi.Float(emitter) + sampler.next_1d()) / self.emitters
        corner = mi.Point2f(position // self.positions, position % self.positions)
        u_position = (corner + sampler.next_2d()) / self.positions
        corner = mi.Point2f(direction // DIRECTIONS, direction % DIRECTIONS)
        u_direction = (corner + sampler.next_2d()) / DIRECTIONS
        return cell, xi, u_position, u_direction, density


class CausticPhotons:
    """Traces caustic photons, and adds their connections to the lens as splats.

    Args:
        scene: The scene, without media.
        sensor: A `perspective` or `thinlens` camera.
        space: The space of paths from the camera.
        limits: The limits of paths from the camera.
        hide_emitters: Whether the camera looks through area lights.
    """

    splats = True

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        space: Vacuum,
        limits: Limits,
        hide_emitters: bool,
    ) -> None:
        self.scene = scene
        self.sensor = sensor
        self.hide_emitters = hide_emitters
        self.camera_unwarp = limits.camera_unwarp
        self.lens = Lens(sensor)
        self.emission = Emission(scene, sensor)
        self.table = EmissionTable(len(scene.emitters()))
        self.limits = Limits(limits.max_depth, RR_DEPTH, min_depth=limits.min_depth)
        self.space = space
        self.delta_lobes = Materials(scene, importance=True, lobes=mi.BSDFFlags.Delta)
        self.all_lobes = Materials(scene, importance=True)

    def trace_pilot(self) -> np.ndarray:
        """Return the light that arrives from each cell, found by photons that are not aimed.

        The result has the same bits in each call. Therefore each photon has its own sum, instead of
        a sum of each cell to which threads would add in any order.
        """
        # Start the photons
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(PILOT_SEED, PILOT)
        ray, _ = self.sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
        ray = mi.Ray3f(ray)
        ray.o += dr.zeros(mi.Float, PILOT)

        # Sum the light of each photon, and then of each cell
        light = _LightByPhoton(PILOT)
        self._trace(sampler, ray, light, True)
        dr.eval(light.cell, light.sums)
        cells = np.array(light.cell)
        return np.bincount(cells, weights=np.array(light.sums), minlength=self.table.size)

    def aim(self, light: np.ndarray) -> bool:
        """Aim the emission at the light of a pilot; returns False if no light arrives."""
        if not light.sum() > 0:
            return False
        self.table.aim(light)
        return True

    def trace(
        self,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        measurement: Measurement,
        frame: mi.Spectrum | None = None,
    ) -> tuple[Measurement, Path]:
        """Trace one photon for each camera ray, which has its wavelengths and its time."""
        return self._trace(sampler, ray, measurement, True)

    @tracing_lock()
    def _trace(
        self, sampler: mi.Sampler, ray: mi.Ray3f, measurement: Measurement, active: mi.Bool | bool
    ) -> tuple[Measurement, Path]:
        """Trace photons. In a pilot, the measurement learns the cells of the photons."""
        # Sample emission that rays from surfaces could run into
        cell, xi, u_position, u_direction, density = self.table.sample(sampler)
        emitted = self.emission.sample_at(xi, u_position, u_direction, ray)
        emitted.weight = emitted.weight / density
        emitted.active &= ~emitted.delta
        if isinstance(measurement, _LightByPhoton):
            measurement.cell = cell

        # Follow a delta lobe from the first vertex, and any lobe from later ones
        mis = BidirectionalMIS(exponent=0)
        history = LightPathHistory(
            scene=self.scene,
            emission=self.emission,
            emitted=emitted,
            scattering=self.all_lobes,
            mis=mis,
            capacity=0,
            in_media=False,
        )
        camera = _LaterVertices(
            scene=self.scene,
            lens=self.lens,
            emitted=emitted,
            mis=mis,
            history=history,
            camera_unwarp=self.camera_unwarp,
            hide_emitters=self.hide_emitters,
        )
        path = Path.start(
            ray=emitted.ray,
            origin=emitted.origin,
            active=emitted.active & active,
            history=history.start(),
        )
        first = Parts(self.space, camera, self.delta_lobes, self.limits)
        later = Parts(self.space, camera, self.all_lobes, self.limits)
        path = step(sampler, path, first, measurement)
        return walk(sampler, path, later, measurement)


class _LaterVertices(LensEndpoint):
    """The lens, for all vertices of a photon but the first one."""

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a connection to a point on the lens."""
        return super().connect(vertex, path, sampler, active & (path.depth > 0))


class _LightByPhoton:
    """Measurement of each photon's light. It is no dataclass, so that loops do not carry it."""

    def __init__(self, photons: int) -> None:
        self.sums = dr.zeros(mi.Float, photons)
        self.cell = mi.UInt32(0)  # the cell of each photon

    def add(self, contribution: Contribution) -> None:
        """Add a contribution to its photon."""
        light = dr.max(intensity(contribution.spectrum))
        lane = dr.arange(mi.UInt32, dr.width(self.sums))
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, light, lane, contribution.active)
