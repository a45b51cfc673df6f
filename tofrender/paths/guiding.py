"""Path guiding: BSDF sampling mixed with directions of photons.

A grid divides the scene into cells. Each cell also has one of six faces: the axis and sign that the
normal of a surface is closest to. Each cell stores a histogram of the directions where photons came
from. With the probability α of the cell, a direction is sampled from its histogram, otherwise from
the BSDF. The density is the density of this mixture, so that the histogram causes no bias:

    p(ω) = α p_cell(ω) + (1 - α) p_BSDF(ω)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .protocols import ScatteringWrapper
from .records import BSDFEval, BSDFSample, Connection, Vertex
from .scattering import Materials
from .surfaces import spawn_ray

# Number of cells along each axis of the scene's bounding box
GRID = 24

# Number of faces of a cell: axes that a normal is closest to, with their signs
FACES = 6

# Number of histogram bins for z and for the azimuth of a direction. All bins have the same solid
# angle
HEIGHTS = 12
AZIMUTHS = 24
BINS = HEIGHTS * AZIMUTHS

# Number of equally likely entries of a cell. Each entry is the index of a bin
SLOTS = 128

# Range of the probability α. Cells below the range are not guided
MIN_ALPHA = 0.02
MAX_ALPHA = 0.85


@dataclass
class DirectionTable:
    """Histograms of directions, one per guided cell, as NumPy arrays."""

    low: np.ndarray  # Corner of the grid [m], shape (3,)
    size: np.ndarray  # Lengths of the grid's edges [m], shape (3,)
    rows: np.ndarray  # 1 + row of each cell in the other tables, 0 for cells without guiding
    α: np.ndarray  # Probability of guiding, by row
    slots: np.ndarray  # Indices of bins by row, shape (rows, SLOTS)
    counts: np.ndarray  # Number of entries by row and bin, shape (rows, BINS)

    @property
    def pdf(self) -> np.ndarray:
        """Density by row and bin [1/sr]: the fraction of a bin's entries over its solid angle."""
        return self.counts * (BINS / (4 * np.pi * SLOTS))

    @classmethod
    def of_photons(
        cls,
        box: mi.ScalarBoundingBox3f,
        p: np.ndarray,
        n: np.ndarray,
        d: np.ndarray,
        power: np.ndarray,
        irradiance: float,
    ) -> DirectionTable:
        """Build the table from photons.

        The power of a photon is distributed over the eight cells around its position, by the
        distances to their centers, and over the nine bins around its direction. α is the part of
        the photons in the irradiance of a cell.

        Args:
            box: Bounding box of the scene.
            p: Positions of the photons [m], shape (photons, 3).
            n: Normals of the surfaces, shape (photons, 3).
            d: Unit vectors to where the photons came from, shape (photons, 3).
            power: Power of each photon [W].
            irradiance: Irradiance by all other light [W/m²].
        """
        # ----------------------------- Find the cells of photons -----------------------------

        low = np.array(box.min, float)
        high = np.array(box.max, float)
        margin = 1e-4 * np.linalg.norm(high - low)
        size = high - low + 2 * margin
        low = low - margin
        cells, weights = _cells_around((p - low) / size * GRID, n)
        cells, index = np.unique(cells.ravel(), return_inverse=True)
        index = index.ravel()
        weights = (weights * power).ravel()

        # ------------------- Probability of guiding, by the irradiance -------------------

        edges = size / GRID
        areas = np.prod(edges) / edges[cells % FACES // 2]
        total = np.bincount(index, weights)
        α = np.minimum(total / (total + areas * irradiance), MAX_ALPHA)

        # Keep the cells with enough photons
        chosen = α > MIN_ALPHA
        cells = cells[chosen]
        α = α[chosen]
        here = chosen[index]
        row = (chosen.cumsum() - 1)[index[here]]

        # ------------------------- Histograms of directions -------------------------

        # Add the power of photons to the bins of their directions
        z = np.clip((0.5 * (d[:, 2] + 1) * HEIGHTS).astype(int), 0, HEIGHTS - 1)
        azimuth = np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) % 1
        bins = z * AZIMUTHS + np.minimum((azimuth * AZIMUTHS).astype(int), AZIMUTHS - 1)
        power = np.bincount(row * BINS + np.tile(bins, 8)[here], weights[here], len(cells) * BINS)

        # Smooth the histograms over neighboring bins
        power = power.reshape(-1, HEIGHTS, AZIMUTHS)
        ends = np.pad(power, ((0, 0), (1, 1), (0, 0)), mode="edge")
        power = 0.6 * power + 0.2 * (ends[:, 2:] + ends[:, :-2])
        power = 0.6 * power + 0.2 * (np.roll(power, 1, axis=2) + np.roll(power, -1, axis=2))

        # ------------------- Tables for sampling, with one row per cell -------------------

        # Invert the cumulative distribution at equal distances
        sums = power.reshape(-1, BINS).cumsum(axis=1)
        sums /= sums[:, -1:]
        row = np.arange(len(cells))[:, None]
        entries = row + (np.arange(SLOTS) + 0.5) / SLOTS
        slots = np.searchsorted((sums + row).ravel(), entries.ravel()) - (row * BINS).repeat(SLOTS)
        slots = np.clip(slots, 0, BINS - 1).reshape(-1, SLOTS)

        # Count the entries of each bin
        counts = np.bincount((slots + row * BINS).ravel(), minlength=len(cells) * BINS)

        # Rows of all cells of the grid
        rows = np.zeros(GRID**3 * FACES, np.uint32)
        rows[cells] = 1 + np.arange(len(cells))
        return cls(
            low=low,
            size=size,
            rows=rows,
            α=α,
            slots=slots.astype(np.uint16),
            counts=counts.reshape(-1, BINS).astype(np.uint8),
        )


