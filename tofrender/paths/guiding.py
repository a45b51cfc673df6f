"""Path guiding: BSDF sampling mixed with directions in which photons have come.

A cell of a grid over the scene, by position and by the axis that its normal is closest to, has a
histogram of directions. A direction is sampled from it with the cell's probability α, else from the
BSDF; the density is that of the mixture, whatever the histogram holds:

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

GRID = 24  # Cells along each axis of the scene's box
HEIGHTS, AZIMUTHS = 12, 24  # Bins of a direction's z and azimuth, all of one solid angle
BINS = HEIGHTS * AZIMUTHS
SLOTS = 128  # Equally likely entries of a cell, each a number of a bin
LEAST, MOST = 0.02, 0.85  # Probabilities α: a cell below the least is not guided
FACES = 6  # Axes that a normal is closest to, with their signs


@dataclass
class DirectionTable:
    """Histograms of directions by cell, as NumPy arrays."""

    low: np.ndarray  # corner of the grid [m], shape (3,)
    size: np.ndarray  # edges of the grid [m], shape (3,)
    rows: np.ndarray  # row of each cell in the tables, 0 for cells that are not guided
    α: np.ndarray  # probability of guiding by row
    slots: np.ndarray  # numbers of bins by row, shape (rows, SLOTS)
    pdf: np.ndarray  # density by row and bin [1/sr], shape (rows, BINS)

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
        """Build the table from photons at `p` with normals `n`, that have come from `d`.

        Power counts in the eight cells around a photon, by its distance to their centres, and in
        the nine bins around its direction. α is the photons' part of a cell's irradiance
        [W/m²], where `irradiance` is that of all other light.
        """
        low, high = np.array(box.min, float), np.array(box.max, float)
        margin = 1e-4 * np.linalg.norm(high - low)
        low, size = low - margin, high - low + 2 * margin
        cells, weights = _cells_around((p - low) / size * GRID, n)
        cells, index = np.unique(cells.ravel(), return_inverse=True)
        index, weights = index.ravel(), (weights * power).ravel()

        # Probability of guiding
        edges = size / GRID
        areas = np.prod(edges) / edges[cells % FACES // 2]
        total = np.bincount(index, weights)
        α = np.minimum(total / (total + areas * irradiance), MOST)
        chosen = α > LEAST
        cells, α = cells[chosen], α[chosen]
        here = chosen[index]
        row = (chosen.cumsum() - 1)[index[here]]

        # Histograms of directions, smoothed over neighbours
        z = np.clip((0.5 * (d[:, 2] + 1) * HEIGHTS).astype(int), 0, HEIGHTS - 1)
        azimuth = np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) % 1
        bins = z * AZIMUTHS + np.minimum((azimuth * AZIMUTHS).astype(int), AZIMUTHS - 1)
        power = np.bincount(row * BINS + np.tile(bins, 8)[here], weights[here], len(cells) * BINS)
        power = power.reshape(-1, HEIGHTS, AZIMUTHS)
        ends = np.pad(power, ((0, 0), (1, 1), (0, 0)), mode="edge")
        power = 0.6 * power + 0.2 * (ends[:, 2:] + ends[:, :-2])
        power = 0.6 * power + 0.2 * (np.roll(power, 1, axis=2) + np.roll(power, -1, axis=2))

        # Entries at equal distances of the cumulative distribution
        sums = power.reshape(-1, BINS).cumsum(axis=1)
        sums /= sums[:, -1:]
        row = np.arange(len(cells))[:, None]
        entries = row + (np.arange(SLOTS) + 0.5) / SLOTS
        slots = np.searchsorted((sums + row).ravel(), entries.ravel()) - (row * BINS).repeat(SLOTS)
        slots = np.clip(slots, 0, BINS - 1).reshape(-1, SLOTS)
        counts = np.bincount((slots + row * BINS).ravel(), minlength=len(cells) * BINS)
        rows = np.zeros(GRID**3 * FACES, np.uint32)
        rows[cells] = 1 + np.arange(len(cells))
        pdf = counts.reshape(-1, BINS) * (BINS / (4 * np.pi * SLOTS))
        return cls(low, size, rows, α, slots, pdf)


def _cells_around(x: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eight cells around points in units of cells, and weights; both (8, points)."""
    axis = np.abs(n).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(n, axis[:, None], 1)[:, 0] > 0)
    first = np.floor(x - 0.5).astype(int)
    fraction = x - 0.5 - first
    cells, weights = [], []
    for corner in np.ndindex(2, 2, 2):
        i, j, k = np.clip(first + corner, 0, GRID - 1).T
        cells.append(((i * GRID + j) * GRID + k) * FACES + face)
        weights.append(np.where(corner, fraction, 1 - fraction).prod(axis=1))
    return np.array(cells), np.array(weights)


