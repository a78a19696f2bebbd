"""Labels of mixed accuracy: which are refined, what error the others state, and that it holds."""

import numpy as np
import pytest

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels import screening
from foldlab.labels.asked import Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import storable
from foldlab.labels.solver import SolverSource
from foldlab.labels.sources import make_source

LIGHT = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.25, "hinge_width": 1.0, "h_ratio": 5.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.2,
}  # fmt: skip
# Its hinge turns by about |g|π: within the coarse mesh's error of the threshold.
CLOSE = LIGHT | {"hinge_length": 0.046, "stiffness_to_weight": 100.0}
STATE = {"m1": 1.0, "m2": 0.0, "m3": 1.0, "m4": 1.0, "unstable": 0}
G = 0.1  # |g|π = 0.314
E = screening.COARSE_ERROR


def labels(design, *modes):
    made = [SolverSource(effort=Effort(refine=mode)).label(design) for mode in modes]
    return [label for label in made if storable(label).foldable == label.foldable]


def test_a_clear_answer_needs_no_second_mesh_and_keeps_the_error_it_states():
    quick, full = labels(LIGHT, "near", "always")
    assert quick.foldable is True and full.foldable is True
    assert quick.evidence["levels"] == 1 and full.evidence["levels"] > 1
    assert quick.evidence["error_basis"] == "calibrated"
    assert full.evidence["error_basis"] == "measured"
    assert quick.evidence["error_estimate"] == E
    assert quick.evidence["unknowns"] < full.evidence["unknowns"]
    off = abs(quick.evidence["m1"] - full.evidence["m1"]) / full.evidence["m1"]
    assert full.evidence["error_estimate"] < off < E


def test_near_a_threshold_the_label_is_that_of_the_accurate_source():
    coarse, quick, full = labels(CLOSE, "never", "near", "always")
    need = np.pi * CLOSE["contraction"]
    assert abs(coarse.evidence["m1"] / need - 1) < E
    assert coarse.foldable is None and coarse.evidence["outcome"] == "unresolved"
    assert f"m1 is {coarse.evidence['m1']:.3g} rad, {need:.3g} needed" in coarse.reason
    assert quick.evidence["error_basis"] == "measured" and quick.evidence["levels"] > 1
    for name in ("m1", "m2", "m3", "m4", "error_estimate", "outcome"):
        assert quick.evidence[name] == full.evidence[name]
    assert (quick.foldable, quick.reason) == (full.foldable, full.reason)


def test_a_full_turn_is_always_refined():
    (label,) = labels(
        LIGHT | {"contraction": 0.4, "hinge_length": 0.3, "stiffness_to_weight": 100.0}, "near"
    )
    assert "through a full turn" in label.reason
    assert label.evidence["levels"] > 1 and label.evidence["error_basis"] == "measured"


def test_the_bound_covers_the_coarse_mesh_on_designs_of_the_dataset():
    table = load_dataset("gravity-5k")
    ends = (table["contraction_reached"] / table["contraction"]).round(5) == 1
    table = table[ends & (table["growth"] == "uniaxial") & (table["error_estimate"] < 0.02)]
    rows = table.sample(8, random_state=3).to_dict("records")
    source, kept, slips = SolverSource(effort=Effort(refine="never")), [], []
    for row in rows:
        seen = source.run({name: row[name] for name in FULL.names}, 0).measures
        need = np.pi * row["contraction"]
        off = abs(seen["m1"] - row["m1"]) / max(abs(row["m1"]), need)
        kept.append(max(off, abs(seen["m2"] - row["m2"]) / need) <= E)
        slips.append(max(abs(seen[m] - row[m]) for m in ("m3", "m4")))
    assert sum(kept) >= 7  # 95 % are promised
    assert max(slips) <= screening.COARSE_SLIP