def _cells_around(x: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the eight cells around points, and their weights.

    Both results have the shape (8, points). The weights of a point are trilinear, with the sum 1.

    Args:
        x: Points in units of cells, shape (points, 3).
        n: Normals, shape (points, 3).
    """
    # Face of each normal: twice the axis, plus 1 if the normal is along the axis
    axis = np.abs(n).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(n, axis[:, None], 1)[:, 0] > 0)

    # Cells with the closest centers
    first = np.floor(x - 0.5).astype(int)
    fraction = x - 0.5 - first
    cells = []
    weights = []
    for corner in np.ndindex(2, 2, 2):
        i, j, k = np.clip(first + corner, 0, GRID - 1).T
        cells.append(((i * GRID + j) * GRID + k) * FACES + face)
        weights.append(np.where(corner, fraction, 1 - fraction).prod(axis=1))
    return np.array(cells), np.array(weights)


class GuidedMaterials(ScatteringWrapper):
    """Scattering that mixes BSDF samples with the directions of a table.

    BSDFs with delta lobes are not guided. Otherwise only a fraction 1 - α of the samples could
    choose the delta lobes, and their light would be noisy.

    Args:
        materials: Scattering without guiding.
        table: Histograms of directions.
    """

    def __init__(self, materials: Materials, table: DirectionTable) -> None:
        super().__init__(materials)
        self.materials = materials

        # Grid: corner [m], and cells per meter
        self.low = mi.Point3f(table.low)
        self.scale = mi.Vector3f(GRID / table.size)

        # Tables. Row 0 of `α` belongs to cells without guiding
        self.rows = mi.UInt32(table.rows)
        self.α = mi.Float(np.append(0, table.α))
        self.slots = mi.UInt32(table.slots.ravel().astype(np.uint32))
        self.pdfs = mi.Float(table.pdf.ravel())

        # Kernels do not depend on the values
        dr.make_opaque(self.low, self.scale)
        dr.eval(self.rows, self.α, self.slots, self.pdfs)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF for a direction. The density is the density of the mixture."""
        bsdf_eval = self.inner.eval_pdf(vertex, direction, active)
        pdf = self._mixture(self._row(vertex), direction, bsdf_eval.pdf)
        return replace(bsdf_eval, pdf=pdf)

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample the mixture, and evaluate the BSDF for the direction of a connection.

        Returns the evaluation for the connection, None without a connection, and the sample.
        """
        # Sample the BSDF, and evaluate the connection
        bsdf_eval, sample = self.inner.sample(vertex, connection, sampler, active)
        row = self._row(vertex)
        if bsdf_eval is not None and connection is not None:
            pdf = self._mixture(row, connection.direction, bsdf_eval.pdf)
            bsdf_eval = replace(bsdf_eval, pdf=pdf)

        # Choose between a direction of the table and the BSDF sample
        by_table = active & (sampler.next_1d() < dr.gather(mi.Float, self.α, row))
        ω = self._direction(row, sampler.next_1d(), sampler.next_2d(), by_table)
        other = self.inner.eval_pdf(vertex, ω, by_table)
        ω = dr.select(by_table, ω, sample.ray.d)
        pdf = dr.select(by_table, other.pdf, sample.pdf)

        # Divide by the density of the mixture. The weight of a BSDF sample contains 1 / pdf
        mixed = self._mixture(row, ω, pdf)
        ratio = dr.select(by_table, 1, pdf) * dr.select(mixed > 0, dr.rcp(mixed), 0)
        weight = dr.select(by_table, other.f, sample.weight)
        mixed_sample = replace(
            sample,
            ray=dr.select(by_table, spawn_ray(vertex.si, ω, mi.Bool(False)), sample.ray),
            weight=weight * dr.select(row > 0, ratio, 1),
            pdf=mixed,
            η=dr.select(by_table, other.η, sample.η),
        )
        return bsdf_eval, mixed_sample

    def _row(self, vertex: Vertex) -> mi.UInt32:
        """Return 1 + the row of a vertex's cell, 0 without guiding.

        Vertices with delta lobes, and vertices in cells without photons, are not guided.
        """
        # Does the BSDF have smooth lobes only?
        si = vertex.si
        flags = self.materials.bsdf(vertex).flags()
        lobes = mi.has_flag(flags, mi.BSDFFlags.Smooth) & ~mi.has_flag(flags, mi.BSDFFlags.Delta)

        # Position in the grid, and face of the normal
        x = dr.clip(mi.Point3i((si.p - self.low) * self.scale), 0, GRID - 1)
        a = dr.abs(si.n)
        longest = dr.maximum(dr.maximum(a.x, a.y), a.z)
        axis = dr.select(a.x == longest, mi.UInt32(0), dr.select(a.y == longest, mi.UInt32(1), 2))
        side = dr.select(axis == 0, si.n.x, dr.select(axis == 1, si.n.y, si.n.z))

        # Look up the cell
        cell = mi.UInt32((x.x * GRID + x.y) * GRID + x.z)
        cell = cell * FACES + 2 * axis + dr.select(side > 0, mi.UInt32(1), 0)
        return dr.gather(mi.UInt32, self.rows, cell, vertex.valid & lobes)

    def _direction(self, row, u: mi.Float, v: mi.Point2f, active: mi.Bool) -> mi.Vector3f:
        """Sample a direction from the histogram of a row.

        Args:
            row: Result of `_row`.
            u: Uniform random number that chooses the bin.
            v: Uniform random numbers that choose the direction within the bin.
            active: Active lanes.
        """
        # Choose a bin
        slot = dr.minimum(mi.UInt32(u * SLOTS), SLOTS - 1)
        k = dr.gather(mi.UInt32, self.slots, (row - 1) * SLOTS + slot, active)

        # Sample a uniform direction within this bin
        z = dr.fma(2 / HEIGHTS, mi.Float(k // AZIMUTHS) + v.x, -1)
        sine, cosine = dr.sincos((mi.Float(k % AZIMUTHS) + v.y) * (2 * dr.pi / AZIMUTHS))
        r = dr.safe_sqrt(1 - z * z)
        return mi.Vector3f(r * cosine, r * sine, z)

    def _mixture(self, row: mi.UInt32, ω: mi.Vector3f, pdf: mi.Float) -> mi.Float:
        """Return the density of the mixture [1/sr].

        Args:
            row: Result of `_row`.
            ω: Unit vector in world space.
            pdf: Density of the BSDF for this direction [1/sr].
        """
        # Find the bin of the direction
        z = dr.clip(mi.Int32((ω.z + 1) * (HEIGHTS / 2)), 0, HEIGHTS - 1)
        turns = dr.atan2(ω.y, ω.x) * dr.inv_two_pi
        turns = dr.select(turns < 0, turns + 1, turns)
        azimuth = dr.minimum(mi.Int32(turns * AZIMUTHS), AZIMUTHS - 1)
        at = (row - 1) * BINS + mi.UInt32(z * AZIMUTHS + azimuth)

        # Mix both densities
        guided = dr.gather(mi.Float, self.pdfs, at, row > 0)
        return dr.select(row > 0, dr.lerp(pdf, guided, dr.gather(mi.Float, self.α, row)), pdf)
