"""Limits that tests lower, so that small work is done in several parts or without waiting."""

from typing import Any

PLACES = {
    # Rendering: samples of kernel launches, and sums in single precision
    "step_samples": ("integrators.passes.STEP_SAMPLES",),
    "first_samples": ("integrators.passes.FIRST_SAMPLES",),
    "lanes": ("integrators.passes.LANES",),
    "private_lanes": ("integrators.passes.PRIVATE_LANES",),
    "step_s": ("integrators.passes.STEP_S",),
    "few_paths": ("integrators.passes.FEW_PATHS",),
    "cuda_step": ("integrators.passes.CUDA_STEP",),
    "gradient_samples": ("integrators.derivatives.PASS_SAMPLES",),
    "max_added": (
        "films.histogram.MAX_ADDED",
        "films.recording.MAX_ADDED",
        "integrators.passes.MAX_ADDED",
        "rendering.job.MAX_ADDED",
    ),
    # Memory, and parts of large files
    "free_memory": ("runtime.memory.free_on_host()",),
    "available_memory": ("runtime.memory.available()",),
    "reserved_memory": ("runtime.memory.RESERVE",),
    "tile_bytes": ("rendering.tiling.TILE_BYTES",),
    "piece_bytes": ("rendering.cubes.PIECE_BYTES",),
    "view_bytes": ("rendering.cubes.VIEW_BYTES",),
    "memory_share": ("rendering.cubes.SHARE",),
    "block_bytes": ("rendering.stored_film.BLOCK_BYTES",),
    "array_bytes": ("runtime.archives.MOST_BYTES",),
    "moving_values": ("cli.moving.MAX_VALUES",),
    "spad_events": ("sensors.events.CHUNK",),
    "tone_samples": ("vis.tone._SAMPLES",),
    "player_frames": ("vis.animation._PLAYER_FRAMES",),
    "backprojected_pairs": ("nlos.reconstruction.backprojection._PAIRS_A_STEP",),
    "frame_digits": ("io.exr.LEAST_DIGITS",),
    # Tolerances
    "window_checks": ("rendering.time_window.CHECKS",),
    "scene_extent": ("scenes.checking.EXTENT",),
    "denoising_margin": ("denoising.filtering.MARGIN",),
    "judge_alpha": ("course.judge.expect.ALPHA",),
    # Waiting
    "bar_delay_s": ("runtime.progress.DELAY_S",),
    "child_timeout_s": ("runtime.child_processes.CODE_TIMEOUT_S",),
    "worker_patience": ("rendering.workers.PATIENCE",),
    "worker_least_wait_s": ("rendering.workers.LEAST_WAIT_S",),
    "worker_answer_s": ("rendering.workers.ANSWER_S",),
    "warp_answer_s": ("apps.warptest.warp_sources.ANSWER_S",),
    "page_written_s": ("apps.ui.page.WRITTEN_S",),
    # Submissions
    "unpacked_bytes": ("course.grade.unpacking.MAX_BYTES",),
    "judge_start_s": ("course.grade.grading.START_S",),
    "judge_written_bytes": ("course.judge.processes.MAX_WRITTEN",),
    "judge_least_files": ("course.judge.processes.LEAST_FILES",),
    "judge_report_bytes": ("course.judge.running.MAX_REPORT",),
    "judge_nominal_s": ("course.judge.speed.NOMINAL_S",),
}
"""Name of a limit -> its constants in `tofrender`, or a function that returns the limit."""


def lower(patch: Any, **limits: Any) -> None:
    """Change limits of the package until the end of the test or of the patch's context."""
    for name, value in limits.items():
        for place in PLACES[name]:
            constant = place.removesuffix("()")
            changed = value if constant == place else lambda value=value: value
            patch.setattr(f"tofrender.{constant}", changed)
