"""The command `tofrender lidar`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

from ..runtime import checks
from . import options as opt
from .answers import Json, answer

HALF_ANGLE = partial(checks.number, low=0, high=0.5)


def lidar(
    scene: opt.Scene,
    out: Annotated[Path, opt.named("FILE", "Point cloud to write: .ply, .las or .nc.")],
    pattern: Annotated[
        str, opt.named("NAME|CSV", "raster, spinning, rosette, or a CSV file of shots.")
    ] = "raster",
    shots: Annotated[opt.Size | None, opt.size("64x48", "Columns and rows or rings.")] = None,
    fov: Annotated[opt.Size | None, opt.size("40x30", "Field of view, degrees.")] = None,
    divergence: Annotated[
        float, opt.checked(HALF_ANGLE, "Half angle of the beam, radians.", min=0, max=0.5)
    ] = 1e-3,
    pulses: Annotated[int, opt.integer(1, checks.MAX_SEED >> 1, "Pulses per shot.")] = 1,
    max_depth: opt.MaxDepth = None,
    spp: opt.Spp = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    as_json: Json = False,
) -> None:
    """Scan SCENE by a lidar in the place of its sensor.

    FILE has the points of all echoes, with intensity, return number and time; beside it, the file
    FILE_truth has those of the scene's first surfaces. Angles of a CSV file are in the columns
    azimuth_deg and elevation_deg, times in time_s.
    """
    truth = out.with_stem(f"{out.stem}_truth")
    from tofrender.io.point_clouds import SUFFIXES, require_laspy

    for file in (out, truth):
        opt.check_file_out(file, *SUFFIXES, overwrite=True)
    require_laspy("out", out)
    opt.activate(variant)

    from tofrender import io, scanning
    from tofrender.scenes.loading import find_scene

    named: dict[str, Any] = {"shots": shots, "fov_deg": fov}
    sampling: dict[str, Any] = {"max_depth": max_depth, "spp": spp}
    named, sampling = (
        {name: value for name, value in given.items() if value is not None}
        for given in (named, sampling)
    )
    shot_pattern = scanning.scan_pattern(pattern, **named)
    sampling |= {"seed": seed, "divergence_rad": divergence}
    waveforms = scanning.lidar(find_scene(scene), shot_pattern, **sampling)
    cloud = scanning.point_cloud(waveforms, pulses=pulses, seed=seed)
    io.save_point_cloud(cloud, out, overwrite=True)
    io.save_point_cloud(scanning.true_points(waveforms), truth, overwrite=True)
    sizes = {"shots": waveforms.sizes["shot"], "points": cloud.sizes["point"]}
    facts = {"out": str(out), "files": [out.name, truth.name], "scene": str(scene), **sizes}
    line = f"{out}: {sizes['points']} points of {sizes['shots']} shots; {truth.name}"
    answer("lidar", as_json, facts, [line])
