"""A whole small assignment for tests of what releases, starts, verifies and submits one."""

import json
from itertools import starmap
from pathlib import Path
from textwrap import dedent

from helpers import tiny_assignment
from tofrender.course.assignments import Assignment

AREA = "test_pulse.py::test_area"
FALL_OFF = "test_pulse.py::test_fall_off"
RANGES = ["test_range.py::test_range", "test_range_staff.py::test_any_frequency"]
NORM = " / (self.width_opl * 2.50662827)"
MUTANTS = (
    ("no_norm", "pulse", NORM, "", [AREA, "test_pulse.py::test_peak", *RANGES], "sqrt(2 pi)"),
    ("no_half", "pulse", "-0.5 * x * x", "-x * x", [AREA, FALL_OFF], "half the square"),
    ("there_and_back", "range", "0.5 *", "1.0 *", RANGES, "back"),
    ("quarter", "range", "0.5 *", "0.25 *", RANGES, "back"),
)


def _mutant(name: str, problem: str, old: str, new: str, fails: list[str], says: str) -> str:
    file = "pulse.py" if problem == "pulse" else "wrapping.py"
    texts = {"id": name, "problem": f"a0.{problem}", "file": file, "why": f"It is {name}."}
    content = texts | {"edits": [[old, new]], "fails": fails, "says": says}
    return "[[mutant]]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in content.items())


