"""Output: exact round trips, headers, other readers, what may be replaced, failing writes."""

import errno
import json
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import h5py
import imageio_ffmpeg
import numpy as np
import OpenEXR
import pytest
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.limits import lower
from helpers.made_dataset import START, WIDTH, assert_same, make_dataset
from helpers.refusals import refused
from PIL import Image, ImageSequence

from tofrender import io, save_zarr
from tofrender.io import exr, npz, pictures
from tofrender.rendering.labels import labeled
from tofrender.runtime import atomic


def target(tmp_path: Path, layout: str) -> Path:
    return tmp_path / ("stack" + {"frames": "", "multipart": ".exr"}.get(layout, f".{layout}"))


def save(dataset, path, layout, **options):
    if layout in ("npz", "zarr"):
        return {"npz": io.save_npz, "zarr": save_zarr}[layout](dataset, path, **options)
    return io.save_exr_stack(dataset, path, layout=layout, **options)


def load(path, layout):
    return io.load_npz(path) if layout == "npz" else io.load_exr_stack(path)


layouts = pytest.mark.parametrize("layout", ["frames", "multipart", "npz"])
exr_layouts = pytest.mark.parametrize("layout", ["frames", "multipart"])


@layouts
@pytest.mark.parametrize("channels", ["RGB", "L"])
def test_round_trip_is_exact(tmp_path, layout, channels):
    dataset = make_dataset(height=37, width=21, channels=channels, x0=5, y0=7)
    values = dataset["transient"].values
    values[0, 0, 0], values[0, 1, 0], values[0, 2, 0] = -0.0, 1e-42, np.finfo(np.float32).max
    path = target(tmp_path, layout)
    assert save(dataset, path, layout) == path
    assert_same(load(path, layout), dataset)
    assert os.listdir(tmp_path) == [path.name]


@layouts
@pytest.mark.parametrize("channels", ["RGB", "L"])
def test_round_trip_of_standard_errors(tmp_path, layout, channels):
    dataset = make_dataset(channels=channels)
    for name in ("transient", "steady"):
        values = dataset[name].values / 7
        dataset[f"{name}_error"] = dataset[name].dims, values, dict(dataset[name].attrs)
    path = save(dataset, target(tmp_path, layout), layout)
    assert_same(load(path, layout), labeled(dataset))


@layouts
@pytest.mark.parametrize(("name", "bad"), [("transient", np.nan), ("steady", -np.inf)])
def test_data_that_are_not_finite_are_not_read(tmp_path, layout, name, bad):
    """They are written all the same, so that work is not lost, with a warning."""
    dataset, path = make_dataset(), target(tmp_path, layout)
    values = dataset[name].values
    values[3, 4], values[5, 9] = bad, np.nan
    count = values.size - np.isfinite(values).sum()
    place = re.escape(str([3, 4, *[0] * (values.ndim - 2)]))
    said = (
        f"{name}: {count} of {values.size} values are not finite, the first is {bad:g} at {place}"
    )
    with pytest.warns(UserWarning, match=f"^{said}.*cannot be read"):
        save(dataset, path, layout)
    with refused(f"^path = .*: {said}"):
        load(path, layout)


def test_names_of_layers_come_back(tmp_path):
    layers = {name: np.full((2, 3, 3), k) for k, name in enumerate(["X", "XY", "Y", "a.Y", "RGB"])}
    layers |= {name: np.full((2, 3, 1), 0.5) for name in ("", "a", "aRGB", "RGBA", "a.R")}
    found, *_ = exr.load_exr_layers(io.save_exr_layers(tmp_path / "a.exr", layers))
    assert sorted(found) == sorted(layers)
    for name, values in layers.items():
        np.testing.assert_array_equal(found[name], values)
    for name in ("format", "type"):
        with refused(f"attrs: EXR headers reserve '{name}'"):
            io.save_exr_layers(tmp_path / "b.exr", layers, {name: "x"})


def test_a_descriptor_stays_open(tmp_path):
    """A number would be taken for an open file, and that file closed."""
    save(make_dataset(), tmp_path / "a.npz", "npz")
    with open(tmp_path / "a.npz", "rb") as file:
        for load in (io.load_npz, io.load_exr_stack, io.load_capture):
            with refused(f"^path = {file.fileno()}: must be text"):
                load(file.fileno())
        os.fstat(file.fileno())


