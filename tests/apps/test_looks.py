"""Pages look as they did when somebody last looked at them: small pictures, kept here.

They are compared at an eightieth of the page's size, so that another font does not matter, and a
part that is missing, moved or of another color does. After a change that is wanted, look at the
pages, remove the pictures and run this file once.
"""

import pytest
from helpers.explorer_page import moving, opened as report
from helpers.looks import SHARE, SIZE, differ, look

from tofrender.apps.explorer.page_contents import contents_of


@pytest.mark.parametrize("dark", [False, True])
def test_the_report(tmp_path, dark):
    viewport = {"width": SIZE[0], "height": SIZE[1]}
    with report(tmp_path, contents_of(moving()), dark=dark, viewport=viewport) as page:
        name = f"report_{'dark' if dark else 'light'}"
        assert differ(name, look(page)) < SHARE
        page.evaluate("document.querySelector('canvas.plot').style.visibility = 'hidden'")
        page.evaluate("document.querySelector('.tof-picture').style.filter = 'invert(1)'")
        assert differ(name, look(page)) > SHARE
