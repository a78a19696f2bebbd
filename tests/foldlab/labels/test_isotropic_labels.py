"""Isotropic labels that no finer mesh confirms: which of them say no all the same."""

from dataclasses import replace

import numpy as np
import pytest

from foldlab.labels import screening
from foldlab.labels.asked import Changing, Conditions, Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.solver import SolverSource
from foldlab.labels.verdict import curled_away

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
HASTY = SolverSource(conditions=Conditions(growth="isotropic"))
SOURCE = replace(HASTY, effort=Effort(whole=True))
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


def test_a_path_ends_where_it_has_curled_for_good_unless_all_of_it_is_asked_for():
    design = CURLS | {"hinge_width": 1.0}
    whole, label = SOURCE.label(design), HASTY.label(design)
    assert whole.evidence["contraction_reached"] == pytest.approx(CURLS["contraction"])
    assert label.foldable is whole.foldable is False
    assert label.evidence["outcome"] == whole.evidence["outcome"] == "curled"
    assert label.evidence["contraction_reached"] < 0.95 * CURLS["contraction"]
    assert label.evidence["steps"] < whole.evidence["steps"] and label.evidence["levels"] == 1
    assert "it was not followed beyond" in label.reason
    states = whole.evidence["history"][: label.evidence["steps"]]
    assert label.evidence["history"] == states
    # At the state before it had not.
    g = CURLS["contraction"]
    away = [curled_away({"m1": m1, "m2": m2}, g, Thresholds()) for _, m1, m2 in states]
    assert away == [False] * (len(away) - 1) + [True]


def test_a_path_that_curls_for_good_in_its_last_state_came_to_its_end():
    label, whole = HASTY.label(CURLS), SOURCE.label(CURLS)
    assert label.evidence["error_basis"] == "measured" and label.reason == whole.reason
    assert label.evidence["m2"] == whole.evidence["m2"]


@pytest.mark.parametrize(
    "changes, hasty",
    [
        ({}, True),
        ({"effort": Effort(whole=True)}, False),
        ({"conditions": Conditions()}, False),
        ({"thresholds": Thresholds(across=0.4)}, False),
        ({"changing": Changing(active_stiffness=1.01)}, False),
    ],
)
def test_haste_is_for_labels_that_the_rule_was_measured_on_and_stands_in_the_version(
    changes, hasty
):
    assert replace(HASTY, **changes).version.endswith("-hasty") is hasty


@pytest.mark.parametrize(
    "source, design",
    [
        (SOURCE, FOLDS),
        (replace(SOURCE, changing=Changing(active_stiffness=1.01)), CURLS),
        (SolverSource(), FOLDS),
    ],
    ids=["it folds", "another material", "uniaxial"],
)
def test_where_the_verdict_may_hang_on_it_the_path_is_followed_on_the_finer_mesh(
    monkeypatch, source, design
):
    _, paths, thoroughly = unconfirmed(monkeypatch, source, design)
    assert paths[:2] == [0, 1] and thoroughly[0] is True


def test_a_fold_by_a_full_turn_needs_no_finer_mesh(monkeypatch):
    design = FOLDS | {"slenderness": 4e-3, "stiffness_to_weight": 1.0}
    label, paths, thoroughly = unconfirmed(monkeypatch, SolverSource(), design)
    assert label.foldable is True and label.evidence["m1"] >= 2 * np.pi
    assert paths == [0] and thoroughly == [False]
    assert label.evidence["error_basis"] == "calibrated"


FLAT = {"m2": 0.0, "m3": 1.0, "m4": 1.0}
TURNED = {"m1": 6.4, **FLAT}


@pytest.mark.parametrize(
    "measures, growth, closed, yes",
    [
        (FLAT | {"m1": 0.24}, "isotropic", False, True),
        (FLAT | {"m1": 0.26}, "isotropic", False, False),
        (FLAT | {"m1": 0.26}, "uniaxial", False, True),
        (FLAT | {"m1": -1.0}, "isotropic", False, True),
        (FLAT | {"m1": 1.0}, "isotropic", False, False),
        (FLAT | {"m1": 1.0, "m2": 0.27}, "isotropic", False, False),
        (FLAT | {"m1": 1.0, "m2": 0.29}, "isotropic", False, True),
        (FLAT | {"m1": 1.0, "m3": 0.8}, "isotropic", False, True),
        (TURNED, "isotropic", True, True),
        (TURNED | {"m2": 0.02}, "isotropic", True, True),
        (TURNED | {"m2": 0.04}, "isotropic", True, False),
        (TURNED | {"m2": 0.04}, "uniaxial", True, True),
        (TURNED | {"m2": 0.13}, "uniaxial", True, False),
        (TURNED | {"m2": 0.29}, "isotropic", True, True),
        (TURNED | {"m2": 3.2}, "isotropic", True, True),
        (TURNED | {"m2": 0.16, "m4": 0.9005}, "uniaxial", True, False),
    ],
)
def test_what_is_clear_by_more_than_the_coarsest_mesh_is_off(measures, growth, closed, yes):
    assert screening.clear(measures, G, Thresholds(), growth, closed) is yes
