"""Make the pictures of the README: `python docs/_ext/readme_pictures.py [NAME ...]`.

The film needs a few minutes on two cores, the other picture needs seconds. The seeds are fixed, so
the same versions of all packages make the same files, up to floating-point rounding.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from PIL import Image

import tofrender

PICTURES = Path(__file__).parents[1] / "pictures"
FRAME_MS = 45
"""Duration of a frame of the film."""


def make_film(target: Path) -> None:
    """Render a pulse in the Cornell box, without denoising.

    The film ends at 9.4 m, when 96 % of the light has arrived. Later frames would show mostly
    noise, because few paths are so long.
    """
    film = tofrender.render(
        "cornell_box", spp=1024, size=(192, 192), bins=214, window=(3.5, 14.2), pulse_width=0.06
    )
    film = film.sel(opl=slice(3.6, 9.4))
    with tempfile.TemporaryDirectory() as folder:
        frames = tofrender.save_png_frames(film, Path(folder) / "frames", min_size=384)
        pictures = [Image.open(path).convert("RGB") for path in sorted(frames.glob("*.png"))]
    first, *others = pictures
    first.save(
        target, save_all=True, append_images=others, duration=FRAME_MS, loop=0, quality=70, method=6
    )


def make_hidden_letter(target: Path) -> None:
    """Capture the hidden letter at the relay wall, reconstruct it, and draw the volume."""
    scene = tofrender.nlos_z(width=64, height=64, temporal_bins=500)
    capture = tofrender.capture(scene, spp=256)
    capture.attrs["scene"] = "nlos_z"
    volume = tofrender.reconstruct(capture, "lct")
    tofrender.save_figure(tofrender.reconstruction_figure(volume), target, dpi=120)


MAKERS: dict[str, Callable[[Path], None]] = {
    "first_film.webp": make_film,
    "hidden.png": make_hidden_letter,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or MAKERS:
        MAKERS[name](PICTURES / name)
