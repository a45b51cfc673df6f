import pytest, tracers_staff as t, time
import numpy as np
pytestmark = pytest.mark.a2_time_gated
@pytest.mark.parametrize("name", ["TimeGatedTransientPath","AMCWTransientPath","TransientPath"])
@pytest.mark.parametrize("what", ["lights","surfaces","bounces"])
def test_x(submission, name, what):
    getattr(t, what)(submission, name)
