"""The tests that the three path tracers share."""

from __future__ import annotations

from cases_staff import compare, long_paths, materials, several_lights

from tofrender.course.judge import expect


def lights(submission, name):
    """Several lamps, a shadow, nothing, a back, a lane that is not active."""
    case = several_lights(submission.random)
    came = case.ask(submission, name, lanes=4096)
    hint = "sum over all emitters; shadows; lengths start at `origin`, where that is given"
    compare(came, case, hint, most=0.06)
    expect.true(came["extra"] == 0, f"AOVs that sample returns: none; came {came['extra']}")


def surfaces(submission, name):
    """Mirrors, rough metal, plastic, mixtures, glass, both sides, under a panel."""
    random = submission.random
    case = materials(random)
    came = case.ask(submission, name, lanes=4096, max_depth=int(random.integers(2, 6)))
    hint = (
        "the material's own eval, sample and pdf; MIS weight 1 for a hit after a sampled mirror "
        "direction (sampled_type); backs are black but for a two-sided material"
    )
    compare(came, case, hint, most=0.035)


def bounces(submission, name):
    """Paths of many bounces, with Russian roulette that begins early, late, or as by default."""
    random = submission.random
    for options, deepest in (
        ({"max_depth": 20, "rr_depth": int(random.integers(1, 5))}, 20),
        ({}, 8),
    ):
        case = long_paths(random, deepest)
        came = case.ask(submission, name, seeds=8, lanes=8192, **options)
        hint = f"Σ ρⁿ I / (π R²) over {deepest - 1} bounces; what survives is divided by its chance"
        compare(came, case, hint, most=0.015)
    case = long_paths(random, 18)
    came = case.ask(
        submission, name, lanes=512, seeds=2, max_depth=18, rr_depth=30, after=12 * case.radius
    )
    share = came["late"].min()
    what = f"paths that reach 17 bounces if rr_depth = 30: all of them; came {100 * share:.0f} %"
    expect.true(share > 0.9, what, hint="roulette may end a path from the vertex rr_depth on")
