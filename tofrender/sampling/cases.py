"""Chi-square test cases of warps, BSDFs and lights."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..runtime import checks
from .chi_square import Case
from .table import WARPS
from .triangles_and_caps import point


def warp_case(name: str, **parameter: Any) -> Case:
    """Return the test case of a warp, by its name in `WARPS` and its parameter if it has one.

    Example:
        >>> warp_case("beckmann", alpha=0.3).name
        'beckmann (alpha = 0.3)'
    """
    warp = WARPS[checks.one_of("name", name, WARPS)]
    wanted = [warp.parameter] if warp.parameter else []
    if list(parameter) != wanted:
        needs = f"the parameter {warp.parameter}" if warp.parameter else "no parameter"
        given = list(parameter) or "none"
        raise ValueError(f"name = {name!r}: this warp requires {needs}, but {given} was passed")
    sample, pdf = warp.make(*parameter.values())
    numbers = [f"{k} = {v:g}" for k, v in parameter.items() if isinstance(v, int | float)]
    return Case(sample, pdf, warp.domain, f"{name} ({numbers[0]})" if numbers else name)


def bsdf_case(bsdf: dict | mi.BSDF, wi: Any, *, uv: Any = (0.5, 0.5), name: str = "") -> Case:
    """Return the test case of a BSDF's sampling: directions against `pdf` and returned densities.

    Samples of mirrors and other Dirac lobes do not have a density. They count as failed samples,
    and so do samples without weight. Not all BSDFs of Mitsuba pass: at 75 degrees, the `pdf` of
    `roughplastic` with alpha = 0.1 integrates to 1.008, although only 0.995 of the samples are
    valid.

    Args:
        bsdf: A Mitsuba BSDF, or its dictionary.
        wi: Direction towards the viewer, (x, y, z) in the surface's frame. Its length is ignored.
        uv: Texture coordinates of the surface point.
        name: Name in the verdict; by default the BSDF's type and the angle of `wi`.

    Raises:
        ValueError: The BSDF has only Dirac lobes, or an argument is invalid.

    Example:
        >>> bsdf_case({"type": "diffuse"}, (0, 0, 1)).test(samples=20_000).passed
        True
    """
    # Normalize the direction
    x, y, z = point("wi", wi).tolist()
    length = math.hypot(x, y, z)
    checks.require("wi", wi, length > 0, "a direction, not zero")
    wi = x / length, y / length, z / length

    # Check the other arguments
    try:
        u, v = (checks.number("uv", each) for each in uv)
    except (TypeError, ValueError):
        raise ValueError(f"uv = {checks.quote(uv)}: must be two finite numbers") from None
    checks.instance("name", name, str, "text")
    plugin: Any = _loaded("bsdf", bsdf) if isinstance(bsdf, dict) else bsdf
    checks.instance("bsdf", plugin, mi.BSDF, "a BSDF of Mitsuba's or a dict of one")
    if not mi.has_flag(plugin.flags(), mi.BSDFFlags.Smooth):
        raise ValueError(
            f"bsdf = {plugin.class_name()}: it has no density, because it has only Dirac lobes. "
            "Choose a BSDF with a smooth lobe"
        )
    context = mi.BSDFContext()

    # Describe the case
    kind = bsdf.get("type") if isinstance(bsdf, dict) else plugin.class_name()
    angle = math.degrees(math.acos(max(-1.0, min(1.0, wi[2]))))

    def interaction(lanes: int) -> mi.SurfaceInteraction3f:
        si = dr.zeros(mi.SurfaceInteraction3f, lanes)
        si.wi = dr.opaque(mi.Vector3f, wi)
        si.uv = dr.opaque(mi.Point2f, (u, v))
        return si

    def sample(numbers: mi.Point3f) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
        si = interaction(dr.width(numbers))
        pair = mi.Point2f(numbers.y, numbers.z)
        bs, weight = plugin.sample(context, si, numbers.x, pair)
        valid = dr.any(mi.unpolarized_spectrum(weight) != 0) & (bs.pdf > 0)
        valid &= ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        return bs.wo, dr.select(valid, mi.Float(1), 0), bs.pdf

    def pdf(wo: mi.Vector3f) -> mi.Float:
        return plugin.pdf(context, interaction(dr.width(wo)), wo)

    return Case(sample, pdf, "sphere", name or f"{kind} at {angle:.0f} degrees", 3)


def light_case(light: Any, o: Any, *, name: str = "") -> Case:
    """Return the test case of a light's sampling: directions from a point against their density.

    Args:
        light: A shape of `tofrender.sampling`, or an object with the same methods: `sample(o,
            sample)`, which returns a record with `d`, `pdf` and `valid`, and `pdf(o, v)`.
            Alternatively a Mitsuba dictionary of an emitter, or of a shape that is an area light.
        o: Point from which the light is seen, (x, y, z).
        name: Name in the verdict; by default the light's type.

    Raises:
        ValueError: The dictionary does not describe a light with a density.

    Example:
        >>> emitter = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
        >>> ball = {"type": "sphere", "radius": 0.5, "emitter": emitter}
        >>> light_case(ball, (0, 0, 2)).test(samples=20_000).passed
        True
    """
    origin = tuple(point("o", o).tolist())
    checks.instance("name", name, str, "text")
    name = name or (str(light.get("type")) if isinstance(light, dict) else type(light).__name__)
    light = _MitsubaLight(light, name) if isinstance(light, dict) else light
    known = hasattr(light, "sample") and hasattr(light, "pdf")
    checks.require("light", light, known, "a shape of tofrender.sampling or a dict of a light")

    def sample(numbers: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
        record = light.sample(dr.opaque(mi.Point3f, origin), numbers)
        return record.d, dr.select(record.valid, mi.Float(1), 0), record.pdf

    def pdf(v: mi.Vector3f) -> mi.Float:
        return light.pdf(dr.opaque(mi.Point3f, origin), v)

    return Case(sample, pdf, "sphere", name)


class _MitsubaLight:
    """A Mitsuba light, alone in a scene, with the methods of a shape of `tofrender.sampling`."""

    def __init__(self, light: dict, name: str) -> None:
        self.scene: Any = _loaded("light", {"type": "scene", "light": light})
        emitters = self.scene.emitters()
        if len(emitters) != 1 or mi.has_flag(emitters[0].flags(), mi.EmitterFlags.Delta):
            raise ValueError(f"light = {name!r}: must be one light that can be hit")

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> SimpleNamespace:
        """Sample a direction from `o` to the light."""
        ds, _ = self.scene.sample_emitter_direction(_reference(o, sample), sample, False)
        return SimpleNamespace(d=ds.d, pdf=ds.pdf, valid=ds.pdf > 0)

    def pdf(self, o: mi.Point3f, v: mi.Vector3f) -> mi.Float:
        """Return the density of `sample` in the direction `v` [1/sr]."""
        it = _reference(o, v)
        ds = mi.DirectionSample3f(self.scene, self.scene.ray_intersect(mi.Ray3f(o, v)), it)
        ds.d = v
        pdf = self.scene.pdf_emitter_direction(it, ds)
        return dr.select(ds.emitter != None, pdf, 0)  # noqa: E711


def _reference(o: mi.Point3f, lanes: Any) -> mi.Interaction3f:
    """Return a reference point for emitter sampling in all lanes of `lanes`."""
    it = dr.zeros(mi.Interaction3f, dr.width(lanes))
    it.p = o
    return it


def _loaded(name: str, description: dict) -> Any:
    """Load the dictionary of a plugin, or of a scene with one light."""
    given = description.get("light", description)
    try:
        # Mitsuba's parser would end the process
        if any(value is None for value in given.values()):
            raise RuntimeError("a value is None")
        return mi.load_dict(description, parallel=False)
    except RuntimeError as error:
        allowed = f"must be a dict that Mitsuba loads ({' '.join(str(error).split())[:200]})"
        raise ValueError(f"{name} = {checks.quote(given)}: {allowed}") from None
