"""Isotropic labels that no finer mesh confirms: which of them say no all the same."""

from dataclasses import replace

import numpy as np
import pytest

from foldlab.labels import screening
from foldlab.labels.asked import Changing, Conditions
from foldlab.labels.foldability import Thresholds
from foldlab.labels.solver import SolverSource

CURLS = {
    "E_ratio": 0.829, "rho_ratio": 3.03, "hinge_length": 0.197, "hinge_width": 0.651,
    "h_ratio": 6.89, "stiffness_to_weight": 9.16, "aspect": 0.672, "slenderness": 0.0168,
    "contraction": 0.118,
}  # fmt: skip
FOLDS = {
    "E_ratio": 0.302, "rho_ratio": 0.245, "hinge_length": 0.235, "hinge_width": 0.705,
    "h_ratio": 2.42, "stiffness_to_weight": 0.34, "aspect": 0.0607, "slenderness": 0.0204,
    "contraction": 0.326,
}  # fmt: skip
SOURCE = SolverSource(conditions=Conditions(growth="isotropic"))
G = 0.1  # |g|π = 0.314


def unconfirmed(monkeypatch, source, design):
    """The label where no state of a finer mesh is near, and the levels whose paths it followed."""
    paths, thoroughly, run = [], [], SolverSource.run

    def followed(self, groups, level=1, **limits):
        paths.append(level)
        return run(self, groups, level, **limits)

    def refined(self, run, level, deadline, thorough=True):
        thoroughly.append(thorough)

    monkeypatch.setattr(SolverSource, "run", followed)
    monkeypatch.setattr(SolverSource, "_refined", refined)
    return source.label(design), paths, thoroughly


def test_a_unit_that_curls_far_too_much_does_not_fold_whatever_the_finer_mesh_says(monkeypatch):
    sure = SOURCE.label(CURLS)
    assert sure.foldable is False and sure.evidence["error_basis"] == "measured"
    label, paths, thoroughly = unconfirmed(monkeypatch, SOURCE, CURLS)
    assert label.foldable is False and label.evidence["outcome"] == sure.evidence["outcome"]
    assert paths == [0] and thoroughly == [False]
    assert "no finer mesh confirmed it" in label.reason
    assert label.evidence["error_basis"] == "calibrated" and label.evidence["levels"] == 1
    need, m1 = np.pi * CURLS["contraction"], label.evidence["m1"]
    along, across = screening.ISOTROPIC_ERRORS
    assert label.evidence["error_m1"] == pytest.approx(along * max(abs(m1), need))
    assert label.evidence["error_m2"] == pytest.approx(across * need)
    assert abs(label.evidence["m2"] - sure.evidence["m2"]) < label.evidence["error_m2"]


@pytest.mark.parametrize(
    "source, design",
    [
        (SOURCE, FOLDS),
        (replace(SOURCE, changing=Changing(active_stiffness=1.01)), CURLS),
        (SolverSource(), FOLDS | {"contraction": 0.1}),
    ],
    ids=["it folds", "another material", "uniaxial"],
)
def test_where_the_verdict_may_hang_on_it_the_path_is_followed_on_the_finer_mesh(
    monkeypatch, source, design
):
    _, paths, thoroughly = unconfirmed(monkeypatch, source, design)
    assert paths[:2] == [0, 1] and thoroughly[0] is True


@pytest.mark.parametrize(
    "change, yes",
    [
        ({"m1": 0.24, "m2": 0.0}, True),
        ({"m1": 0.26, "m2": 0.0}, False),
        ({"m1": -1.0, "m2": 0.0}, True),
        ({"m1": 1.0, "m2": 0.27}, False),
        ({"m1": 1.0, "m2": 0.29}, True),
        ({"m1": 6.4, "m2": 0.29}, True),
    ],
)
def test_what_misses_a_fold_by_more_than_the_coarsest_mesh_is_off(change, yes):
    assert screening.refused(change, G, Thresholds()) is yes
