"""The warp tester: warps, shapes and lights to look at, and their chi-square tests.

`subjects` lists these subjects. `sources` contains their functions, from this package or a user.
`probes` calls the user's functions in a separate process. `engine` draws and tests, and `window`
is the page.
"""

import atexit
from typing import Any

from ...runtime import checks

__all__ = ["warptest"]


def warptest(subject: str = "tent", *, module: Any = None, **parameters: Any) -> Any:
    """Open the interactive warp tester in a notebook.

    The tester draws warped points and the grid of the unit square, and tests samples against the
    density. A user's module runs in a separate process, with the protection of the judge. The
    module is loaded again when its file changes. The command `tofrender warptest` opens the tester
    in a browser.

    Args:
        subject: First subject, a name in `tofrender.apps.warptest.subjects.SUBJECTS`: "tent",
            "uniform_disk", "uniform_sphere", "uniform_hemisphere", "cosine_hemisphere", "beckmann",
            "hierarchical", "no_op"; "triangle", "sphere_cap"; "quad_light", "triangle_light",
            "sphere_light", "two_lights".
        module: A user's Python file, or folder of files, with functions of the course. By
            default the working folder in a student edition without all subjects, otherwise None.
        **parameters: Parameters of the subject: `alpha` of "beckmann", `image` of "hierarchical" (a
            path, a bitmap or an array), `apex`, `cos_theta_max`, `distance`.

    Returns:
        A component of Panel, which a notebook shows.

    Raises:
        ValueError: A name, a module or a parameter is wrong.
        RuntimeError: Panel is not installed.

    Example:
        >>> tester = warptest("beckmann", alpha=0.5)
        >>> type(tester).__name__
        'Tester'
    """
    make, _ = application(subject, module=module, **parameters)
    import panel as pn

    if not pn.extension._loaded:
        pn.extension(inline=True)
    return make()


def application(subject: str = "tent", *, module: Any = None, **parameters: Any) -> tuple[Any, Any]:
    """Return a function that makes the page of a reader, and the engine of all readers."""
    from ..ui.serving import require_panel
    from .subjects import SUBJECTS

    values = SUBJECTS[checks.one_of("subject", subject, SUBJECTS)].values(parameters)
    given = {name: values[name] for name in parameters}
    require_panel()

    from .engine import Engine
    from .tester import Tester

    engine = Engine(module)
    atexit.register(engine.close)
    return lambda: Tester(engine, subject, given), engine
