"""Calibration of the TMF8820 on a quarter of one recording, and its test on all others."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...fitting.calibration import Calibration, calibrate
from ...runtime.progress import ProgressBar
from ...sensors.multi_zone import MultiZone
from ...signals.pulses import KnotPulse
from .agreement import Agreement, agreement, correlations
from .recordings import FILES, PARTS, ChipRecording, load_recording, training_poses

TRAINED = "tall_block"
OTHER_MESH = "pyramid"  # Recording with the mesh for the control with a wrong scene
LATER_SESSION = ("pyramid", "pyramid_random")
"""Recordings with another unit of counts, which has one common scale."""

FITTED_BINS = (5, 80)
KNOTS_BINS = (-1.2, -0.6, 0.0, 0.6, 1.2, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0, 30.0)
FIRST_BIN_WIDTH_OPL = 0.028
FIRST_ZERO_BIN = 12.0


@dataclass(frozen=True, eq=False)
class Experiment:
    """Results of the experiment.

    Args:
        calibration: The calibrated sensor.
        measured: Measured counts of each recording.
        expected: Expected counts of each recording, in its unit of counts.
        held_out: Which poses of each recording were not fitted.
        table: Agreement of each recording on these poses.
        controls: Correlations of each recording with fitted histograms, see `_controls`.
        wrong_mesh: Agreement on the first recording if the other object is rendered.
        later_scale: Counts of the later session over counts of the first session.
    """

    calibration: Calibration
    measured: dict[str, np.ndarray]
    expected: dict[str, np.ndarray]
    held_out: dict[str, np.ndarray]
    table: dict[str, Agreement]
    controls: dict[str, dict[str, float]]
    wrong_mesh: Agreement
    later_scale: float

    def facts(self) -> dict[str, Any]:
        """Return the numbers as plain values, for JSON."""
        found = self.calibration
        values = zip(
            found.values["parameter"].values.tolist(),
            found.values.values.tolist(),
            found.standard_errors.values.tolist(),
            strict=True,
        )
        return {
            "table": [{"recording": name, **asdict(each)} for name, each in self.table.items()],
            "controls": self.controls,
            "wrong_mesh": asdict(self.wrong_mesh),
            "later_scale": self.later_scale,
            "parameters": {
                name: {"value": value, "standard_error": error if np.isfinite(error) else None}
                for name, value, error in values
            },
            "most_correlated": found.most_correlated(),
            "chi_square": found.chi_square,
        }


def uncalibrated(preset: MultiZone) -> MultiZone:
    """Return the sensor as its data sheet describes it: equal zones, and a guess of the pulse."""
    knots = np.array(KNOTS_BINS)
    guess = np.where(
        knots < 0, np.exp(3.5 * knots), np.exp(-knots / 1.5) + 0.2 * np.exp(-knots / 5)
    )
    zones = len(preset.gains)
    return replace(
        preset,
        gains=np.ones(zones),
        starts_opl=np.full(zones, -FIRST_ZERO_BIN * FIRST_BIN_WIDTH_OPL),
        floors=np.zeros(zones),
        pulse=KnotPulse(knots * FIRST_BIN_WIDTH_OPL, guess),
        bin_width_opl=FIRST_BIN_WIDTH_OPL,
        blur=0.02,
        shift=(0.0, 0.0),
        scale=(1.0, 1.0),
        crosstalk=0.01,
    )


def run_experiment(folder: Path, *, size: int = 12, spp: int = 4, seed: int = 0) -> Experiment:
    """Render all recordings, calibrate the sensor, and compare histograms."""
    recordings = {name: load_recording(folder, name) for name in FILES}
    trained = recordings[TRAINED]
    with ProgressBar("Rendering parts", len(PARTS) * (len(FILES) + 1)) as bar:
        views = {
            name: each.render(size=size, spp=spp, seed=seed, step=bar.update)
            for name, each in recordings.items()
        }
        wrong = trained.render(
            recordings[OTHER_MESH], size=size, spp=spp, seed=seed, step=bar.update
        )

    # Calibrate on some poses of one recording
    fitted = training_poses(len(trained.poses))
    parts = {name: view.isel(pose=fitted) for name, view in views[TRAINED].items()}
    first, last = FITTED_BINS
    found = calibrate(
        uncalibrated(MultiZone.preset("tmf8820")),
        parts,
        trained.counts[fitted],
        first_bin=first,
        last_bin=last,
    )

    # Predict all recordings. The later session has one scale of counts, fitted to all of its counts
    expected = {name: predicted(found, view) for name, view in views.items()}
    later = [recordings[name].counts.sum() / expected[name].sum() for name in LATER_SESSION]
    scale = float(np.mean(later))
    for name in LATER_SESSION:
        expected[name] = expected[name] * scale

    # Compare with the poses that were not fitted
    held_out = {name: np.ones(len(each.poses), bool) for name, each in recordings.items()}
    held_out[TRAINED] = ~fitted
    measured = {name: each.counts for name, each in recordings.items()}
    depth = found.sensor.bin_width_opl / 2
    chosen = {name: (expected[name][held], measured[name][held]) for name, held in held_out.items()}
    return Experiment(
        calibration=found,
        measured=measured,
        expected=expected,
        held_out=held_out,
        table={name: agreement(*pair, depth) for name, pair in chosen.items()},
        controls={
            name: _controls(trained, fitted, recordings[name], held)
            for name, held in held_out.items()
        },
        wrong_mesh=agreement(predicted(found, wrong)[~fitted], measured[TRAINED][~fitted], depth),
        later_scale=scale,
    )


def predicted(found: Calibration, parts: dict[str, xr.Dataset]) -> np.ndarray:
    """Return the counts that a calibrated sensor expects of parts of a scene."""
    light = sum(found.albedos[name] * parts[name]["transient"] for name in parts)
    view = next(iter(parts.values())).assign(transient=light)
    return found.sensor.expected(view)["counts"].values


def _controls(
    trained: ChipRecording, fitted: np.ndarray, recording: ChipRecording, held: np.ndarray
) -> dict[str, float]:
    """Return the median correlation with the mean of the fitted histograms, and with the nearest.

    The nearest fitted pose has the smallest difference of position [m] and viewing direction.
    """
    known = trained.counts[fitted]
    measured = recording.counts[held]
    flat = measured.reshape(len(measured), -1)
    mean = np.broadcast_to(known.mean(axis=0).ravel(), flat.shape)

    def places(poses: np.ndarray) -> np.ndarray:
        return np.concatenate([poses[:, :3, 3], poses[:, :3, 2]], axis=1)

    apart = places(recording.poses[held])[:, None] - places(trained.poses[fitted])
    nearest = np.linalg.norm(apart, axis=-1).argmin(axis=1)
    near = known[nearest].reshape(len(measured), -1)
    return {
        "mean": float(np.median(correlations(mean, flat))),
        "nearest": float(np.median(correlations(near, flat))),
    }
