"""States along a path as labels at smaller contractions."""

import json

import numpy as np
import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels.foldability import Thresholds
from foldlab.labels.screening import COARSE_ERROR
from foldlab.learning.along import states_as_labels

NEED = np.pi * 0.1  # at a contraction of 0.1


def paths(*histories, growth="uniaxial", m3=1.0):
    """A table with one path per history, indexed from 10 on."""
    table = FULL.sample(len(histories), seed=0).assign(
        contraction=0.3, growth=growth, m3=m3, m4=1.0, history=[json.dumps(h) for h in histories]
    )
    return table.set_index(np.arange(len(histories)) + 10)


def test_states_inside_the_space_that_the_mesh_leaves_no_doubt_of_are_labels():
    path = [
        [0.0, 0.0, 0.0],
        [0.5 * FULL["contraction"].low, 1.0, 0.0],  # below the space
        [0.1, NEED * 1.3, 0.0],
        [0.1, NEED / 1.3, 0.0],
        [0.1, NEED * (1 + COARSE_ERROR) * 1.01 / 1.1, 0.0],  # within the mesh's error
        [0.1, NEED * (1 - 0.9 * COARSE_ERROR), 0.0],  # and on its other side
        [0.1, NEED * 2, NEED],  # curled
        [0.1, NEED * 2, NEED / 2],  # at the threshold of curling
        [0.3, 3.0, 0.0],  # the label itself
    ]
    table = paths(path, [[0.0, 0.0, 0.0], [0.3, 0.1, 0.0]])
    states = states_as_labels(table)
    assert states["foldable"].tolist() == [True, False, False]
    assert states["m1"].tolist() == pytest.approx([NEED * 1.3, NEED / 1.3, NEED * 2])
    assert states["m2"].tolist() == pytest.approx([0, 0, NEED])
    assert (states["fold_angle"] == states["m1"]).all() and set(states["growth"]) == {"uniaxial"}
    assert (states["contraction"] == 0.1).all() and (states["of"] == 10).all()
    assert states["normalised_angle"].tolist() == pytest.approx((states["m1"] / 0.1).tolist())
    others = [name for name in FULL.names if name != "contraction"]
    assert (states[others] == table[others].iloc[[0, 0, 0]].to_numpy()).all(axis=None)
    # Under isotropic contraction the coarsest mesh is further off.
    assert len(states_as_labels(paths(path[:3] + path[-1:], growth="isotropic"))) == 1
    closer = [path[0], [0.1, NEED * 1.18, 0.0], path[-1]]
    assert len(states_as_labels(paths(closer))) == 1
    assert len(states_as_labels(paths(closer, growth="isotropic"))) == 0


def test_other_thresholds_give_other_labels():
    table = paths([[0.0, 0.0, 0.0], [0.1, 1.0, 0.0], [0.3, 3.0, 0.0]])
    assert states_as_labels(table)["foldable"].tolist() == [True]
    assert states_as_labels(table, Thresholds(need=1.57))["foldable"].tolist() == [False]


def test_paths_that_lost_a_symmetry_and_labels_without_a_path_give_none():
    path = [[0.0, 0.0, 0.0], [0.1, 1.0, 0.0], [0.3, 3.0, 0.0]]
    assert len(states_as_labels(paths(path, m3=0.8))) == 0
    empty = states_as_labels(paths(path).assign(history=None))
    assert len(empty) == 0 and {*FULL.names, "foldable", "of"} <= set(empty)
    with pytest.raises(InputError, match="no history, m3: states are known of labels of the so"):
        states_as_labels(paths(path).drop(columns=["history", "m3"]))


def test_states_of_the_dataset_agree_with_labels_that_were_made_at_their_contraction():
    """The nearest label in all groups says the same as the state, nine times in ten."""
    table = load_dataset("gravity-5k", growth="uniaxial")
    states = states_as_labels(table)
    assert len(states) > 3 * len(table) and 0.3 < states["foldable"].mean() < 0.7
    FULL.validate(states)
    known = table[table["foldable"].notna()].reset_index()
    units = FULL.to_unit(known[FULL.names])
    some = states.sample(400, random_state=0)
    points = FULL.to_unit(some[FULL.names])
    agree = []
    for point, of, foldable in zip(points, some["of"], some["foldable"], strict=True):
        far = ((units - point) ** 2).sum(axis=1) + 9.0 * (known["index"] == of)
        agree.append(known["foldable"].iloc[int(far.argmin())] == foldable)
    assert np.mean(agree) > 0.75
