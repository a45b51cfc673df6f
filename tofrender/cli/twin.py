"""The command `tofrender twin`."""

from pathlib import Path
from typing import Annotated

from ..io.command_files import TWIN
from . import options as opt
from .answers import Json, answer

DRAWN = ("tall_block", "pyramid")  # Recordings with figures
OUTPUT_FLOATS = 1 << 18  # Size of the figures, in numbers of 4 bytes
HEADINGS = ("recording", "poses", "correlation", "of logarithms", "first peak", "< 10 mm", "counts")


def twin(
    source: Annotated[
        Path, opt.argument("FOLDER", "Copy of the data set github.com/uwgraphics/LCSPCData.")
    ],
    out: opt.Out,
    spp: Annotated[int, opt.setting("spp", default=None)] = 4,
    seed: opt.Seed = 0,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
    variant: opt.Variant = None,
    as_json: Json = False,
) -> None:
    """Compare the twin of a real sensor with the chip.

    The command renders each pose of four
    recordings, calibrates the sensor on 32 poses of tall_block, and compares rendered and measured
    counts of all other poses. It writes twin.json with all numbers, and figures of the histograms.

    Examples:
        tofrender twin LCSPCData --out twin
        tofrender twin LCSPCData --out twin --spp 16 --figure pdf
    """
    import json

    opt.check_out(out)
    opt.check_apart(out, source)
    opt.check_disk_space(out, OUTPUT_FLOATS)
    opt.activate(variant)

    from tofrender import io
    from tofrender.apps.twin.experiment import run_experiment
    from tofrender.apps.twin.figures import histogram_figure, residual_figure

    result = run_experiment(source, spp=spp, seed=seed)
    found = result.facts()
    files = [TWIN]
    written = {"made_by": "tofrender twin"} | found
    with io.output_folder(out, overwrite=True) as folder:
        (folder / TWIN).write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")
        for name in DRAWN:
            for kind, draw in (("histograms", histogram_figure), ("residuals", residual_figure)):
                file = f"{name}_{kind}.{figure}"
                io.save_figure(draw(result, name), folder / file, **opt.dots(dpi))
                files.append(file)

    # Print the table
    lines = [f"{out}: {', '.join(files[:3])} and {len(files) - 3} more"]
    lines.append("  ".join([f"{HEADINGS[0]:<18}", *(f"{each:>13}" for each in HEADINGS[1:])]))
    for name, each in result.table.items():
        cells = [
            str(each.poses),
            f"{each.correlation:.3f} / {each.correlation_p10:.3f}",
            f"{each.log_correlation:.3f} / {each.log_correlation_p10:.3f}",
            f"{1e3 * each.peak_error_m:.1f} mm",
            f"{each.peak_near:.1%}",
            f"{each.counts_near:.1%}",
        ]
        lines.append("  ".join([f"{name:<18}", *(f"{cell:>13}" for cell in cells)]))
    wrong = result.wrong_mesh.correlation
    lines.append(f"correlation with the mesh of another object: {wrong:.3f}")
    facts = {
        "out": str(out),
        "files": files,
        "source": str(source),
        "spp": spp,
        "seed": seed,
        "table": found["table"],
        "wrong_mesh_correlation": wrong,
        "later_scale": result.later_scale,
    }
    answer("twin", as_json, facts, lines)