FILES = {
    "README.md": "# Tiny\n\n[[a0.pulse]]\n\nText.\n\n[[a0.range]]\n![One dot](figures/one.png)\n",
    "exercises.md": "# Exercises\n",
    "solutions/exercises.md": "# Solutions\n",
    "figures/make.py": "print('makes one.png')\n",
    "figures/one.png": "a picture",
    "pytest.ini": tiny_assignment.FILES["pytest.ini"],
    "rubric.toml": """
        [assignment]
        id = "a0"
        title = "Tiny"
        comparisons = 10
        also_withhold = ["tofrender.nlos.light.confocal"]
        submit = ["*.py", "notebook.ipynb", "deliverables/*"]

        [[problem]]
        id = "a0.pulse"
        title = "A pulse"
        file = "pulse.py"
        names = ["GaussianPulse"]
        withholds = ["tofrender.signals.pulses"]
        tests = [
          { id = "test_pulse.py::test_area", points = 2 },
          { id = "test_pulse.py::test_fall_off", points = 1 },
          { id = "test_pulse.py::test_peak", points = 1 },
          { id = "test_pulse_staff.py::test_even", points = 1.5, visibility = "after_published" },
        ]

        [[problem]]
        id = "a0.range"
        title = "The range"
        file = "wrapping.py"
        names = ["unambiguous_range"]
        reference = "tofrender.analysis"
        withholds = ["tofrender.analysis.unwrapping"]
        needs = ["a0.pulse"]
        bonus = true
        tests = [
          { id = "test_range.py::test_range", points = 3 },
          { id = "test_range.py::test_results", points = 1 },
          { id = "test_range_staff.py::test_any_frequency", points = 0, visibility = "hidden" },
        ]
        """,
    "mutants.toml": "".join(starmap(_mutant, MUTANTS)),
    "contracts.toml": """
        [[contract]]
        problem = "a0.pulse"
        says = "A Gaussian of standard deviation `width_opl` [m]."
        tests = ["test_pulse.py::test_fall_off", "test_pulse_staff.py::test_even"]
        mutants = ["no_half"]

        [[contract]]
        problem = "a0.range"
        says = "In meters."
        tests = ["test_range.py::test_range"]
        mutants = ["quarter"]

        [[remark]]
        problem = "a0.pulse"
        says = ["A pulse."]

        [[remark]]
        problem = "a0.range"
        says = ["The range."]
        """,
    "starter/pulse.py": '''
        """A pulse."""


        class GaussianPulse:
            """A Gaussian of standard deviation `width_opl` [m]."""

            def __init__(self, width_opl):
                raise NotImplementedError("a0.pulse: write GaussianPulse")
        ''',
    "solutions/pulse.py": '''
        """A pulse."""

        import drjit as dr


        class GaussianPulse:
            """A Gaussian of standard deviation `width_opl` [m]."""

            def __init__(self, width_opl):
                self.width_opl = width_opl

            def eval(self, t):
                """The density at t [m]."""
                x = t / self.width_opl
                return dr.exp(-0.5 * x * x) / (self.width_opl * 2.50662827)
        ''',
    "starter/wrapping.py": '''
        """The range."""


        def unambiguous_range(frequency_hz):
            """In meters."""
            raise NotImplementedError("a0.range: write unambiguous_range")
        ''',
    "solutions/wrapping.py": '''
        """The range."""

        from pulse import GaussianPulse


        def unambiguous_range(frequency_hz):
            """In meters."""
            one = GaussianPulse(width_opl=1.0).eval(0.0) * 2.50662827
            return 0.5 * 299792458.0 / frequency_hz * one
        ''',
    "tests/probes.py": """
        import mitsuba as mi
        import numpy as np


        def density(theirs, width_opl, t):
            return theirs.GaussianPulse(width_opl=width_opl).eval(mi.Float(t))


        def peaks(theirs, seed):
            noise = 0.01 * np.random.default_rng(seed).standard_normal(16)
            return theirs.GaussianPulse(width_opl=1.0).eval(mi.Float(0)).numpy() + noise


        def wrap(theirs, frequency_hz):
            return theirs.unambiguous_range(frequency_hz)
        """,
    "tests/test_pulse.py": """
        def test_area(submission):
            'The density integrates to one.'
            t = np.linspace(-0.5, 0.5, 1001)
            density = submission.ask("density", width_opl=0.05, t=t)
            area = np.trapezoid(density, t)
            expect.close(area, 1.0, "the area", hint="is 1 / (sqrt(2 pi) sigma) there?")


        @pytest.mark.parametrize("width", [0.1, 0.2])
        def test_fall_off(submission, width):
            density = submission.ask("density", width_opl=width, t=np.array([0.0, width]))
            ratio = density[1] / density[0]
            expect.close(ratio, np.exp(-0.5), "the fall-off", hint="is it half the square?")


        def test_peak(submission):
            peaks = submission.ask("peaks", seed=submission.seed)
            expect.estimate(peaks, 0.39894228, "the peak")
        """,
    "tests/test_pulse_staff.py": """
        def test_even(submission):
            t = submission.random.uniform(0.05, 0.2)
            left, right = submission.ask("density", width_opl=0.3, t=np.array([-t, t]))
            expect.close(left, right, "the density at -t")
        """,
    "tests/test_range.py": """
        def test_range(submission):
            came = submission.ask("wrap", frequency_hz=100e6)
            expect.close(came, 1.49896229, "the range", hint="light goes there and back")


        def test_results(submission):
            expect.close(submission.arrays("deliverables/x.npz")["x"], [1.0, 2.0], "x")
        """,
    "tests/test_range_staff.py": """
        def test_any_frequency(submission):
            f = submission.random.uniform(1e7, 1e8)
            came = submission.ask("wrap", frequency_hz=f)
            expect.close(came, 149896229.0 / f, "the range")
        """,
    "notebook.py": """
        # %% [markdown]
        # # Tiny

        # %%
        # %load_ext tofrender.course.student
        from pathlib import Path

        import numpy as np

        # %% [solution] pulse.py

        # %% [solution] wrapping.py

        # %%
        from wrapping import unambiguous_range

        print(round(unambiguous_range(100e6), 3))
        Path("deliverables").mkdir(exist_ok=True)
        np.savez("deliverables/x.npz", x=[1.0, 2.0])
        """,
}

RUBRIC, PULSE = (dedent(FILES[name]).lstrip() for name in ("rubric.toml", "solutions/pulse.py"))
RANGE = "def unambiguous_range(frequency_hz):\n    return 149896229.0 / frequency_hz\n"


def write(folder: Path) -> Assignment:
    texts = {name: dedent(text).lstrip() for name, text in FILES.items()}
    for problem in ("pulse", "range"):
        for name in (f"tests/test_{problem}.py", f"tests/test_{problem}_staff.py"):
            texts[name] = tiny_assignment.HEAD.format(problem) + texts[name]
    return Assignment(tiny_assignment.write(folder, texts))


def changed(folder: Path, name: str, *changes: tuple[str, str]) -> None:
    """Change the first place of each text in a file of an assignment."""
    text = (folder / name).read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / name).write_text(text)


def write_submission(folder: Path, pulse: str | None = PULSE, wrapping: str = RANGE) -> Path:
    """A submission in a new folder; a pulse.py whose text is None is missing."""
    files = {} if pulse is None else {"pulse.py": pulse}
    return tiny_assignment.write(folder, files | {"wrapping.py": wrapping})