def test_images_of_others_are_refused(tmp_path):
    foreign = tmp_path / "foreign.exr"
    OpenEXR.File({}, {"Y": np.ones((2, 2), np.float32)}).write(str(foreign))
    with refused(r"foreign.exr: contains other EXR images"):
        io.load_exr_stack(foreign)


def test_gifs_have_a_largest_fps(tmp_path):
    with refused(r"fps = 60: .*at most 50"):
        io.save_video(make_dataset(), tmp_path / "v.gif", fps=60)


@exr_layouts
def test_half_rounds_to_11_bits_and_refuses_what_would_become_infinite(tmp_path, layout):
    dataset, path = make_dataset(), target(tmp_path, layout)
    dataset["transient"].values[1, 2, 4, 0] = 7e4
    with refused(r"^precision = 'half': 70000 .*must be 'float'"):
        io.save_exr_stack(dataset, path, layout=layout, precision="half")
    assert not os.listdir(tmp_path)
    dataset["transient"].values[1, 2, 4, 0] = 65504
    io.save_exr_stack(dataset, path, layout=layout, precision="half")
    loaded = io.load_exr_stack(path)
    assert loaded["transient"].dtype == np.float32
    np.testing.assert_allclose(loaded["transient"], dataset["transient"], rtol=2**-11, atol=2**-25)
    assert loaded.attrs == dataset.attrs


def test_frame_names_sort_where_they_have_more_digits(tmp_path, monkeypatch):
    lower(monkeypatch, frame_digits=3)  # With 4, it takes more than 10 000 frames
    dataset = make_dataset(height=1, width=1, bins=1_101, channels="L")
    io.save_exr_stack(dataset, tmp_path / "stack")
    names = sorted(file.name for file in (tmp_path / "stack").glob("frame_*"))
    assert names[0] == "frame_0000.exr"
    assert names[999:1_001] == ["frame_0999.exr", "frame_1000.exr"]
    assert_same(io.load_exr_stack(tmp_path / "stack"), dataset)


@exr_layouts
def test_headers_say_what_a_frame_is(tmp_path, layout):
    dataset = make_dataset(x0=5, y0=7, film_width=64, film_height=48)
    path = target(tmp_path, layout)
    io.save_exr_stack(dataset, path, layout=layout)
    if layout == "frames":
        header = OpenEXR.File(str(path / "frame_0003.exr"), header_only=True).header()
    else:
        part = OpenEXR.File(str(path), header_only=True).parts[4]
        assert part.name() == "frame_0003"
        header = part.header
    assert header["bin_index"] == 3
    for key, bins in (("opl_start", 3), ("opl_center", 3.5), ("opl_stop", 4)):
        assert header[key].dtype == np.float64
        np.testing.assert_allclose(header[key], START + bins * WIDTH, rtol=1e-15)
    expected = {"spp": 64, "seed": str(2**32 - 1), "complete": 1}
    for key in ("quantity", "units", "pulse", "scene", "versions", "sampler"):
        expected[key] = dataset.attrs[key]
    assert {key: header[key] for key in expected} == expected
    assert header["energy_outside_window"][0] == 1e-3 / 3
    assert [list(corner) for corner in header["dataWindow"]] == [[5, 7], [14, 12]]
    assert [list(corner) for corner in header["displayWindow"]] == [[0, 0], [63, 47]]
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    for size in ("film_width", "film_height"):
        del dataset.attrs[size]
    io.save_exr_stack(dataset, path, layout=layout, overwrite=True)
    part = path / "steady.exr" if layout == "frames" else path
    window = OpenEXR.File(str(part), header_only=True).header()["displayWindow"]
    assert [list(corner) for corner in window] == [[0, 0], [14, 12]]


@pytest.mark.parametrize("precision", ["half", "float"])
def test_mitsuba_reads_the_same_values(tmp_path, precision):
    color = make_dataset(height=37, x0=5, y0=7)
    mono = make_dataset(height=37, channels="L")
    io.save_exr_stack(color, tmp_path / "color", precision=precision)
    io.save_exr_stack(mono, tmp_path / "mono", precision=precision)
    io.save_exr_stack(color, tmp_path / "parts.exr", layout="multipart", precision=precision)
    # Mitsuba shows a multi-part file's first part.
    files = ["color/frame_0002.exr", "mono/frame_0002.exr", "parts.exr"]
    program = (
        "import sys, numpy as np, mitsuba as mi; mi.set_variant('scalar_rgb')\n"
        "np.savez('read.npz', *[np.array(mi.Bitmap(f)) for f in sys.argv[1:]])"
    )
    subprocess.run([sys.executable, "-c", program, *files], cwd=tmp_path, check=True)
    read = list(np.load(tmp_path / "read.npz").values())
    dtype = np.float16 if precision == "half" else np.float32
    np.testing.assert_array_equal(read[0], color["transient"].values[:, :, 2].astype(dtype))
    np.testing.assert_array_equal(
        read[1].reshape(37, 10), mono["transient"].values[:, :, 2, 0].astype(dtype)
    )
    np.testing.assert_array_equal(read[2], color["steady"].values.astype(dtype))


