"""What the tests of light transport share: small scenes, path lengths one by one, comparisons."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.parts import unit
from tofrender.integrators.plan import Plan
from tofrender.paths.camera import sample_camera
from tofrender.paths.endpoints import SceneLights
from tofrender.paths.records import Limits
from tofrender.paths.scattering import Materials
from tofrender.paths.space import Vacuum
from tofrender.sampling.statistics import p_values, smallest_allowed

ALPHA = 1e-3  # Chance that right code fails anywhere in the suite, had its seeds not been fixed
COMPARISONS = 1000  # Statistical comparisons that ALPHA is split over; the suite has fewer

TIME = ("temporal_bins", "start_opl", "bin_width_opl")


def film(width=1, height=1, bins=100, start=0.0, bin_width=0.1, **more: Any) -> dict:
    plain = {"type": "transient_hdr_film", "width": width, "height": height}
    time = dict(zip(TIME, (bins, start, bin_width), strict=True))
    return plain | time | {"rfilter": {"type": "box"}} | more


def camera(
    origin, target, film, *, kind="perspective", up=(0, 1, 0), spp=16, sampler="independent", **more
) -> dict:
    to_world = mi.ScalarTransform4f().look_at(list(origin), list(target), list(up))
    placed = {"to_world": to_world, "sampler": {"type": sampler, "sample_count": spp}}
    return {"type": kind, "film": film} | more | placed


def scene(parts: dict, sensor: dict, **integrator: Any) -> dict:
    integrator = {"type": "transient_path"} | integrator
    return {"type": "scene", "integrator": integrator, "sensor": sensor, **parts}


def load(description: dict) -> mi.Scene:
    return mi.load_dict(description, parallel=False, optimize=False)


def with_integrator(description: dict, **changes: Any) -> dict:
    """The same scene with other integrator parameters."""
    return description | {"integrator": description["integrator"] | changes}


def with_film(description: dict, **changes: Any) -> dict:
    """The same scene with other film parameters."""
    the_film = description["sensor"]["film"] | changes
    return description | {"sensor": description["sensor"] | {"film": the_film}}


def with_sampler(description: dict, kind: str = "independent") -> dict:
    sampler = {"type": kind, "sample_count": 16}
    return description | {"sensor": description["sensor"] | {"sampler": sampler}}


def steady_twin(description: dict, **changes: Any) -> dict:
    """The same scene for Mitsuba's `path` and `hdrfilm`."""
    kept = ("max_depth", "rr_depth", "hide_emitters")
    ours = {k: v for k, v in description["integrator"].items() if k in kept}
    result = dict(description)
    result["integrator"] = ours | changes | {"type": "path"}
    steady = {k: v for k, v in description["sensor"]["film"].items() if k not in TIME}
    pixels = "luminance" if mi.is_monochromatic else "rgb"
    steady |= {"type": "hdrfilm", "pixel_format": pixels, "component_format": "float32"}
    result["sensor"] = description["sensor"] | {"film": steady}
    return result


NAMELESS = (
    *("integrator", "sensor", "film", "rfilter", "sampler", "emitter", "bsdf", "phase", "sigma_t"),
    *("theta", "delta", "side"),
)
"""Keys of a dict for parts that have no id in an XML file."""


def parsed(source: dict | Path, **parameters: Any) -> dict:
    """Every node of a scene: its id (or plugin) -> (plugin, plain properties, names of its parts).

    Args:
        source: A dict, or the path of an XML file.
        **parameters: Values for the file's defaults.
    """
    config = mi.parser.ParserConfig(mi.variant())
    if isinstance(source, dict):
        state = mi.parser.parse_dict(config, source)
    else:
        texts = {name: str(value) for name, value in parameters.items()}
        state = mi.parser.parse_file(config, str(source), **texts)
    mi.parser.transform_resolve(config, state)

    owners = {
        value.index(): owner.props.id()
        for owner in state.nodes
        for _, value in owner.props.items()
        if isinstance(value, mi.Properties.ResolvedReference)
    }
    names: list[str] = []
    for k, node in enumerate(state.nodes):
        known, kind = node.props.id(), node.props.plugin_name()
        nameless = not known or known in NAMELESS
        several = sum(each.props.plugin_name() == kind for each in state.nodes) > 1
        names.append(f"{kind} of {owners.get(k)}" * several or kind if nameless else known)

    nodes = {}
    for name, node in zip(names, state.nodes, strict=True):
        plain, parts = {}, []
        for key, value in node.props.items():
            if isinstance(value, mi.Properties.ResolvedReference):
                parts.append(names[value.index()])
            else:
                plain[key] = np.array(value.matrix) if hasattr(value, "matrix") else value
        assert name not in nodes, f"{name} is there twice"
        nodes[name] = (node.props.plugin_name(), plain, sorted(parts))
    return nodes


def require_equal(nodes: dict, others: dict, atol: float = 1e-6) -> None:
    """Two scenes, as from `parsed`, have the same parts, numbers up to rounding in text."""
    assert nodes.keys() == others.keys()
    for name, (plugin, plain, parts) in nodes.items():
        assert others[name][0] == plugin, name
        assert others[name][2] == parts, name
        assert others[name][1].keys() == plain.keys(), name
        for key, value in plain.items():
            found = others[name][1][key]
            if isinstance(value, str | bool):
                assert found == value, (name, key)
            else:
                both = np.array(found, dtype=float), np.array(value, dtype=float)
                np.testing.assert_allclose(*both, rtol=1e-5, atol=atol, err_msg=f"{name}.{key}")


