"""Files and commands of polarized light: Stokes vectors come back, the rest is refused by name."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
import xarray as xr
from helpers.scenes import refusal

import tofrender
from tofrender.cli.app import main

MONO, SPECTRAL = "llvm_ad_mono_polarized", "llvm_ad_spectral_polarized"
TINY = ["--size", "6x4", "--bins", "5", "--window", "3,13", "--no-progress", "--no-video"]


def rendered(**more) -> xr.Dataset:
    scene = tofrender.brewster_window(
        width=6, height=4, temporal_bins=5, start_opl=3.0, bin_width_opl=2.0
    )
    return tofrender.render(scene, spp=8, progress=False, **more)


def run(capsys, *arguments: object) -> None:
    """The command, in this process."""
    status = main([str(argument) for argument in arguments])
    assert status == 0, capsys.readouterr().err


def render(capsys, out: Path, *more: object, variant: str = MONO) -> xr.Dataset:
    """What `tofrender render` writes, read back."""
    run(capsys, "render", "brewster_window", "--out", out, *TINY, "--variant", variant, *more)
    if (out / "transient.npz").exists():
        return tofrender.load_npz(out / "transient.npz")
    if (out / "transient.zarr").exists():
        return tofrender.load_zarr(out / "transient.zarr").load()
    return tofrender.load_exr_stack(out / "stack.exr" if (out / "stack.exr").exists() else out)


@pytest.mark.parametrize("variant", [MONO, SPECTRAL])
@pytest.mark.parametrize("errors", [False, True])
def test_files_keep_stokes_vectors(variant, errors, tmp_path):
    mi.set_variant(variant)
    kept = rendered(errors=errors)
    assert kept.sizes["stokes"] == 4
    frames = tofrender.save_exr_stack(kept, tmp_path / "frames")
    parts = tofrender.save_exr_stack(kept, tmp_path / "a.exr", layout="multipart")
    assert tofrender.load_exr_stack(frames).identical(kept)
    assert tofrender.load_exr_stack(parts).identical(kept)
    assert tofrender.load_npz(tofrender.save_npz(kept, tmp_path / "a.npz")).identical(kept)
    tofrender.save_zarr(kept, tmp_path / "a.zarr")
    assert tofrender.load_zarr(tmp_path / "a.zarr").load().identical(kept)
    kept.to_netcdf(tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as opened:
        assert opened["transient"].equals(kept["transient"])
    found = OpenEXR.File(str(frames / "steady.exr"), separate_channels=True).parts[0].channels
    colors = "Y" if variant == MONO else "RGB"
    names = {f"S{k}.{c}" for k in range(4) for c in colors}
    assert set(found) == names | {f"error.{name}" for name in names if errors}
    for k in range(4):
        shown = found[f"S{k}.{colors[0]}"].pixels
        np.testing.assert_array_equal(shown, kept["steady"].values[:, :, k, 0])


def test_films_stream_to_the_disk(tmp_path):
    mi.set_variant(SPECTRAL)
    film, whole = rendered(out=tmp_path / "a.zarr"), rendered()
    assert film["transient"].dims == whole["transient"].dims
    np.testing.assert_allclose(film["transient"], whole["transient"], rtol=1e-5, atol=1e-7)
    name = "energy_outside_window"  # of S0; S1 of a reflection is below 0
    assert film.attrs[name] == pytest.approx(whole.attrs[name], abs=1e-5)


def test_other_channels_are_refused(tmp_path):
    mi.set_variant(MONO)
    stack = tofrender.save_exr_stack(rendered(), tmp_path / "a")
    header = OpenEXR.File(str(stack / "steady.exr")).parts[0].header
    image = np.zeros((4, 6), np.float32)
    OpenEXR.File(header, {"S0.Y": image, "S1.Y": image}).write(str(stack / "steady.exr"))
    said = refusal(tofrender.load_exr_stack, stack)
    assert said.endswith("must be RGB or Y, or RGB or Y of S0 to S3")


@pytest.mark.parametrize(
    ("kind", "variant"),
    [("frames", MONO), ("multipart", SPECTRAL), ("npz", SPECTRAL), ("zarr", MONO)],
)
def test_render_writes_what_is_read_back(capsys, tmp_path, kind, variant):
    found = render(capsys, tmp_path / "a", "--spp", 8, "--format", kind, variant=variant)
    picture = {"size": (6, 4), "bins": 5, "window": (3, 13), "spp": 8}
    same = tofrender.render("brewster_window", **picture, progress=False)
    np.testing.assert_allclose(found["transient"], same["transient"], rtol=1e-5, atol=1e-7)
    assert found["steady"].dims == ("y", "x", "stokes", "channel")
    assert (tmp_path / "a" / "polarization.png").stat().st_size > 1000


def test_pictures_are_of_the_intensity(capsys, tmp_path):
    arguments = ["--out", tmp_path / "a", *TINY[:-1], "--spp", 4, "--format", "png"]
    run(capsys, "render", "brewster_window", *arguments, "--variant", MONO)
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert {"video.mp4", "summary.png", "polarization.png", "steady.png"} <= names


@pytest.mark.parametrize("kind", ["frames", "npz"])
def test_resume_goes_on(capsys, tmp_path, kind):
    """With the same bytes as the same run in two parts, and the samples of both."""
    for name in "ab":
        out = tmp_path / name
        first = render(capsys, out, "--spp", 4, "--format", kind)
        found = render(capsys, out, "--spp", 8, "--format", kind, "--resume")
    assert first.attrs["spp"] == 4
    assert found.attrs["spp"] == 8
    files = [path for path in (tmp_path / "a").iterdir() if path.suffix == ".npz"]
    read = [tofrender.load_npz(tmp_path / each / path.name) for path in files for each in "ab"]
    assert all(each["transient"].equals(read[0]["transient"]) for each in read)


def test_renders_are_merged_reported_and_converted(capsys, tmp_path):
    one = render(capsys, tmp_path / "a", "--spp", 4)
    two = render(capsys, tmp_path / "b", "--spp", 4, "--seed", 1)
    folders = [tmp_path / "a", tmp_path / "b"]
    run(capsys, "merge", *folders, "--out", tmp_path / "c", "--no-video")
    both = tofrender.load_exr_stack(tmp_path / "c")
    np.testing.assert_allclose(both["steady"], (one["steady"] + two["steady"]) / 2, atol=1e-6)
    run(capsys, "report", tmp_path / "c", "--out", tmp_path / "c.html")
    run(capsys, "phasor", tmp_path / "c", "--freq", 20e6, "--out", tmp_path / "d")


@pytest.mark.parametrize(
    "arguments",
    [
        ["phasor", "brewster_window", "--freq", "20e6"],
        ["gate", "brewster_window", "--at", "4"],
        ["capture", "nlos_z"],
    ],
)
def test_what_has_no_stokes_vectors_says_so(capsys, tmp_path, arguments):
    out = tmp_path / ("a.h5" if arguments[0] == "capture" else "a")
    assert main([*arguments, "--variant", MONO, "--out", str(out)]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert f"variant = '{MONO}': its Stokes vectors cannot be kept here" in err
    assert not out.exists()
