"""Names that a package lacks: the error names the right one."""

import pytest

import tofrender
from tofrender import sensors


@pytest.mark.parametrize(
    ("package", "name", "remedy"),
    [
        (tofrender, "Spad", "use tofrender.sensors.Spad"),
        (sensors, "render", "use tofrender.render"),
        (tofrender, "rendr", "did you mean tofrender.render?"),
        (tofrender, "gaussianpulse", "did you mean tofrender.GaussianPulse?"),
        (tofrender, "estimate_dpth", "did you mean tofrender.sensors.estimate_depth?"),
        (tofrender, "focus_emitter_at_relay_wall_pixel", "use focus_laser"),
    ],
)
def test_a_wrong_name_points_to_the_right_one(package, name, remedy):
    with pytest.raises(AttributeError) as error:
        getattr(package, name)
    assert remedy in str(error.value)


def test_a_name_like_none_gets_no_guess():
    for name in ("qqqqqq", "_rendr", "__wrapped__"):
        with pytest.raises(AttributeError, match=rf"has no attribute '{name}'$"):
            getattr(tofrender, name)
