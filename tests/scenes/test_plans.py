"""Plans of scenes: outlines, cameras and lights from above and from the side."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.nlos import ALL, WALLS, WITH_WALL, builder, stands_alone
from helpers.scenes import refusal

import tofrender
from tofrender.vis.plans import plan_figure


@pytest.mark.parametrize("view", ["above", "side"])
@pytest.mark.parametrize("name", ALL)
def test_plans_show_wall_hidden_shapes_and_laser(name, view):
    scene = tofrender.load_scene(builder(name), optimize=False)
    figure = plan_figure(scene, view=view, title=name)
    axes = figure.axes[0]
    assert axes.get_title() == name
    assert axes.get_xlabel() == ("x [m]" if view == "above" else "z [m]")
    legend = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"camera", "laser", *(["relay wall", "hidden"] if name in WITH_WALL else [])} <= legend
    across, depth = (axes.get_xlim(), axes.get_ylim())[:: 1 if view == "above" else -1]
    wall = {**dict.fromkeys(WALLS, (0, 2)), "ourbox_confocal": (-0.5, 0.9)}.get(name, (-2, 4))
    assert depth[0] < wall[0] < depth[1]
    assert wall[1] < across[1] - across[0] < 2.5 * wall[1]
    figure.canvas.draw()  # warns, and so fails, where parts do not fit
    assert len(np.unique(np.asarray(figure.canvas.buffer_rgba()))) > 20
    for width in (4.0, 6.4):
        figure.set_size_inches(width, 0.75 * width)
        figure.canvas.draw()
        legend = figure.legends[0].get_window_extent()
        assert legend.x0 >= 0
        assert legend.x1 <= figure.bbox.x1


def test_plan_of_a_camera_draws_what_it_sees():
    scene = stands_alone(builder("wall_box_behind"))
    wedge = next(p for p in plan_figure(scene).axes[0].patches if p.get_alpha() == 0.18).get_xy()
    np.testing.assert_allclose(wedge[0], [0, 0], atol=2e-3)
    edge = 2 * np.tan(np.deg2rad(22.5))
    np.testing.assert_allclose(abs(wedge[1:66, 0]).max(), edge, rtol=0.01)
    np.testing.assert_allclose(wedge[1:66, 1], -2, atol=1e-3)


def test_bad_plans_are_one_line():
    assert "scene = {}: must be an mi" in refusal(plan_figure, {})
    scene = stands_alone(builder("wall_box_behind"))
    assert "view = 'top': must be one of above, side" in refusal(plan_figure, scene, view="top")
    assert "laser = [0, 1]: must be 3 finite numbers" in refusal(plan_figure, scene, laser=[0, 1])
    assert "scene: a plan needs shapes" in refusal(plan_figure, mi.load_dict({"type": "scene"}))


def laser(figure) -> np.ndarray:
    """Where the star is."""
    line = next(each for each in figure.axes[0].lines if each.get_label() == "laser")
    return np.ravel(line.get_xydata())


def test_the_laser_of_a_confocal_integrator():
    described = builder("wall_box_behind")
    scene = tofrender.load_scene(described, optimize=False)
    assert laser(plan_figure(scene)) == pytest.approx([0, 0], abs=1e-5)
    assert laser(plan_figure(scene, laser=[1, 2, 3])) == pytest.approx([1, 3])
    frame = mi.ScalarTransform4f().look_at([0.5, 0, -1], [0, 0, -2], [0, 1, 0])
    projector = described["integrator"]["confocal_projector"]
    projector = projector | {"is_confocal": False, "frame": frame}
    described["integrator"] = described["integrator"] | {"confocal_projector": projector}
    scene = tofrender.load_scene(described, optimize=False)
    assert laser(plan_figure(scene)) == pytest.approx([0.5, -1], abs=1e-5)
    with pytest.raises(StopIteration):
        laser(plan_figure(stands_alone(builder("wall_box_behind"))))