@pytest.mark.parametrize(
    "change, says",
    [
        ({}, []),
        ({"m1": 0.32}, ["m1"]),
        ({"m1": 0.28}, ["m1"]),
        ({"m1": 0.3142 * (1 + E) + 0.003}, ["m1"]),  # the error grows with m1 itself
        ({"m1": 0.2}, []),
        ({"m1": -1.0}, []),
        ({"m2": 0.16}, ["m2"]),
        ({"m2": 0.1571 + 0.31416 * E + 0.001}, []),
        ({"m2": 0.1571 + 0.31416 * E - 0.001}, ["m2"]),
        ({"m3": 0.9}, ["m3"]),
        ({"m4": 0.9005}, ["m4"]),
        ({"m4": 0.89}, []),
        ({"m1": 0.32, "m2": 0.16}, ["m1", "m2"]),
        ({"m1": 0.1, "m2": 0.16}, []),  # it won't fold, whatever m2 is
        ({"m1": 0.32, "m3": 0.5}, []),
    ],
)
def test_what_counts_as_near(change, says):
    measures = STATE | change
    errors = screening.coarse_errors(measures["m1"], G, Thresholds())
    phrases = screening.near(measures, G, Thresholds(), errors)
    assert [text[:2] for text in phrases] == says


@pytest.mark.parametrize(
    "change, happenings, closed, yes",
    [
        ({}, (), False, True),
        ({}, ("toppling",), False, True),
        ({}, ("toppling", "snap"), False, False),
        ({}, ("rocking",), False, False),
        ({}, (), True, False),
        ({"unstable": 1}, (), False, False),
        ({"unstable": None}, (), False, False),
        ({"m1": 0.32}, (), False, False),
    ],
)
def test_what_decides_a_label(change, happenings, closed, yes):
    design = LIGHT | {"contraction": G}
    assert screening.decided(design, STATE | change, happenings, closed, Thresholds()) is yes


def test_thick_sheets_are_refined_for_their_error_was_not_measured():
    thick = LIGHT | {"contraction": G, "slenderness": 0.031}
    assert not screening.decided(thick, STATE, (), False, Thresholds())


def test_versions_keep_such_labels_apart():
    modes = ("always", "near", "never")
    versions = {SolverSource(effort=Effort(refine=mode)).version for mode in modes}
    assert len(versions) == 3
    assert SolverSource().version in versions
    # Another bound is another label.
    assert f"{E:g}" in SolverSource(effort=Effort(refine="near")).version


@pytest.mark.parametrize(
    "settings",
    [
        {"growth": "isotropic"}, {"effects": "none"}, {"upright": False}, {"seed": 1},
        {"strips": 2}, {"barrier": "exponential"}, {"effects": "contact"},
        {"effects": "gravity,ground,contact"},
    ],
)  # fmt: skip
@pytest.mark.parametrize("mode", ["near", "never"])
def test_where_the_error_was_not_measured_it_is_not_stated(settings, mode):
    with pytest.raises(InputError, match="take 'always'"):
        make_source("solver", {"refine": mode, **settings})


def test_it_is_a_setting_of_the_source():
    assert make_source("solver", {"refine": "near"}).effort.refine == "near"
    with pytest.raises(InputError, match="'near'"):
        SolverSource(effort=Effort(refine="sometimes"))


@pytest.mark.parametrize(
    ("change", "closed", "growth", "yes"),
    [
        ({"m1": 0.1}, False, "uniaxial", True),  # does not fold
        ({"m1": 2.0}, False, "uniaxial", False),  # folds, and a finer mesh tells by how much
        ({"m1": 6.4}, True, "uniaxial", True),  # folds by a full turn
        ({"m1": 0.32}, False, "uniaxial", False),
        ({"m1": 0.32}, True, "uniaxial", False),
        ({"m1": 0.26}, False, "uniaxial", True),
        ({"m1": 0.26}, False, "isotropic", False),  # the mesh is further off
    ],
)
def test_the_coarsest_mesh_is_clear_of_what_does_not_fold_and_of_full_turns(
    change, closed, growth, yes
):
    assert screening.clear(STATE | change, G, Thresholds(), growth, closed) is yes
