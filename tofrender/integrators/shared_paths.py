"""Indirect light from paths that neighboring pixels share (P. Bekaert et al. 2002).

A tile is a square of pixels. In each sample, each pixel i of a tile traces a path from the camera
to a first vertex x1_i and a second vertex x2_i. The rest of the path, its suffix, finds the light
S_i that x2_i reflects. All pixels of the tile use this light. Pixel j adds

    sum over i of  f_j(x2_i) V(x1_j, x2_i) S_i / D_i,  with
    D_i = sum over k of  p_k(x2_i) V(x1_k, x2_i).

f_j is the throughput of pixel j per area around x2_i, p_k is the density per area with which pixel
k samples x2_i, and V is the visibility. This is the balance heuristic over the pixels of the tile.
It is unbiased, because the density D_i contains the visibility that limits the pixels j.

All surfaces must be Lambertian, because f_j, p_k and S_i are then known for all pixels. If a pixel
does not see its own second vertex in the test of V, its path is not shared, and has the weight 1 in
its own pixel. This happens at grazing angles, by rounding errors.

Paths of at most two segments are not shared. The main paths render this direct light, with more
emitter samples (`SceneLights.for_direct_light`).

Source: P. Bekaert, M. Sbert, J. Halton, "Accelerating Path Tracing by Re-Using Paths", EGWR 2002.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import drjit as dr
import mitsuba as mi

from ..films.contribution import CameraSample, Contribution
from ..films.recording import BinRecording, Recording
from ..paths.camera import Tile, sample_camera, sampled_size
from ..paths.endpoints import SceneLights
from ..paths.path_kinds import Kind
from ..paths.records import Path
from ..paths.scattering import Materials
from ..paths.sensor_window import KINDS
from ..paths.space import Vacuum
from ..paths.surfaces import bsdfs_in, materials
from ..paths.walk import walk
from ..runtime import gpu
from ..runtime.lane_memory import packed, tape
from .plan import Plan
from .user_defined import Tracer

SIDE = 4  # Width and height of a tile [pixels]

# Number of samples of a pixel for one sample of a tile. The light of a tile's paths is less noisy
# than direct light at equal time
EVERY = 4

DIRECT = 2  # Largest number of segments of direct light, which is not shared

# Names of the classes of Lambertian BSDFs, and of BSDFs that only contain other BSDFs
LAMBERTIAN = frozenset({"SmoothDiffuse", "TwoSidedBRDF"})


@dataclass
class Prefix:
    """Path of a pixel up to its first vertex x1, and the ray to its second vertex x2."""

    # First vertex [m]
    p: mi.Point3f

    # Point slightly off the surface where rays to the side of the camera start [m]. The density of
    # x2 depends on this point
    start: mi.Point3f

    # Shading normal, on the side of the camera
    n: mi.Normal3f

    # Weight of the BSDF sample times the weight of the camera ray. For a Lambertian surface, this
    # is the throughput over the density of x2
    color: mi.Spectrum

    # Optical path length up to x1 [m]
    opl: mi.Float

    # Ray to x2: origin [m] and direction
    origin: mi.Point3f
    direction: mi.Vector3f

    # Whether the path continues, as an integer 0 or 1
    active: mi.UInt32


@dataclass
class Link:
    """Connection of a pixel to the second vertex x2 of a path of its tile."""

    # Weight of the suffix in the pixel. Before the density D is known, the pixel's term of D
    weight: mi.Spectrum

    # Optical path length from the camera to x2 [m]
    opl: mi.Float


class LinkedPixels:
    """Pixels of a tile that receive the light of one suffix.

    This class is not a dataclass, so that the path loop does not carry its fields as state.

    Args:
        record: Recording on the film.
        every: Number of samples of a pixel for one sample of the tile.
        corner: Position of the tile's first pixel on the film [pixels].
        side: Width of the tile [pixels].
        links: Links of all pixels, in lane memory.
        opl: Optical path length up to x2 in the path that has found the suffix [m].
    """

    def __init__(
        self,
        record: Recording,
        every: int,
        corner: mi.Point2f,
        side: int,
        links: dr.Local,
        opl: mi.Float,
    ) -> None:
        self.record = record
        self.every = every
        self.corner = corner
        self.side = side
        self.links = links
        self.opl = opl

    @dr.syntax
    def add(self, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
        """Add light that arrives with an optical path length [m] in the path of the suffix."""
        rest = opl - self.opl
        k = dr.zeros(mi.UInt32, dr.width(opl))
        while active & (k < self.side * self.side):
            self._add_to(k, spectrum, rest)
            k += 1

    def _add_to(self, k: mi.UInt32, spectrum: mi.Spectrum, rest: mi.Float) -> None:
        """Add light to pixel `k` of the tile. `rest` is the path length from x2 to the emitter."""
        link = self.links[k]
        position = self.corner + mi.Point2f(k % self.side, k // self.side)
        camera = CameraSample(
            ray=dr.zeros(mi.Ray3f, dr.width(rest)),
            origin=dr.zeros(mi.Point3f),
            weight=mi.UnpolarizedSpectrum(self.every),
            position=position,
        )
        measurement = self.record.measurement(camera, one_writer=True)
        light = spectrum * link.weight
        measurement.add(Contribution(light, link.opl + rest, dr.any(link.weight > 0)))


@dataclass
class SuffixLight:
    """Measurement of the light of a suffix, for all pixels of a tile."""

    # Sum of the light
    total: mi.Spectrum

    # The pixels
    pixels: LinkedPixels

    def add(self, contribution: Contribution) -> None:
        """Add a contribution to the sum, and to the time bins of all linked pixels."""
        self.total += dr.select(contribution.active, contribution.spectrum, 0)
        self.pixels.add(contribution.spectrum, contribution.opl, contribution.active)


class SharedPaths:
    """Paths of three or more segments, which the pixels of tiles share.

    Args:
        plan: The plan of the render. The attribute `remaining_plan` is the plan of direct light.
        sensor: The sensor of the render.
        record: Recording on the film.
        side: Width and height of a tile [pixels].
        every: Number of samples of a pixel for one sample of a tile.
    """

    def __init__(
        self,
        plan: Plan,
        sensor: mi.Sensor,
        record: Recording,
        side: int = SIDE,
        every: int = EVERY,
    ) -> None:
        parts = plan.by_depth(DIRECT)
        assert parts is not None
        direct, self.plan = parts
        self.remaining_plan = direct.with_endpoint(direct.endpoint.for_direct_light())
        self.scene = plan.scene
        self.sensor = sensor
        self.record = record
        self.side = side
        self.every = every

    @classmethod
    def of(
        cls, plan: Tracer, sensor: mi.Sensor, record: Recording, tile: Tile | None = None
    ) -> Self | None:
        """Create the paths for a film, None if they are not supported or not faster.

        Args:
            plan: The plan of the render, without the kinds of paths that other techniques render.
            sensor: The sensor of the render.
            record: Recording on the film.
            tile: Position of the film in a larger film, None for a whole film. A tile of a film is
                not supported, because its pixels would not equal the pixels of the whole film.
        """
        if not isinstance(plan, Plan) or not plan.techniques.shared_paths:
            return None

        # Is the film a film with time bins, with a single writer for each pixel?
        film = record.film
        private = film.rfilter().is_box_filter() and not gpu.is_gpu(mi.variant())
        if type(record) is not BinRecording or not private or tile is not None:
            return None

        # Is the light unpolarized, and without wavelengths? Is the camera at rest?
        if mi.is_polarized or mi.is_spectral or plan.motion is not None:
            return None
        if sensor.class_name() not in KINDS or sensor.shutter_open_time() > 0:
            return None

        # Is this a plan of ordinary paths in a scene without media?
        ordinary = (
            type(plan.endpoint) is SceneLights
            and type(plan.scattering) is Materials
            and type(plan.space) is Vacuum
            and plan.caustic_rays is None
            and plan.limits.left_out <= {Kind.VISIBLE}
        )
        if not ordinary or not only_lambertian(plan.scene):
            return None

        # Is there indirect light, and may no path end before its third vertex?
        limits = plan.limits
        whole = limits.min_depth == 0 and limits.max_opl is None and not limits.ignore_null
        if not whole or limits.rr_depth < 2 or plan.by_depth(DIRECT) is None:
            return None
        return cls(plan, sensor, record)

    def tiles(self) -> tuple[int, int]:
        """Return the number of tiles across and down, which cover the film with any shift."""
        width, height = sampled_size(self.record.film)
        return -(-width // self.side) + 1, -(-height // self.side) + 1

    @dr.syntax
    def sample(
        self,
        sampler: mi.Sampler,
        tile: mi.UInt32,
        shift: mi.Point2u,
        count: int,
        every: int,
    ) -> tuple[dr.Local, mi.Point2i, mi.UInt32]:
        """Compute `count` samples of tiles, and add their light to the time bins.

        Args:
            sampler: The sampler.
            tile: Index of the tile of each lane.
            shift: Pixels by which all tiles are moved to the left and up, below `side`.
            count: Number of samples of each lane.
            every: Number of samples of a pixel for one sample of a tile.

        Returns:
            The sums of the light of the tile's pixels in lane memory, the first pixel of each tile,
            and the number of contributions that are not finite.
        """
        # Find the first pixel of each tile
        across = dr.opaque(mi.UInt32, self.tiles()[0])
        row = tile // across
        first = mi.Point2i(mi.Int32(tile - row * across), mi.Int32(row)) * self.side
        first -= mi.Point2i(shift)

        # Allocate memory for the pixels of a tile
        lanes = dr.width(tile)
        pixels = self.side * self.side
        prefixes = tape(self._no_prefix(), pixels)
        links = tape(Link(weight=mi.Spectrum(0), opl=mi.Float(0)), pixels)
        sums = dr.alloc_local(mi.Spectrum, pixels, value=mi.Spectrum(0))

        # Compute the samples
        not_finite = dr.zeros(mi.UInt32, lanes)
        left = dr.opaque(mi.UInt32, count) + dr.zeros(mi.UInt32, lanes)
        while left > 0:
            # Trace the first rays of all pixels
            k = dr.zeros(mi.UInt32, lanes)
            while k < pixels:
                prefixes[k] = packed(self._prefix(sampler, first, k))
                k += 1

            # Trace the suffix of each pixel
            i = dr.zeros(mi.UInt32, lanes)
            while i < pixels:
                # Find the second vertex
                prefix = prefixes[i]
                active = prefix.active != 0
                ray = mi.Ray3f(prefix.origin, prefix.direction)
                si = self.scene.ray_intersect(ray, active)
                active &= si.is_valid()

                # Link it to all pixels that see it, and compute their density
                density = dr.zeros(mi.Float, lanes)
                k = dr.zeros(mi.UInt32, lanes)
                while k < pixels:
                    link, part = self._link(prefixes[k], si, ray.d, active)
                    density += part
                    links[k] = packed(link)
                    k += 1

                # A suffix is not shared if its own pixel does not see the second vertex
                alone = ~(links[i].weight.x > 0)
                gray = dr.max(prefix.color)
                k = dr.zeros(mi.UInt32, lanes)
                while k < pixels:
                    link = links[k]
                    of_tile = link.weight / density
                    weight = dr.select(alone, dr.select(k == i, mi.Spectrum(1), 0), of_tile)
                    link.weight = dr.select(active, weight * prefixes[k].color / gray, 0)
                    links[k] = link
                    k += 1

                # Trace the suffix
                corner = mi.Point2f(first) + mi.Vector2f(self.record.film.crop_offset())
                own_opl = links[i].opl
                linked = LinkedPixels(self.record, every, corner, self.side, links, own_opl)
                light = SuffixLight(dr.zeros(mi.Spectrum, lanes), linked)
                path = self._suffix(prefix, ray, gray)
                light, path = walk(sampler, path, self.plan, light)
                not_finite += path.not_finite

                # Add the light to the sums of the pixels
                total = light.total
                k = dr.zeros(mi.UInt32, lanes)
                while k < pixels:
                    sums[k] = sums[k] + links[k].weight * total
                    k += 1
                i += 1
            sampler.advance()
            left -= 1
        return sums, first, not_finite

    def _no_prefix(self) -> Prefix:
        """Return an example of a prefix, for its types."""
        zero = mi.Float(0)
        return Prefix(
            p=mi.Point3f(0),
            start=mi.Point3f(0),
            n=mi.Normal3f(0),
            color=mi.Spectrum(0),
            opl=zero,
            origin=mi.Point3f(0),
            direction=mi.Vector3f(0),
            active=mi.UInt32(0),
        )

    def _prefix(self, sampler: mi.Sampler, first: mi.Point2i, k: mi.UInt32) -> Prefix:
        """Trace the first ray of pixel `k` of each tile.

        Args:
            sampler: The sampler.
            first: First pixel of the tile.
            k: Index of the pixel in the tile.
        """
        # Find the pixel. The tiles at the border have pixels outside of the film
        plan = self.plan
        film = self.record.film
        width, height = sampled_size(film)
        x = first.x + mi.Int32(k % self.side)
        y = first.y + mi.Int32(k // self.side)
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        pixel = mi.UInt32(dr.select(inside, y * width + x, 0))

        # Trace the camera ray to the first vertex, and sample the next ray
        camera = sample_camera(self.sensor, film, sampler, pixel, scene=self.scene)
        path = plan.start(plan.endpoint, camera.ray, camera.origin, inside, camera.frame)
        path, vertex = plan.space.next_vertex(path, sampler)
        valid = path.active & vertex.valid
        _, bsdf_sample = plan.scattering.sample(vertex, None, sampler, valid)
        color = bsdf_sample.weight * camera.weight
        valid &= dr.any(color != 0) & dr.all(dr.isfinite(color))

        # Store the vertex
        si = vertex.si
        n = si.sh_frame.n * dr.select(si.wi.z > 0, mi.Float(1), -1)
        length = mi.Float(0) if plan.limits.camera_unwarp else vertex.length
        return Prefix(
            p=si.p,
            start=si.spawn_ray(n).o,
            n=n,
            color=color,
            opl=path.η * length,
            origin=bsdf_sample.ray.o,
            direction=bsdf_sample.ray.d,
            active=dr.select(valid, mi.UInt32(1), 0),
        )

    def _link(
        self,
        prefix: Prefix,
        si: mi.SurfaceInteraction3f,
        direction: mi.Vector3f,
        active: mi.Bool,
    ) -> tuple[Link, mi.Float]:
        """Return a link, and the density with which a pixel samples a second vertex.

        The density is 0 if the pixel does not see the vertex. The density is per area and
        multiplied by pi, which cancels. The weight of the link equals the density.

        Args:
            prefix: First vertex of the pixel.
            si: The second vertex.
            direction: Direction in which a path has found the second vertex.
            active: Lanes with a second vertex.
        """
        # Is the first vertex on the side of the second vertex that the suffix is for?
        offset = prefix.start - si.p
        distance = dr.norm(offset)
        to_first = offset / distance
        same_side = dr.dot(si.sh_frame.n, to_first) * dr.dot(si.sh_frame.n, direction) < 0
        cos_first = -dr.dot(prefix.n, to_first)
        facing = active & (prefix.active != 0) & same_side & (cos_first > 0)

        # Is it visible?
        visible = facing & ~self.scene.ray_test(si.spawn_ray_to(prefix.start), facing)

        # Cosine-weighted density per area
        cos_second = dr.abs(dr.dot(si.n, to_first))
        density = cos_first * cos_second / dr.square(distance)
        seen = dr.select(visible, density, 0)
        length = dr.norm(prefix.p - si.p)
        opl = dr.fma(self.plan.space.index, length, prefix.opl)
        return Link(weight=mi.Spectrum(seen), opl=opl), seen

    def _suffix(self, prefix: Prefix, ray: mi.Ray3f, gray: mi.Float) -> Path:
        """Return the path of a pixel at its first vertex.

        Its throughput is the largest channel of the prefix, which decides Russian roulette.
        """
        path = Path.start(
            ray=ray,
            origin=prefix.p,
            active=prefix.active != 0,
            η=self.plan.space.index,
        )
        path.depth = path.depth + 1
        path.β = path.β * gray
        path.opl = mi.Float(prefix.opl)
        path.specular = mi.Bool(False)

        # The path has met a surface, so that emitters that it hits are not `Kind.VISIBLE`
        path.valid_ray = mi.Bool(True)
        return path


def only_lambertian(scene: mi.Scene) -> bool:
    """Return whether all surfaces of a scene only reflect diffusely, by Lambert's law."""
    bsdfs = [each for bsdf in dict.fromkeys(materials(scene)) for each in bsdfs_in(bsdf)]
    return all(bsdf.class_name() in LAMBERTIAN for bsdf in bsdfs)