def test_npz_opens_with_plain_numpy(tmp_path):
    """It is the file that numpy would write."""
    dataset = make_dataset()
    path = io.save_npz(dataset, tmp_path / "stack.npz")
    with np.load(path) as archive:  # no pickles
        np.testing.assert_array_equal(archive["transient"], dataset["transient"])
        assert json.loads(str(archive["tofrender"]))["attrs"] == dataset.attrs
        np.savez(tmp_path / "numpys.npz", **archive)
    assert path.read_bytes() == (tmp_path / "numpys.npz").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["transient"], "found a DataArray named transient; pass the whole Dataset"),
        (lambda d: d.drop_vars("steady"), "variable steady is missing"),
        (lambda d: d.expand_dims(frame=1), "additional axis frame"),
        (lambda d: d.astype("float64"), "float32"),
        (lambda d: d.isel(x=[0, 2]), "axis x skips pixels"),
        (lambda d: d.assign_attrs(bin_width_opl=0.0), "attribute bin_width_opl is missing"),
        (lambda d: d.assign_attrs(extra=[1]), "attribute extra"),
        (lambda d: d.isel(opl=slice(0)), "axis opl is empty"),
    ],
)
@pytest.mark.parametrize("layout", ["frames", "multipart", "npz", "zarr"])
def test_other_datasets_are_refused(tmp_path, layout, change, message):
    with refused(message):
        save(change(make_dataset()), target(tmp_path, layout), layout)
    assert not os.listdir(tmp_path)


@layouts
def test_earlier_output_is_replaced_only_when_asked(tmp_path, layout):
    path = target(tmp_path, layout)
    first, second = make_dataset(bins=7), make_dataset(bins=4, spp=3)
    save(first, path, layout)
    with pytest.raises(FileExistsError, match="pass overwrite=True"):
        save(second, path, layout)
    assert_same(load(path, layout), first)
    save(second, path, layout, overwrite=True)
    assert_same(load(path, layout), second)
    if layout == "frames":
        assert len(os.listdir(path)) == 5
    assert os.listdir(tmp_path) == [path.name]


def test_other_content_is_never_replaced(tmp_path):
    def is_refused(what: str) -> None:
        with refused(f"{folder}.*{what}.*must be a new or empty folder", FileExistsError):
            io.save_exr_stack(make_dataset(), folder, overwrite=True)

    folder = tmp_path / "out"
    folder.write_text("a file")
    is_refused("is a file")
    folder.unlink()
    folder.mkdir()
    io.save_exr_stack(make_dataset(), folder)  # empty: fine
    (folder / "notes.txt").write_text("mine")
    is_refused(r"contains other files \(notes.txt\)")
    (folder / "notes.txt").unlink()
    (folder / "video.mp4").write_text("beside a stack it is ours")
    io.save_exr_stack(make_dataset(), folder, overwrite=True)
    assert not (folder / "video.mp4").exists()
    # Another program's frames under the same name.
    OpenEXR.File({}, {"Y": np.ones((2, 2), np.float32)}).write(str(folder / "frame_0001.exr"))
    is_refused(r"\(frame_0001.exr\)")
    (folder / "frame_0001.exr").unlink()
    for file in folder.iterdir():
        file.unlink()
    (folder / "summary.png").write_text("alone it proves nothing")
    is_refused(r"\(summary.png\)")
    with pytest.raises(FileExistsError, match="is a folder; must be the name of a file"):
        io.save_npz(make_dataset(), tmp_path.rename(tmp_path.with_suffix(".npz")), overwrite=True)


def test_the_current_folder_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileExistsError, match="is the current folder"):
        io.save_exr_stack(make_dataset(), ".")


