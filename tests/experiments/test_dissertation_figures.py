"""What the comparison with the dissertation's figures measures on its own."""

import pytest

from experiments import dissertation_figures as figures


def test_bending_is_that_of_the_hinge_and_about_the_axis_that_it_bends_about():
    design = figures.TABLE_41 | {"contraction": 0.05}
    run, _ = figures._path(figures.Config(), design, effects="none")
    larger, other, off = figures._bending(run)
    # Without curling the turning within the hinge is curvature times length.
    assert larger == pytest.approx(run.history[-1]["hinge"] / 0.2, rel=0.01)
    assert abs(other) < 1e-2 * larger and off < 1
