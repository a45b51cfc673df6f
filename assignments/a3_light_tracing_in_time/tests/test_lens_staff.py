"""a3.lens: windows that are not the whole film, in its middle."""

import pytest
from test_lens import SQUARE, WIDE, along, inside, points

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_lens


@pytest.mark.parametrize(
    "options",
    [WIDE | {"crop": (3, 1, 7, 3)}, SQUARE | {"shift": 0.2, "fov": 30.0}],
    ids=["cropped", "shifted"],
)
def test_shifted_and_cropped(submission, options):
    """A film of which a part is rendered, and one beside the axis."""
    view, d, came = along(submission, options)
    hint = "corner, extent, first and size of Window are those of the pixels that are rendered"
    expect.close(came["density"], view.density(d), "density of directions", rtol=1e-3, hint=hint)
    p, position, _ = points(view)
    came = submission.ask("lens_arrival", view=options, p=p)
    seen = inside(view, position)
    expect.close(came["position"].T[seen], position[seen], "position", atol=5e-3, hint=hint)
    expect.close(came["seen"], seen, "seen", hint=hint)
