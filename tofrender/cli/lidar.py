"""The command `tofrender lidar`."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

from ..runtime import checks
from . import options as opt
from .answers import Json, answer

HALF_ANGLE = partial(checks.number, low=0, high=0.5)


def _field_of_view(name: str, value: Any) -> tuple[float, float]:
    """Check the width and height of a field of view [degrees], like 40x22.5."""
    try:
        width, height = (opt.number(side) for side in str(value).lower().split("x"))
        across = checks.number(name, width, positive=True, high=360)
        return across, checks.number(name, height, positive=True, high=180)
    except ValueError:
        allowed = "width x height in degrees up to 360x180, like 40x22.5"
        raise ValueError(f"{name} = {checks.quote(value)}: must be {allowed}") from None


def lidar(
    scene: opt.Scene,
    out: Annotated[Path, opt.named("FILE", "Point cloud to write: .ply, .las or .nc.")],
    pattern: Annotated[
        str, opt.named("NAME|CSV", "raster, spinning, rosette, or a file.")
    ] = "raster",
    shots: Annotated[Any, opt.size("64x48", "Columns and rows or rings.")] = "64x48",
    fov: Annotated[
        Any, opt.checked(_field_of_view, "Field of view, degrees.", metavar="WxH")
    ] = "40x30",
    divergence: Annotated[
        float, opt.checked(HALF_ANGLE, "Half angle of the beam, radians.", min=0, max=0.5)
    ] = 1e-3,
    pulses: Annotated[int, opt.integer(1, checks.MAX_SEED >> 1, "Pulses per shot.")] = 1,
    rate: Annotated[float, opt.positive("Hz", "Shots per second.")] = 100e3,
    pose_time: Annotated[
        float, opt.positive("seconds", "Seconds that shots share a pose of a moving scene.")
    ] = 1e-3,
    max_depth: Annotated[int, opt.setting("max_depth")] = 6,
    spp: Annotated[int, opt.setting("spp")] = 64,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    as_json: Json = False,
) -> None:
    """Scan SCENE by a lidar in the place of its sensor.

    FILE has the points of all echoes, with intensity, return number and time; beside it, the file
    FILE_truth has those of the scene's first surfaces. A CSV file of shots has the columns
    azimuth_deg and elevation_deg, and perhaps time_s; --shots, --fov and --rate are of the others.
    """
    from tofrender.io.point_clouds import SUFFIXES, require_laspy

    truth = out.with_stem(f"{out.stem}_truth")
    for file in (out, truth):
        opt.check_file_out(file, *SUFFIXES, overwrite=True)
    require_laspy("out", out)
    opt.activate(variant)

    from tofrender import io, scanning
    from tofrender.scenes.loading import find_scene

    of_shots = scanning.scan_pattern(pattern, shots=shots, fov_deg=fov, rate_hz=rate)
    sampling: dict[str, Any] = {"max_depth": max_depth, "spp": spp, "seed": seed}
    sampling["pose_time_s"] = pose_time
    found = scanning.lidar(find_scene(scene), of_shots, divergence_rad=divergence, **sampling)
    cloud = scanning.point_cloud(found, pulses=pulses, seed=seed)
    io.save_point_cloud(cloud, out, overwrite=True)
    io.save_point_cloud(scanning.true_points(found), truth, overwrite=True)
    facts = {"out": str(out), "files": [out.name, truth.name], "scene": scene}
    facts |= {"shots": found.sizes["shot"], "points": cloud.sizes["point"]}
    line = f"{out}: {facts['points']} points of {facts['shots']} shots; {truth.name}"
    answer("lidar", as_json, facts, [line])
