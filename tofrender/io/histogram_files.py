"""Histograms of multi-zone sensors and poses of sensors, in files of other programs."""

import gzip
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..runtime import checks, memory
from .files import reading

JSON_RATIO = 20  # Memory in bytes for each byte of JSON text
GZIP_MAGIC = b"\x1f\x8b"


def load_histograms(path: str | os.PathLike[str]) -> xr.Dataset:
    """Read photon histograms of a multi-zone sensor.

    Two layouts are recognized:

    - A JSON list of records with `hists` (zones, bins), `pose` (4, 4) and `reference_hist` (bins),
      as in the data set LCSPC of C. Sifferman and others.
    - A log of the driver of the TMF8829: JSON with `Result_Set`, a list of frames with `mp_histo`
      (rows, columns) of `bin`, and `ref_histo`. A file can contain several documents, each with
      one frame.

    Args:
        path: A JSON file, which may be compressed by gzip.

    Returns:
        A Dataset with `counts (pose, zone, bin)`. If the file contains them, also `to_world (pose,
        row, column)`, see `load_poses`, and the histograms of the chip's reference diodes,
        `reference (pose, diode, bin)`. Zones of a log are numbered row by row, and the attributes
        `zone_rows` and `zone_columns` are their numbers.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file has another layout, or its histograms differ in shape.

    Example:
        >>> import json, tempfile, pathlib
        >>> record = {"hists": [[1, 2, 3], [4, 5, 6]], "pose": [[1, 0, 0, 0], [0, 1, 0, 0]]}
        >>> record["pose"] += [[0, 0, 1, 0.5], [0, 0, 0, 0]]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = pathlib.Path(folder, "a.json")
        ...     _ = file.write_text(json.dumps([record]))
        ...     dict(load_histograms(file)["counts"].sizes)
        {'pose': 1, 'zone': 2, 'bin': 3}
    """
    with reading(path, "JSON with histograms, as load_histograms describes it") as file:
        # A list contains records with poses
        documents = list(_documents(file))
        if len(documents) == 1 and isinstance(documents[0], list):
            return _posed(documents[0])

        # Other documents are a log with frames
        frames = []
        for document in documents:
            found = document.get("Result_Set", []) if isinstance(document, dict) else []
            frames += found if isinstance(found, list) else [found]
        frames = [each for each in frames if isinstance(each, dict) and "mp_histo" in each]
        if not frames:
            raise ValueError("contains no histograms; must have records with hists or mp_histo")
        return _logged(frames)


def load_poses(path: str | os.PathLike[str]) -> np.ndarray:
    """Read poses of a sensor.

    Args:
        path: A JSON file with a list of matrices (4, 4), or of records with such a `pose`; or a
            text file with a row of 12 or 16 numbers for each pose, row by row of the matrix,
            separated by commas or blanks. A line that starts with # is a comment.

    Returns:
        Matrices from the sensor's frame to the world, float64 (poses, 4, 4). The last row is
        0, 0, 0, 1, also where the file has zeros only.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file contains no such matrices.

    Example:
        >>> import tempfile, pathlib
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = pathlib.Path(folder, "poses.txt")
        ...     _ = file.write_text("1 0 0 0.2  0 1 0 0.4  0 0 1 0.6")
        ...     load_poses(file)[0, :, 3].tolist()
        [0.2, 0.4, 0.6, 1.0]
    """
    with reading(path, "JSON with poses, or rows of 12 or 16 numbers") as file:
        # Is it JSON, or rows of numbers?
        text = _text(file)
        if text.lstrip()[:1] not in ("[", "{"):
            rows = np.loadtxt(text.replace(",", " ").splitlines(), ndmin=2)
            checks.shape("poses", rows, rows.shape[1] in (12, 16), "rows of 12 or 16 numbers")
            return _matrices(rows.reshape(len(rows), -1, 4))
        found = json.loads(text)
        checks.instance("poses", found, list, "a list")
        return _matrices([each["pose"] if isinstance(each, dict) else each for each in found])


