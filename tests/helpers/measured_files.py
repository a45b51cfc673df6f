"""Files of measured captures, written from the documentation of their formats."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from scipy.io import savemat

ROWS, COLUMNS, BINS = 3, 4, 6
BIN_S = 16e-12
COUNTS = np.random.default_rng(7).poisson(3.0, (ROWS, COLUMNS, BINS)).astype(np.uint16)
"""Row 0 is the upper one, column 0 the left one, as seen from the wall."""
COUNTS[..., -1] |= 1  # Photons in the last bin, without which files of photons have fewer bins


def lct(path: Path) -> None:
    """`rect_data` (x, y, bins); the reference code shows x mirrored, y downwards."""
    savemat(path, {"rect_data": COUNTS[:, ::-1].transpose(1, 0, 2), "width": 0.35})


def matlab_73(path: Path, **arrays: Any) -> None:
    """Version 7.3: HDF5 behind 512 bytes of text, axes reversed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            file[name] = np.asarray(array).T
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def lct_73(path: Path) -> None:
    matlab_73(path, rect_data=COUNTS[:, ::-1].transpose(1, 0, 2), width=[[0.35]])


DELAYS = np.random.default_rng(3).integers(0, 5, (ROWS, COLUMNS))
"""Bins by which light meets the wall late."""


def fk(path: Path, delays: Any = DELAYS) -> None:
    """`meas` (y, x, bins), and in tof.mat when light meets the wall [ps], within a bin of 32 ps."""
    meas = np.full((ROWS, COLUMNS, BINS + DELAYS.max()), 99, np.uint16)
    for pixel in np.ndindex(ROWS, COLUMNS):
        meas[pixel][DELAYS[pixel] :][:BINS] = COUNTS[pixel]
    matlab_73(path, meas=meas)
    savemat(path.with_name("tof.mat"), {"tofgrid": 32.0 * delays + 7})


def photon_times(path: Path, name: str = "arrivalTimes", **more: Any) -> None:
    cells = np.empty((ROWS, COLUMNS), object)
    for pixel in np.ndindex(ROWS, COLUMNS):
        times = np.repeat(np.arange(BINS), COUNTS[pixel])
        cells[pixel] = np.random.default_rng(0).permutation(times).astype(np.uint16)[:, None]
    savemat(path, {name: cells} | more)


def npz(path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, counts=COUNTS, bin_width_s=BIN_S, start_s=1e-9, wall_size=[0.6, 0.4])


def csv(path: Path) -> None:
    lines = [["y", "x", *(1e-9 + BIN_S * np.arange(BINS))]]
    lines += [[*pixel, *COUNTS[pixel]] for pixel in np.ndindex(ROWS, COLUMNS)]
    path.write_text("".join(",".join(map(str, line)) + "\n" for line in lines[:1] + lines[:0:-1]))


def ptu(path: Path) -> None:
    import ptufile

    counts = np.array([COUNTS, COUNTS])[..., None, :]  # Two frames
    ptufile.imwrite(path, counts, 25e-9, BIN_S)


def sdt(path: Path, blocks: int = 2, scan: tuple[int, int] = (COLUMNS, ROWS)) -> None:
    """Header, identification, one measurement description, blocks of an image (y, x, bins)."""
    from sdtfile import sdtfile

    text = b"*IDENTIFICATION\r\n  ID : SPC Setup & Data File\r\n*END\r\n"
    described = np.zeros(1, sdtfile.record_dtype(sdtfile.MEASURE_INFO, 512))
    described["tac_r"], described["tac_g"], described["adc_re"] = BIN_S * BINS * 4, 4, BINS
    described["scan_x"], described["scan_y"] = scan
    description = described.tobytes()
    image = COUNTS.astype("<u2").tobytes()
    first = 42 + len(text) + len(description)
    head = struct.pack("<hihiHihIihhHIHH", 15, 42, len(text), 0, 0, first, blocks, len(image),
                        42 + len(text), 1, len(description), 0x5555, 0, 0, 0x55AA)  # fmt: skip
    content = head + text + description
    for _ in range(blocks):
        at = len(content)
        after = at + 22 + len(image)
        content += struct.pack("<BBIIHhII", 0, 0, at + 22, after, 0x11, 0, 0, len(image)) + image
    path.write_bytes(content)


class Scan(NamedTuple):
    """A format of confocal scans: its writer, options to read it, what is read."""

    write: Callable[[Path], None]
    options: dict[str, Any]
    wall: tuple[float, float]
    bin_s: float = BIN_S
    start_s: float = 0.0
    times: int = 1  # What counts are multiplied with


SIZE = {"wall_size": (0.6, 0.4)}
SCANS = {
    "lct": Scan(lct, {}, (0.7, 0.7), 4e-12),
    "lct 7.3": Scan(lct_73, {"bin_width_s": BIN_S}, (0.7, 0.7)),
    "f-k": Scan(fk, {}, (2, 2), 32e-12),
    "cells": Scan(photon_times, SIZE | {"bin_width_s": BIN_S, "start_s": -1e-9}, (0.6, 0.4),
                  start_s=-1e-9),
    "npz": Scan(npz, {}, (0.6, 0.4), start_s=1e-9),
    "csv": Scan(csv, SIZE, (0.6, 0.4), start_s=1e-9),
    "ptu": Scan(ptu, SIZE, (0.6, 0.4), times=2),
    "sdt": Scan(sdt, SIZE, (0.6, 0.4), times=2),
}  # fmt: skip


def znlos(path: Path, mode: str, reverse: bool = False, **changes: Any) -> np.ndarray:
    """A file of Z-NLOS; returns `data` summed over bounces from the third on, and colors."""
    shapes = {"laser": {"confocal": (4, 3), "single": (1, 1), "exhaustive": (2, 5)}[mode]}
    shapes["camera"] = (4, 3)
    points = shapes["camera"] if mode == "confocal" else shapes["laser"] + shapes["camera"]
    data = np.random.default_rng(2).uniform(size=(*points, 3, BINS, 2)).astype(np.float32)
    fields: dict[str, Any] = {"data": data, "deltaT": 0.01, "t0": 0.5, "t": [BINS]}
    for name, (across, down) in shapes.items():
        x, y = np.meshgrid(0.3 * np.arange(across), 0.2 * np.arange(down), indexing="ij")
        fields[f"{name}GridPositions"] = np.stack([x, y, 0 * x], axis=-1)
        fields[f"{name}GridNormals"] = np.broadcast_to([0.0, 0, 1], (*x.shape, 3))
        fields[f"{name}Position"] = [[-0.5, 0.1, 0.25]]
    fields |= {"isConfocal": [int(mode == "confocal")]} | changes
    with h5py.File(path, "w") as file:
        for name, value in fields.items():
            file[name] = np.transpose(value) if reverse else value
    return data[..., 1:, :, :].sum(axis=(-1, -3))
