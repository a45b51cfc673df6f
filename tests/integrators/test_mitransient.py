"""Exchange with mitransient: each one's integrator on the other's film, and the plugins' names."""

import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers.peer_scenes import give_names_back
from helpers.support import largest, with_sampler

import tofrender
from tofrender.runtime import plugins
from tofrender.scenes import cornell_box_glass


@pytest.fixture
def theirs(monkeypatch):
    """Their package, imported, with the check for its own film's class switched off."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mitransient
        from mitransient.integrators.common import TransientADIntegrator

    monkeypatch.setattr(TransientADIntegrator, "check_transient_", lambda *_: None)
    yield mitransient
    give_names_back()


def properties(name: str, values: dict) -> mi.Properties:
    props = mi.Properties(name)
    for key, value in values.items():
        props[key] = value
    return props


FILM = {"width": 8, "height": 8, "temporal_bins": 300, "start_opl": 3.5, "bin_width_opl": 0.05}


def picture(package, film_package, spp: int = 64, rfilter: str = "box", **more) -> tuple:
    """The glass scene by one package's integrator on the other's film: (steady, transient)."""
    from mitransient.films.transient_hdr_film import TransientHDRFilm as TheirFilm
    from mitransient.integrators.transientpath import TransientPath as TheirPath

    film_class = tofrender.TransientHDRFilm if film_package is tofrender else TheirFilm
    path_class = tofrender.TransientPath if package is tofrender else TheirPath
    film = film_class(
        properties("transient_hdr_film", FILM | {"rfilter": mi.load_dict({"type": rfilter})})
    )
    integrator = path_class(properties("transient_path", {"max_depth": 8} | more))
    described = with_sampler(cornell_box_glass(width=8, height=8))
    described["sensor"] = described["sensor"] | {"film": film}
    described["integrator"] = integrator
    scene = mi.load_dict(described, parallel=False)
    return tuple(np.array(t, dtype=np.float64) for t in mi.render(scene, spp=spp, seed=3))


def test_their_integrator_on_our_film(theirs):
    on_theirs = picture(theirs, theirs)
    on_ours = picture(theirs, tofrender)
    assert on_ours[1].shape == on_theirs[1].shape == (8, 8, 300, 3)
    assert on_theirs[1].max() > 0
    assert largest(on_ours[0], on_theirs[0]) < 1e-3  # their steady film holds half floats
    assert largest(on_ours[1], on_theirs[1]) < 1e-5


@pytest.mark.usefixtures("mitsubas_steps")
@pytest.mark.parametrize("more", [{}, {"pulse_width_opl": 0.1}], ids=["", "pulse"])
def test_our_integrator_on_their_film(theirs, more):
    on_ours = picture(tofrender, tofrender, **more)
    on_theirs = picture(tofrender, theirs, **more)
    assert on_ours[1].max() > 0
    assert largest(on_theirs[0], on_ours[0]) < 1e-3
    assert largest(on_theirs[1], on_ours[1]) < 1e-5


@pytest.mark.usefixtures("mitsubas_steps")
def test_both_integrators_see_the_same(theirs):
    """Same random numbers, so the same paths; their lengths are 1 mm short at the near plane.

    Roulette is off: theirs starts one vertex later.
    """
    ours = picture(tofrender, tofrender, rr_depth=100)
    other = picture(theirs, theirs, rr_depth=100)
    assert largest(other[0], ours[0]) < 1e-3
    coarse = [t[1].reshape(8, 8, 15, 20, 3).sum(axis=(0, 1, 3)) for t in (ours, other)]
    assert coarse[1] == pytest.approx(coarse[0], rel=0.05, abs=0.01 * coarse[0].max())


def test_classes_stay_usable(theirs):
    """Whoever the names belong to, both classes can be made, ours by a name of their own too."""
    from mitransient.integrators.transientpath import TransientPath as TheirPath

    mi.register_integrator("transient_path", lambda props: TheirPath(props))
    assert type(mi.load_dict({"type": "transient_path"})) is TheirPath
    ours = mi.load_dict({"type": "tofrender_transient_path", "pulse_width_opl": 0.1})
    assert type(ours) is tofrender.TransientPath
    assert ours.pulse.width_opl == pytest.approx(0.1)
    film = mi.load_dict({"type": plugins.qualified_name("transient_hdr_film")})
    assert type(film) is tofrender.TransientHDRFilm


PROGRAM = """
import warnings
warnings.simplefilter("ignore")
import mitsuba as mi
{imports}
for variant in {variants}:
    mi.set_variant(variant)
film = mi.load_dict({{"type": "transient_hdr_film"}})
path = mi.load_dict({{"type": "transient_path"}})
import tofrender
from tofrender import TransientPath, TransientHDRFilm
print(type(film).__module__.split(".")[0], type(path).__module__.split(".")[0],
      TransientPath.__module__, TransientHDRFilm.__module__)
"""


def owner(imports: str, variants=()) -> list[str]:
    program = PROGRAM.format(imports=imports, variants=list(variants))
    options = {"capture_output": True, "text": True, "check": False}
    done = subprocess.run([sys.executable, "-c", program], cwd=Path(__file__).parents[2], **options)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


OURS = ["tofrender.integrators.transient_path", "tofrender.films.transient"]


@pytest.mark.parametrize("variants", [(), ("llvm_ad_mono", "llvm_ad_rgb")], ids=["", "switched"])
def test_names_belong_to_the_package_imported_last(variants):
    """Also through a switch of variants, there and back."""
    assert owner("import tofrender, mitransient", variants) == ["mitransient"] * 2 + OURS
    ours_last = "mi.set_variant('llvm_ad_rgb')\nimport mitransient, tofrender"
    assert owner(ours_last, variants) == ["tofrender"] * 2 + OURS