class GuidedMaterials(ScatteringWrapper):
    """Samples BSDFs without delta lobes by the mixture with a table's directions.

    Others are left alone: their delta lobes, chosen by 1 - α of the samples, would be noisy.
    """

    def __init__(self, materials: Materials, table: DirectionTable) -> None:
        super().__init__(materials)
        self.materials = materials
        self.low, self.scale = mi.Point3f(table.low), mi.Vector3f(GRID / table.size)
        self.rows, self.α = mi.UInt32(table.rows), mi.Float(np.append(0, table.α))
        self.slots = mi.UInt32(table.slots.ravel().astype(np.uint32))
        self.pdfs = mi.Float(table.pdf.ravel())
        dr.make_opaque(self.low, self.scale)
        dr.eval(self.rows, self.α, self.slots, self.pdfs)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF, with the density of the mixture."""
        bsdf_eval = self.inner.eval_pdf(vertex, direction, active)
        pdf = self._mixture(self._row(vertex), direction, bsdf_eval.pdf)
        return replace(bsdf_eval, pdf=pdf)

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample the mixture, and evaluate a connection if there is one."""
        bsdf_eval, sample = self.inner.sample(vertex, connection, sampler, active)
        row = self._row(vertex)
        if bsdf_eval is not None and connection is not None:
            pdf = self._mixture(row, connection.direction, bsdf_eval.pdf)
            bsdf_eval = replace(bsdf_eval, pdf=pdf)

        # Choose the table's direction or the BSDF's, and divide by the density of both
        by_table = active & (sampler.next_1d() < dr.gather(mi.Float, self.α, row))
        ω = self._direction(row, sampler.next_1d(), sampler.next_2d(), by_table)
        other = self.inner.eval_pdf(vertex, ω, by_table)
        ω, pdf = dr.select(by_table, ω, sample.ray.d), dr.select(by_table, other.pdf, sample.pdf)
        mixed = self._mixture(row, ω, pdf)
        ratio = dr.select(by_table, 1, pdf) * dr.select(mixed > 0, dr.rcp(mixed), 0)
        weight = dr.select(by_table, other.f, sample.weight)
        return bsdf_eval, replace(
            sample,
            ray=dr.select(by_table, spawn_ray(vertex.si, ω, mi.Bool(False)), sample.ray),
            weight=weight * dr.select(row > 0, ratio, 1),
            pdf=mixed,
            η=dr.select(by_table, other.η, sample.η),
        )

    def _row(self, vertex: Vertex) -> mi.UInt32:
        """Return the row of a vertex's cell, 0 where directions are not guided."""
        si, flags = vertex.si, self.materials.bsdf(vertex).flags()
        lobes = mi.has_flag(flags, mi.BSDFFlags.Smooth) & ~mi.has_flag(flags, mi.BSDFFlags.Delta)
        x = dr.clip(mi.Point3i((si.p - self.low) * self.scale), 0, GRID - 1)
        a = dr.abs(si.n)
        longest = dr.maximum(dr.maximum(a.x, a.y), a.z)
        axis = dr.select(a.x == longest, mi.UInt32(0), dr.select(a.y == longest, mi.UInt32(1), 2))
        side = dr.select(axis == 0, si.n.x, dr.select(axis == 1, si.n.y, si.n.z))
        cell = mi.UInt32((x.x * GRID + x.y) * GRID + x.z)
        cell = cell * FACES + 2 * axis + dr.select(side > 0, mi.UInt32(1), 0)
        return dr.gather(mi.UInt32, self.rows, cell, vertex.valid & lobes)

    def _direction(self, row, u: mi.Float, v: mi.Point2f, active: mi.Bool) -> mi.Vector3f:
        """Sample a direction of a row's histogram."""
        slot = dr.minimum(mi.UInt32(u * SLOTS), SLOTS - 1)
        k = dr.gather(mi.UInt32, self.slots, (row - 1) * SLOTS + slot, active)
        z = dr.fma(2 / HEIGHTS, mi.Float(k // AZIMUTHS) + v.x, -1)
        sine, cosine = dr.sincos((mi.Float(k % AZIMUTHS) + v.y) * (2 * dr.pi / AZIMUTHS))
        r = dr.safe_sqrt(1 - z * z)
        return mi.Vector3f(r * cosine, r * sine, z)

    def _mixture(self, row: mi.UInt32, ω: mi.Vector3f, pdf: mi.Float) -> mi.Float:
        """Return the density of the mixture, given that of the BSDF [1/sr]."""
        z = dr.clip(mi.Int32((ω.z + 1) * (HEIGHTS / 2)), 0, HEIGHTS - 1)
        turns = dr.atan2(ω.y, ω.x) * dr.inv_two_pi
        turns = dr.select(turns < 0, turns + 1, turns)
        azimuth = dr.minimum(mi.Int32(turns * AZIMUTHS), AZIMUTHS - 1)
        at = (row - 1) * BINS + mi.UInt32(z * AZIMUTHS + azimuth)
        guided = dr.gather(mi.Float, self.pdfs, at, row > 0)
        return dr.select(row > 0, dr.lerp(pdf, guided, dr.gather(mi.Float, self.α, row)), pdf)