def test_several_outputs_appear_as_one_folder(tmp_path):
    dataset, out = make_dataset(), tmp_path / "deep" / "out"
    with io.output_folder(out) as folder:
        io.save_exr_stack(dataset, folder)
        io.save_video(dataset, folder / "video.mp4")
        assert not out.exists()
    assert_same(io.load_exr_stack(out), dataset)
    with pytest.raises(KeyError), io.output_folder(out, overwrite=True) as folder:
        raise KeyError
    assert (out / "video.mp4").exists()
    with io.output_folder(out, overwrite=True) as folder:
        io.save_npz(dataset, folder / "transient.npz")
    assert os.listdir(out) == ["transient.npz"]
    assert os.listdir(out.parent) == ["out"]


def test_content_that_appears_meanwhile_is_kept(tmp_path):
    out = tmp_path / "out"

    def write_while_another_program_does():
        with io.output_folder(out):
            out.mkdir()
            (out / "thesis.txt").write_text("precious")

    with pytest.raises(FileExistsError, match=r"thesis\.txt"):
        write_while_another_program_does()
    assert (out / "thesis.txt").read_text() == "precious"
    assert os.listdir(tmp_path) == ["out"]


@exr_layouts
def test_estimate_is_an_upper_bound(tmp_path, layout):
    dataset = make_dataset(height=64, width=64)
    noise = np.random.default_rng(2).integers(0, 2**30, dataset["transient"].shape, np.uint32)
    dataset["transient"].values[:] = noise.view(np.float32)  # does not compress
    path = io.save_exr_stack(dataset, target(tmp_path, layout), layout=layout)
    files = list(path.iterdir()) if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files)
    bound = io.output.stack_bytes(dataset["transient"].shape)
    assert 0.5 * bound < size <= bound


OVER = {"overwrite": True}
WRITERS = {
    **{
        layout: lambda d, folder, layout=layout: save(d, target(folder, layout), layout, **OVER)
        for layout in ("frames", "multipart", "npz")
    },
    "png": lambda dataset, folder: io.save_png_frames(dataset, folder / "s", overwrite=True),
    "mp4": lambda dataset, folder: io.save_video(dataset, folder / "s.mp4"),
    "gif": lambda dataset, folder: io.save_video(dataset, folder / "s.gif"),
    "capture": lambda dataset, folder: io.save_capture(capture(dataset), folder / "s.h5", **OVER),
}


def capture(dataset):
    bins = dataset.sizes["opl"]
    return capture_of(rectangle((0, 0.1), (0, 0.1), 1, 0.1), Wall(4), bins=bins)


def content(folder: Path) -> dict[str, bytes]:
    return {str(f): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("earlier", [False, True])
@pytest.mark.parametrize(
    "failure", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()]
)
def test_failing_writes_leave_nothing(tmp_path, monkeypatch, writer, earlier, failure):
    if earlier:
        WRITERS[writer](make_dataset(bins=3), tmp_path)
    before = content(tmp_path)
    calls = []

    def fail(*args, **kwargs):
        calls.append(args)
        if len(calls) > 2:
            raise failure
        return original(*args, **kwargs)

    owner, name = {
        "frames": (Path, "write_bytes"),
        "multipart": (exr.MultipartWriter, "add"),
        "npz": (npz, "_write"),
        "png": (Image.Image, "save"),
        "capture": (h5py.Group, "create_dataset"),
    }.get(writer, (pictures._Frames, "draw"))
    original = getattr(owner, name)
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, fail)
        with pytest.raises(type(failure)) as caught:
            WRITERS[writer](make_dataset(), tmp_path)
    assert content(tmp_path) == before
    assert len(os.listdir(tmp_path)) == earlier
    if isinstance(failure, OSError):
        assert str(caught.value).startswith(f"path = {tmp_path}")
        assert "the disk is too full; needs" in str(caught.value)
        assert caught.value.errno == errno.ENOSPC