def _matrices(poses: Any) -> np.ndarray:
    """Return poses as matrices (poses, 4, 4). The given last row can be missing or 0."""
    found = checks.finite("pose", checks.real_array("pose", poses, np.float64))
    valid = found.ndim == 3 and len(found) > 0 and found.shape[1:] in ((3, 4), (4, 4))
    checks.shape("pose", found, valid, "(poses, 4, 4)")
    whole = np.zeros((len(found), 4, 4))
    whole[:, : found.shape[1]] = found
    without = (whole[:, 3] == 0).all(axis=1)
    whole[without, 3, 3] = 1.0
    return whole


def _text(file: Path) -> str:
    """Read a text file, which may be compressed, if the memory suffices for its content."""
    size = file.stat().st_size
    # The first bytes show whether the file is compressed
    with file.open("rb") as opened:
        compressed = opened.read(2) == GZIP_MAGIC
    if not compressed:
        memory.require_free("content", JSON_RATIO * size)
        return file.read_text("utf-8")
    with gzip.open(file) as unpacked:
        content = b""
        while part := unpacked.read(1 << 22):
            content += part
            memory.require_free("content", JSON_RATIO * len(content))
    return content.decode("utf-8")


def _documents(file: Path) -> Iterator[Any]:
    """Read all JSON documents of a file."""
    text = _text(file)
    decoder = json.JSONDecoder()
    position = 0
    while True:
        while position < len(text) and text[position].isspace():
            position += 1
        if position == len(text):
            return
        document, position = decoder.raw_decode(text, position)
        yield document


def _counts(name: str, values: Any, axes: int) -> np.ndarray:
    """Return histograms as an array with this number of axes; counts are 0 or more."""
    counts = checks.finite(name, checks.real_array(name, values))
    checks.shape(name, counts, counts.ndim == axes and counts.size > 0, f"of {axes} axes")
    checks.require(name, float(counts.min()), counts.min() >= 0, "0 or more")
    return counts


def _posed(records: list[Any]) -> xr.Dataset:
    """Return the Dataset of records with `hists` and `pose`."""
    for number, record in enumerate(records):
        if not isinstance(record, dict) or "hists" not in record:
            raise ValueError(f"record {number} contains no hists; must be counts (zones, bins)")
    counts = _counts("hists", [record["hists"] for record in records], 3)
    variables: dict[str, Any] = {"counts": (("pose", "zone", "bin"), counts)}
    if all("pose" in record for record in records):
        matrices = _matrices([record["pose"] for record in records])
        variables["to_world"] = (("pose", "row", "column"), matrices)
    if all("reference_hist" in record for record in records):
        reference = _counts("reference_hist", [[each["reference_hist"]] for each in records], 3)
        variables["reference"] = (("pose", "diode", "bin"), reference)
    return _labeled(variables)


def _logged(frames: list[Any]) -> xr.Dataset:
    """Return the Dataset of frames of a log."""
    histograms = [[[each["bin"] for each in row] for row in frame["mp_histo"]] for frame in frames]
    counts = _counts("mp_histo", histograms, 4)
    rows, columns = counts.shape[1:3]
    variables: dict[str, Any] = {}
    flat = counts.reshape(len(counts), rows * columns, -1)
    variables["counts"] = (("pose", "zone", "bin"), flat)
    if all("ref_histo" in frame for frame in frames):
        reference = [[each["bin"] for each in frame["ref_histo"]] for frame in frames]
        variables["reference"] = (("pose", "diode", "bin"), _counts("ref_histo", reference, 3))
    return _labeled(variables).assign_attrs(zone_rows=rows, zone_columns=columns)


def _labeled(variables: dict[str, Any]) -> xr.Dataset:
    return xr.Dataset(variables, attrs={"quantity": "counts", "units": "1"})
