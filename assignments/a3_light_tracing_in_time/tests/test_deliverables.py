"""a3.deliverables."""

import pytest

pytestmark = pytest.mark.a3_deliverables
