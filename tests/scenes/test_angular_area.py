"""The emitter `angulararea`, and names of mitransient in `mi.load_file`."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.refusals import refused

import tofrender

HEIGHT, SIDE = 1.5, 0.6
SCENE = """<scene version="3.0.0"><integrator type="transient_prbvolpath"/>
<sensor type="orthographic"><transform name="to_world"><scale value="0.9"/>
<lookat origin="0, 0, 1" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="transient_hdr_film"><integer name="width" value="8"/><integer name="height" value="8"/>
<integer name="temporal_bins" value="8"/><float name="bin_width_opl" value="1"/>
<rfilter type="box"/></film>
<sampler type="independent"><integer name="sample_count" value="4096"/></sampler></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="3"/></transform></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.3"/>
<rotate x="1" angle="180"/><translate z="1.5"/></transform><emitter type="angulararea">
<rgb name="radiance" value="1, 2, 3"/><float name="cutoff_angle" value="35"/>
<float name="beam_width" value="20"/></emitter></shape></scene>"""


def on_floor(x: np.ndarray, y: np.ndarray, cutoff=35.0, beam=20.0) -> np.ndarray:
    """Radiance of a floor of albedo 1/2 below the lamp of radiance 1: 1/(2π) ∫ cos² / d² dA."""
    u = (np.arange(128) + 0.5) / 128 * SIDE - SIDE / 2
    r2 = (x[..., None, None] - u) ** 2 + (y[..., None, None] - u[:, None]) ** 2
    cos = HEIGHT / np.sqrt(r2 + HEIGHT**2)
    falloff = np.clip((cutoff - np.degrees(np.arccos(cos))) / (cutoff - beam), 0, 1)
    return (falloff * cos**4).mean((-2, -1)) * SIDE**2 / HEIGHT**2 / (2 * np.pi)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "lamp.xml"
    path.write_text(SCENE)
    return path


@pytest.mark.statistical
@pytest.mark.parametrize("kind", ["transient_path", "path_tracer_nee", "path_tracer_mats"])
def test_the_floor_is_lit_by_its_closed_form(file, kind):
    """Emitter samples, hits of the lamp, and both; each of 64 pixels within 5 standard errors."""
    settings = {"integrator": kind, "max_depth": 2, "errors": True, "progress": False}
    found = tofrender.render(file, spp=1024, **settings)
    fine = (np.arange(64) + 0.5) / 64 * 1.8 - 0.9  # Each pixel by 8 x 8 points
    pixels = on_floor(*np.meshgrid(fine, fine)).reshape(8, 8, 8, 8).mean((1, 3))
    for channel, radiance in enumerate((1, 2, 3)):
        light, noise = (found[n].values[..., channel] for n in ("steady", "steady_error"))
        off = np.abs(light - radiance * pixels)
        assert (off <= 5 * noise + 1e-3 * radiance * pixels.max()).all()
    assert pixels.min() < 0.2 * pixels.max()


def test_mitsuba_loads_files_of_mitransient(file):
    scene = mi.load_file(str(file))
    integrator = scene.integrator()
    assert type(integrator) is tofrender.TransientVolpath
    assert integrator.max_depth == 6
    steady, transient = mi.render(scene, spp=16)
    np.testing.assert_allclose(np.array(transient).sum(2), steady, rtol=1e-4)
    deep = mi.load_dict({"type": "transient_prbvolpath", "max_depth": 3})
    assert deep.max_depth == 3
    assert any("radiance" in name for name in mi.traverse(scene).keys())  # noqa: SIM118


@pytest.mark.parametrize("kind", ["transient_light_tracer", "transient_bdpt"])
def test_paths_do_not_start_at_it(file, kind):
    file.write_text(
        SCENE.replace("orthographic", "perspective").replace('<scale value="0.9"/>', "")
    )
    with refused("are not supported. Use point, spot"):
        tofrender.render(file, integrator=kind, spp=1, progress=False)


def test_beams_wider_than_their_cone_are_refused():
    lamp = {"type": "angulararea", "cutoff_angle": 20.0, "beam_width": 30.0}
    with refused("beam_width = 30.0: must be"):
        tofrender.load_scene({"type": "scene", "lamp": {"type": "rectangle", "emitter": lamp}})
