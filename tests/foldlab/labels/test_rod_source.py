"""Labels from the rod: as the solver's where it decides, and refusals of what it cannot feel."""

import json
import pickle

import numpy as np
import pandas as pd
import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL, PATTERNED, REDUCED
from foldlab.errors import InputError
from foldlab.labels.label import LabelSource, storable
from foldlab.labels.sources import make_source

LIGHT = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 5.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.2,
}  # fmt: skip
HEAVY = LIGHT | {"stiffness_to_weight": 0.01, "hinge_length": 0.1, "contraction": 0.1}


def labelled(design, **settings):
    label = make_source("rod", settings).label(design)
    kept = storable(label)
    assert kept.foldable == label.foldable  # nothing in the evidence that a store refuses
    json.dumps(dict(kept.evidence), allow_nan=False)
    return label


def test_light_units_fold_and_heavy_ones_stay():
    light, heavy = labelled(LIGHT), labelled(HEAVY)
    assert light.foldable is True and light.evidence["outcome"] == "folds"
    assert [event["kind"] for event in light.evidence["events"]] == ["lift-off"]
    assert light.evidence["steady"] and light.evidence["topples"]
    assert heavy.foldable is False and heavy.evidence["outcome"] == "grounded"
    assert "panels never left the ground" in heavy.reason
    assert light.evidence["margin"] > 0 > heavy.evidence["margin"]
    # What no weight holds down folds too.
    assert labelled(HEAVY, effects="none").foldable is True


def test_labels_are_the_solvers_and_errors_cover():
    """The solver's own labels of designs of the full space, shipped as a dataset."""
    table = load_dataset("gravity-5k")
    table = table[(table["growth"] == "uniaxial") & table["foldable"].notna()].iloc[1000:1400]
    labels = make_source("rod").label_many(table)
    found = pd.array([label.foldable for label in labels], dtype="boolean")
    truth = pd.array(table["foldable"], dtype="boolean")
    known = ~found.isna()
    assert np.mean(known) > 0.93
    assert np.mean(found[known] == truth[known]) > 0.99
    all_of_them = make_source("rod", {"sure": False}).label_many(table)
    decided = pd.array([label.foldable for label in all_of_them], dtype="boolean")
    assert not decided.isna().any() and np.mean(decided == truth) > 0.98
    m1 = np.array([label.evidence["m1"] for label in labels])
    error = np.array([label.evidence["error_estimate"] for label in labels])
    scale = np.maximum(np.abs(m1), np.pi * table["contraction"])
    off = np.abs(m1 - table["m1"]) / scale
    assert np.mean(off <= error) > 0.93
    assert np.median(off) < 0.01


def test_what_is_near_its_threshold_is_unknown():
    design = LIGHT | {"stiffness_to_weight": 100.0}
    angles = {}
    for length in np.linspace(0.01, 0.08, 8):
        label = labelled(design | {"hinge_length": float(length)})
        angles[label.foldable] = label
    assert set(angles) == {True, False, None}
    near = angles[None]
    assert near.evidence["outcome"] == "unresolved" and "needed, and the rod's error" in near.reason


def test_the_rod_is_unsure_within_its_error_on_either_side_of_the_threshold():
    design = LIGHT | {"stiffness_to_weight": 100.0, "hinge_length": 0.04}
    seen = labelled(design).evidence
    error = seen["error_estimate"] * np.pi * design["contraction"]
    verdicts = [
        labelled(design, need=seen["m1"] + off * error).foldable for off in (-1.5, -0.5, 0.5, 1.5)
    ]
    assert verdicts == [True, None, None, False]


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"growth": "isotropic"}, "growth 'isotropic'"),
        ({"effects": "gravity,ground,contact"}, "effects 'gravity,ground,contact'"),
        ({"strips": 3}, "3 strips"),
        ({"upright": False}, "upright=false"),
        ({"barrier": "exponential"}, "barrier 'exponential'"),
    ],
)
def test_what_a_rod_cannot_feel_is_refused(settings, message):
    with pytest.raises(InputError, match=f"{message}.* take --source solver"):
        make_source("rod", settings)


def test_designs_that_are_no_rod_are_refused():
    with pytest.raises(InputError, match=r"no rod: E_ratio = 5000; the rod knows"):
        make_source("rod").label(LIGHT | {"E_ratio": 5000.0})
    with pytest.raises(InputError, match="sample with --space full"):
        make_source("rod", space=REDUCED)
    with pytest.raises(InputError, match="the patterned space have strips"):
        make_source("rod", space=PATTERNED)


def test_a_source_has_a_version_per_setting_and_travels():
    source = make_source("rod", space=FULL)
    assert isinstance(source, LabelSource) and hasattr(source, "label_many")
    versions = {
        make_source("rod", settings).version
        for settings in ({}, {"effects": "none"}, {"sure": False})
    }
    assert len(versions) == 3
    assert pickle.loads(pickle.dumps(source)) == source
