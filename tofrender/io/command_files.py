"""Names of the files that each command writes into its folder."""

import re
from typing import NamedTuple

FORMATS = {
    "frames": "",
    "png": "",
    "multipart": "stack.exr",
    "npz": "transient.npz",
    "zarr": "transient.zarr",
}
"""The file with the transient of a render, by its format. Each frame is a separate file."""

FRAMES_LIST = "frames.json"
FRAMES_STEADY = "steady.npy"
VIDEO = "video.mp4"
"""Files of `tofrender render --frames`, next to a folder for each frame."""

GATE = "gate.exr"
PHASORS = "phasor_*Hz.exr"
DOPPLER = "doppler.nc"
DOPPLER_LAYERS = "doppler.exr"
RANGE_RATE = "range_rate.nc"
SPECTRA = "spectra.nc"
ESTIMATES = "estimates.nc"
SENSED = "sensed.nc"
TWIN = "twin.json"
VOLUME = "volume.npz"


class CommandFiles(NamedTuple):
    """Files of a command, as regular expressions of their names.

    A folder is an output of the command if it contains only listed files, and if at least one of
    these files has the mark of this package in its first bytes.
    """

    marked: tuple[str, ...]
    others: tuple[str, ...]  # figures, videos and archives without the mark


def _figure(name: str) -> str:
    return rf"{name}\.(png|pdf|svg)"


def _plain(*names: str) -> tuple[str, ...]:
    return tuple(re.escape(name) for name in names)


_FRAME = r"frame_\d{4,}"

COMMANDS = {
    "render": CommandFiles(
        (rf"{_FRAME}\.(exr|png)", r"steady\.(exr|png)", *_plain(*filter(None, FORMATS.values()))),
        (r"video\.(mp4|gif)", _figure("summary"), _figure("polarization")),
    ),
    "render --frames": CommandFiles(_plain(FRAMES_LIST), (_FRAME, *_plain(FRAMES_STEADY, VIDEO))),
    "phasor": CommandFiles((r"phasor_[\w.+-]+\.exr",), (_figure("panel"),)),
    "gate": CommandFiles(_plain(GATE), (_figure("picture"),)),
    "doppler": CommandFiles(_plain(DOPPLER, DOPPLER_LAYERS), (_figure("velocity"),)),
    "fmcw": CommandFiles(
        _plain(RANGE_RATE, SPECTRA, ESTIMATES),
        (_figure("range_velocity"), _figure("velocity")),
    ),
    "sense": CommandFiles(_plain(SENSED), (_figure("summary"),)),
    "twin": CommandFiles(_plain(TWIN), (_figure(r"\w+_(histograms|residuals)"),)),
    "reconstruct": CommandFiles(
        (r"brightness\.exr", r"depth\.exr"), (*_plain(VOLUME), _figure("volume"))
    ),
}
"""Files of each command that writes a folder; `merge` writes those of `render`."""

PAGE = "report.html"
"""Page of `tofrender report`, which may lie in any of these folders."""


def is_listed(name: str, *, marked: bool = False, commands: tuple[str, ...] = ()) -> bool:
    """Return whether commands write a file of this name; if `marked`, one that has the mark.

    Without `commands`, these are all commands except `render --frames`, which writes folders.
    """
    if name == PAGE:
        return not marked
    chosen = commands or tuple(each for each in COMMANDS if each != "render --frames")
    for command in chosen:
        contents = COMMANDS[command]
        patterns = contents.marked if marked else (*contents.marked, *contents.others)
        if any(re.fullmatch(pattern, name) for pattern in patterns):
            return True
    return False
