"""The pattern of contraction of the neural tube, against its formula at places chosen by hand."""

import numpy as np
import pytest

from solver.cases.tissue.neural_tube import Shape


def place(shape, x, angle, r):
    return np.array([x * shape.length, -r * np.cos(angle), r * np.sin(angle)])


def test_strength_rises_smoothly_from_the_posterior_end_to_the_other():
    shape = Shape(posterior=0.2)
    inner = 1 - shape.thickness / 2
    along = [shape.beta(place(shape, x, shape.peak, inner)) for x in (0.0, 0.25, 0.5, 0.75, 1.0)]
    # Smoothstep 3x² − 2x³: 0, 5/32, 1/2, 27/32, 1.
    assert along == pytest.approx([0.2 + 0.8 * s for s in (0, 5 / 32, 0.5, 27 / 32, 1)])


def test_it_peaks_on_both_folds_and_vanishes_on_the_outside():
    shape = Shape()
    inner, outer = 1 - shape.thickness / 2, 1 + shape.thickness / 2
    for side in (1, -1):
        assert shape.beta(place(shape, 1, side * shape.peak, inner)) == pytest.approx(1.0)
        off = side * (shape.peak + shape.angle)
        assert shape.beta(place(shape, 1, off, inner)) == pytest.approx(np.exp(-1))
        assert shape.beta(place(shape, 1, side * shape.peak, outer)) == pytest.approx(0.0)
        assert shape.beta(place(shape, 1, side * shape.peak, 1.0)) == pytest.approx(0.5)
