"""The command `tofrender lidar`."""

from dataclasses import dataclass
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


@dataclass(frozen=True)
class Scan:
    """Options of the shots of a lidar."""

    pattern: Annotated[
        str, opt.named("NAME|CSV", "Scan pattern: raster, spinning, rosette, or a CSV file.")
    ] = "raster"
    shots: Annotated[
        Any, opt.size("64x48", "Columns and rows of the pattern; rows are rings if it spins.")
    ] = "64x48"
    fov: Annotated[
        Any,
        opt.checked(
            _field_of_view,
            "Field of view, horizontally and vertically [degrees].",
            metavar="WxH",
        ),
    ] = "40x30"
    divergence: Annotated[
        float,
        opt.checked(HALF_ANGLE, "Half angle of the beam [rad] (0 to 0.5).", metavar="NUMBER"),
    ] = 1e-3
    pulses: Annotated[
        int, opt.integer(1, checks.MAX_SEED >> 1, "Number of pulses of each shot")
    ] = 1
    rate: Annotated[float, opt.positive("Hz", "Shots per second [Hz]")] = 100e3
    pose_time: Annotated[
        float,
        opt.positive("seconds", "Time between two poses of a moving scene during a scan [s]"),
    ] = 1e-3


@opt.with_groups
def lidar(
    scene: opt.Scene,
    out: Annotated[Path, opt.named("FILE", "Point cloud to write: .ply, .las or .nc.")],
    *,
    scan: Scan,
    max_depth: Annotated[int, opt.setting("max_depth", default=None)] = 6,
    spp: Annotated[int, opt.setting("spp", default=None)] = 64,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    as_json: Json = False,
) -> None:
    """Scan a scene with a lidar at the sensor's pose.

    FILE contains the points of all echoes with intensity, return number and time. The file
    FILE_truth next to FILE contains the true points on the first surfaces of the scene.

    A CSV file of shots has the columns azimuth_deg and elevation_deg, and optionally time_s.
    --shots, --fov and --rate describe the other patterns.

    Examples:
        tofrender lidar cornell_box --out box.ply
        tofrender lidar scene.xml --pattern spinning --shots 512x32 --fov 360x30 --out hall.las
    """
    from tofrender.io.point_clouds import SUFFIXES, require_laspy

    truth = out.with_stem(f"{out.stem}_truth")
    for file in (out, truth):
        opt.check_file_out(file, *SUFFIXES, overwrite=True)
    require_laspy("out", out)
    opt.activate(variant)

    from tofrender import io, scanning
    from tofrender.scenes.loading import find_scene

    pattern = scanning.scan_pattern(
        scan.pattern, shots=scan.shots, fov_deg=scan.fov, rate_hz=scan.rate
    )
    found = scanning.lidar(
        find_scene(scene),
        pattern,
        divergence_rad=scan.divergence,
        max_depth=max_depth,
        spp=spp,
        seed=seed,
        pose_time_s=scan.pose_time,
    )
    cloud = scanning.point_cloud(found, pulses=scan.pulses, seed=seed)
    io.save_point_cloud(cloud, out, overwrite=True)
    io.save_point_cloud(scanning.true_points(found), truth, overwrite=True)
    facts = {
        "out": str(out),
        "files": [out.name, truth.name],
        "scene": scene,
        "shots": found.sizes["shot"],
        "points": cloud.sizes["point"],
    }
    line = f"{out}: {facts['points']} points of {facts['shots']} shots; {truth.name}"
    answer("lidar", as_json, facts, [line])