def refused(text: str, call: Callable, *args: Any, kind=(ValueError, TypeError), **options) -> None:
    """The call raises an error of one line, in which the regular expression is found."""
    with pytest.raises(kind, match=text) as error:
        call(*args, **options)
    assert "\n" not in str(error.value)


def rendered(description: dict | mi.Scene, spp: int = 16, seed: int = 0) -> tuple:
    """(steady, transient) as float64 arrays."""
    loaded = load(description) if isinstance(description, dict) else description
    steady, transient = mi.render(loaded, spp=spp, seed=seed)
    return np.array(steady, dtype=np.float64), np.array(transient, dtype=np.float64)


def path_image(description: dict, spp: int = 16, seed: int = 0, **changes: Any) -> np.ndarray:
    """What Mitsuba's own path tracer renders of the scene."""
    twin = load(steady_twin(description, **changes))
    return np.array(mi.render(twin, spp=spp, seed=seed), dtype=np.float64)


@dataclass
class Arrivals:
    """A measurement that writes down every contribution of every path."""

    count: Any  # contributions of each lane so far
    store: Store  # where they are written

    @classmethod
    def of(cls, lanes: int, slots: int) -> Arrivals:
        return cls(dr.zeros(mi.UInt32, lanes), Store(lanes, slots))

    def add(self, contribution):
        opl, value = contribution.opl, contribution.spectrum[0]
        index = self.store.lane * self.store.slots + self.count
        active = contribution.active & (self.count < self.store.slots)
        for name, what in (("opl", opl), ("value", value), ("filled", mi.Float(1))):
            dr.scatter(self.store.arrays[name], what, index, active)
        self.count[active] += 1


class Store:
    """Arrays of `slots` entries for each lane; not a dataclass, so no loop carries them."""

    def __init__(self, lanes: int, slots: int) -> None:
        self.slots = slots
        self.lane = dr.arange(mi.UInt32, lanes)
        self.arrays = {k: dr.zeros(mi.Float, lanes * slots) for k in ("opl", "value", "filled")}
        dr.eval(self.lane, self.arrays)


@dataclass
class Light:
    """Contributions of paths: `opl`, `value` of shape (lanes, slots), NaN where there is none."""

    opl: np.ndarray
    value: np.ndarray

    def all(self) -> tuple[np.ndarray, np.ndarray]:
        there = np.isfinite(self.opl)
        return self.opl[there], self.value[there]

    def histogram(self, edges: np.ndarray) -> np.ndarray:
        """Energy per bin, a mean over lanes."""
        opl, value = self.all()
        return np.histogram(opl, edges, weights=value)[0] / self.opl.shape[0]


def follow(
    loaded, ray, *, slots=8, seed=0, sampler="independent", lights=SceneLights, **options: Any
) -> Light:
    """Walk along the given rays and write down what arrives."""
    lanes = dr.width(ray)
    source = mi.load_dict({"type": sampler, "sample_count": lanes})
    source.set_samples_per_wavefront(lanes)
    source.seed(seed, lanes)
    record = Arrivals.of(lanes, slots)
    origin = options.pop("origin", None)
    limits = Limits(**{"max_depth": 2} | options)
    plan = Plan(loaded, Vacuum(loaded), lights(loaded), Materials(loaded), limits)
    plan.trace(source, ray, origin, record)
    arrays = record.store.arrays
    dr.eval(arrays)
    opl, value, filled = (
        np.array(arrays[k], dtype=np.float64).reshape(lanes, slots)
        for k in ("opl", "value", "filled")
    )
    there = filled > 0
    return Light(np.where(there, opl, np.nan), np.where(there, value, np.nan))


def beam(origin, target, lanes: int = 1) -> mi.Ray3f:
    """The same ray in every lane, from `origin` to `target`."""
    d = unit(np.subtract(target, origin))
    zero = dr.zeros(mi.Float, lanes)
    return mi.Ray3f(
        mi.Point3f(np.asarray(origin, float).tolist()) + zero, mi.Vector3f(d.tolist()) + zero
    )


def uniform(n: int, seed: int = 0) -> mi.Point2f:
    """Random points of the unit square."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, n)
    return sampler.next_2d()


def camera_rays(loaded: mi.Scene, lanes: int, seed: int = 0):
    """Random rays of the scene's camera, all through its first pixel."""
    sensor = loaded.sensors()[0]
    sampler = mi.load_dict({"type": "independent", "sample_count": lanes})
    sampler.seed(seed, lanes)
    return sample_camera(sensor, sensor.film(), sampler, dr.zeros(mi.UInt32, lanes))


def over_seeds(estimate: Callable[[int], np.ndarray], seeds: Iterable[int]) -> np.ndarray:
    """Estimates for several seeds, shape (seeds, ...)."""
    return np.stack([np.asarray(estimate(seed)) for seed in seeds])


def agree(samples: np.ndarray, reference: np.ndarray, *, rounding: float = 1e-5) -> bool:
    """Whether means agree, by the suite's one alpha. A reference must exist and hold light."""
    if reference is None or not np.any(np.nan_to_num(reference)):
        raise AssertionError("the reference is missing, or black")
    p = p_values(samples, reference, rounding=rounding)
    each = smallest_allowed(ALPHA, COMPARISONS)
    return bool(np.min(p) >= smallest_allowed(each, p.size))


def largest(a, b) -> float:
    """Largest difference, relative to the brightest value. NaN counts as 1."""
    difference = np.abs(np.asarray(a) - np.asarray(b)).max() / np.abs(b).max()
    return float(difference) if np.isfinite(difference) else 1.0