def test_interrupt_while_taking_the_place(tmp_path, monkeypatch):
    stack = io.save_exr_stack(make_dataset(), tmp_path / "s")
    before = content(tmp_path)
    rename, calls = os.rename, []

    def interrupted(source, destination):
        calls.append(source)
        if len(calls) == 2:  # the old stack is aside, the new one not yet in place
            raise KeyboardInterrupt
        rename(source, destination)

    monkeypatch.setattr(atomic, "_exchange", lambda *_: False)  # As on other systems
    monkeypatch.setattr(atomic.os, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        io.save_exr_stack(make_dataset(bins=3), stack, overwrite=True)
    assert content(tmp_path) == before
    assert os.listdir(tmp_path) == ["s"]


def test_broken_ffmpeg_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(pictures._FORMATS, ".mp4", ["-c:v", "nonsense"])
    with refused(r"ffmpeg failed with status .*nonsense", RuntimeError):
        io.save_video(make_dataset(), tmp_path / "v.mp4")
    assert not os.listdir(tmp_path)


def decode(path: Path) -> np.ndarray:
    if path.suffix == ".gif":
        with Image.open(path) as image:
            frames = ImageSequence.Iterator(image)
            return np.stack([np.asarray(frame.convert("RGB")) for frame in frames])
    pattern = path.with_name("decoded_%04d.bmp")
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path), str(pattern)]
    subprocess.run(command, check=True)
    return np.stack([np.asarray(Image.open(f)) for f in sorted(path.parent.glob("*.bmp"))])


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
@pytest.mark.parametrize("channels", ["RGB", "L"])
def test_video_shows_every_bin_with_its_time(tmp_path, suffix, channels):
    dataset = make_dataset(height=7, width=9, bins=8, channels=channels)
    dataset["transient"].values[:2] = np.nan
    path = io.save_video(dataset, tmp_path / f"v{suffix}", fps=25, all_bins=True)
    frames = decode(path)
    assert len(frames) == 8
    height, width = frames.shape[1:3]
    assert height % 2 == width % 2 == 0
    scale = 55  # 7 pixels become at least 384
    assert width >= 9 * scale
    assert height > 7 * scale
    labels = frames[:, 7 * scale :].astype(int)
    assert labels.max() > 180  # bright ink on dark paper, in the middle and not at the edges
    assert labels[:, :, :10].max() < 80
    for before, after in pairwise(labels):
        assert np.abs(before - after).max() > 80


def test_video_keeps_late_light_visible_and_leaves_out_the_dark(tmp_path):
    """Light that halves with every frame; three dark bins before it and ten after."""
    dataset = make_dataset(height=384, width=384, bins=24)
    light = np.concatenate([np.zeros(3), 0.5 ** np.arange(11), np.zeros(10)])
    dataset["transient"].values[:] = light[:, None]
    frames = decode(io.save_video(dataset, tmp_path / "v.mp4"))[:, 100:300, 100:300]
    assert len(frames) == 6  # Each that is brighter than 2^-6 of the first
    assert frames[0].mean() > 240
    # Half of the fading is made up for, and the dark is lifted by a stop more
    linear = 0.5 ** (0.5 * np.arange(6))
    srgb = 255 * (1.055 * linear ** (1 / 2.4) - 0.055)
    assert (frames.mean((1, 2, 3)) >= srgb - 4).all()
    assert frames[-1].mean() < 200
    for path in tmp_path.iterdir():
        path.unlink()
    same = decode(io.save_video(dataset, tmp_path / "v.mp4", exposure=1, all_bins=True))
    assert len(same) == 24
    linear = same[3:9, 100:300, 100:300].mean((1, 2, 3)) / 255
    np.testing.assert_allclose(((linear + 0.055) / 1.055) ** 2.4, 0.5 ** np.arange(6), rtol=0.1)


def test_video_colors_survive(tmp_path):
    dataset = make_dataset(height=400, width=400, bins=3)
    dataset["transient"].values[:] = np.float32([0.5, 0.1, 0.02])
    frames = decode(io.save_video(dataset, tmp_path / "v.mp4", exposure=1))
    np.testing.assert_allclose(frames[1, 50:350, 50:350].mean((0, 1)), [188, 89, 39], atol=4)


def test_png_frames(tmp_path):
    dataset = make_dataset(height=200, width=100, bins=3)
    path = io.save_png_frames(dataset, tmp_path / "frames")
    files = sorted(path.iterdir())
    assert [file.name for file in files] == [f"frame_000{index}.png" for index in range(3)]
    pictures = [np.asarray(Image.open(file)) for file in files]
    assert pictures[0].shape[1] == 400
    assert pictures[0].shape[0] > 800
    assert not np.array_equal(pictures[0], pictures[1])
    with pytest.raises(FileExistsError, match="overwrite=True"):
        io.save_png_frames(dataset, path)
    io.save_png_frames(dataset, path, overwrite=True)
