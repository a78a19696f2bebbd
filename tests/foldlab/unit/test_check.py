"""A unit in millimetres and materials, and what is told of it."""

from dataclasses import replace

import numpy as np
import pytest

from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.foldability import Thresholds
from foldlab.labels.label import Label
from foldlab.labels.solver import SolverSource
from foldlab.materials import read_materials
from foldlab.quantities import numbers
from foldlab.unit import check
from foldlab.unit.sized import Sized, sized

TABLE = read_materials()
SIZES = numbers({
    "l_s": "40mm", "b_s": "10mm", "h_s": "0.1mm", "h_i": "0.2mm", "l_i": "10mm",
    "contraction": "20%",
})  # fmt: skip
STIFF = {"E_i": 3e7}
SOURCE = SolverSource(Conditions(), Effort(0.05))


def test_sizes_and_materials_make_the_groups():
    unit = sized(SIZES, TABLE, "PET", "SMP")
    g = unit.groups
    assert list(g) == FULL.names
    assert g["hinge_length"] == pytest.approx(0.25) and g["hinge_width"] == 1.0
    assert g["slenderness"] == pytest.approx(2.5e-3) and g["aspect"] == pytest.approx(0.25)
    # The middle of the ranges, of moduli the geometric one.
    assert unit.physical["E_s"] == pytest.approx((2.5e9 * 5e9) ** 0.5)
    assert unit.physical["rho_i"] == pytest.approx((1000 + 1250) / 2)
    weight = 1375 * 9.80665 * 0.04**3
    assert g["stiffness_to_weight"] == pytest.approx(unit.physical["E_s"] * 1e-8 / weight)
    assert set(unit.ranges) == {"E_s", "rho_s", "E_i", "rho_i"}
    assert unit.materials == {"passive": "polyester film", "active": "shape-memory polymer"}
    assert unit.strain["passive"] == (0.02, 0.04)


def test_a_hinge_follows_its_panels_only_where_it_was_as_wide():
    whole = sized(SIZES | STIFF, TABLE, "PET", "SMP")
    narrow = sized(SIZES | STIFF | {"b_i": 5e-3}, TABLE, "PET", "SMP")
    assert whole.changed(b_s=0.02).groups["hinge_width"] == 1.0
    assert narrow.changed(b_s=0.02).groups["hinge_width"] == pytest.approx(0.25)


def test_a_hinge_that_is_made_narrower_stays_so():
    unit = sized(SIZES | STIFF, TABLE, "PET", "SMP").changed(b_i=0.004)
    assert unit.physical["b_i"] == 0.004 and unit.groups["hinge_width"] == pytest.approx(0.4)


def test_what_is_given_wins_over_the_material():
    unit = sized(SIZES | STIFF, TABLE, "PET", "SMP")
    assert unit.physical["E_i"] == 3e7 and "E_i" not in unit.ranges
    unit = sized(SIZES | {"E_ratio": 0.01}, TABLE, "PET", "SMP")
    assert unit.physical["E_i"] == pytest.approx(0.01 * unit.physical["E_s"])
    free = {name: value for name, value in SIZES.items() if name != "contraction"}
    assert sized(free, TABLE, "PET", "SMP").ranges["contraction"] == (0.02, 0.50)


@pytest.mark.parametrize(
    "given, passive, words",
    [
        (SIZES, None, "lacks E_s, rho_s; add --set E_s=… or --passive MATERIAL"),
        (SIZES | {"E_s": 3e9}, None, r"lacks rho_s; add --set rho_s=… or --passive MATERIAL$"),
        ({"l_s": 0.1, "E_s": 3e9, "rho_s": 1e3}, None, r"lacks b_s, h_s, l_i, h_i; .*=…$"),
        (SIZES | {"h": 1.0}, "PET", "no quantity 'h'; there are E_s"),
        (SIZES | {"l_i": 0.05}, "PET", "l_i = 0.05 m is more than l_s = 0.04 m"),
        (SIZES | {"b_i": 0.02}, "PET", "b_i"),
        (SIZES | {"h_ratio": 3.0}, "PET", "h_ratio and h_i contradict"),
        (SIZES | {"h_i": 0.0}, "PET", "h_i = 0; expected a finite number above 0"),
        ({"slenderness": 0.01}, "PET", "needs its scales"),
        (SIZES, "SMP", "no passive material 'SMP'"),
    ],
)
def test_what_is_no_unit_is_told(given, passive, words):
    with pytest.raises(InputError, match=words):
        sized(given, TABLE, passive, "SMP")


def test_units_are_drawn_from_the_ranges_of_their_materials():
    unit = sized(SIZES, TABLE, "PET", "SMP")
    drawn = unit.drawn(64)
    assert drawn["hinge_length"].to_numpy() == pytest.approx(0.25)
    low, high = 0.5e6 / 5e9, 3e7 / 2.5e9
    assert drawn["E_ratio"].between(low, high).all()
    # Evenly on a logarithmic scale.
    middle = np.log(drawn["E_ratio"]).mean()
    assert middle == pytest.approx(np.log(unit.groups["E_ratio"]), abs=0.05)
    assert (drawn["rho_ratio"].std() > 0) and (unit.drawn(64) == drawn).all(axis=None)


def test_a_changed_unit_keeps_its_other_sizes_and_a_hinge_as_wide_as_its_panels():
    unit = sized(SIZES | STIFF, TABLE, "PET", "SMP")
    longer = unit.changed(l_s=0.08)
    assert longer.physical["l_i"] == 0.01 and longer.groups["hinge_length"] == pytest.approx(0.125)
    ratio = longer.groups["stiffness_to_weight"] / unit.groups["stiffness_to_weight"]
    assert ratio == pytest.approx(1 / 8)
    wider = unit.changed(b_s=0.02)
    assert wider.groups["hinge_width"] == 1.0 and wider.groups["aspect"] == pytest.approx(0.5)


def heavy() -> Sized:
    """A silicone sheet of 10 cm that stays on the ground."""
    given = numbers({
        "l_s": "100mm", "b_s": "25mm", "h_s": "1mm", "h_i": "1mm", "l_i": "20mm",
        "contraction": "20%", "E_s": "1MPa", "rho_s": 1000, "E_i": "0.3MPa", "rho_i": 1000,
    })  # fmt: skip
    return sized(given, TABLE)


def test_the_rod_finds_changes_that_fold_smallest_first():
    unit = heavy()
    assert check.by_rod(unit, SOURCE).foldable is False
    found = check.changes(unit, SOURCE)
    assert found
    sizes = [abs(np.log(change.factor)) for change in found]
    assert sizes == sorted(sizes)
    for change in found:
        assert change.value == pytest.approx(unit.physical[change.quantity] * change.factor)
        other = unit.changed(**{change.quantity: change.value})
        assert check.by_rod(other, SOURCE).foldable is True
        # A step less of it is not enough, or leaves less room than the rod's error.
        step = (check.FACTORS[1] / check.FACTORS[0]) ** np.sign(np.log(change.factor))
        less = check.by_rod(unit.changed(**{change.quantity: change.value / step}), SOURCE)
        assert not (less.foldable and less.evidence["margin"] > check.ROOM)


def test_a_small_increase_comes_before_a_large_decrease(monkeypatch):
    folds = Label({}, True, "", {"margin": 1.0})
    needed = {"h_i": 1.1, "h_s": 1 / 4.0, "l_i": 1 / 1.2}

    def scanned(unit, source, name, factors):
        up = factors[0] > 1
        return [(f, folds) for n, f in needed.items() if n == name and up == (f > 1)]

    monkeypatch.setattr(check, "_scanned", scanned)
    found = check.changes(heavy(), SOURCE)
    assert [c.quantity for c in found] == ["h_i", "l_i", "h_s"]


def test_a_change_is_told_only_where_the_solver_confirms_it(monkeypatch):
    unit = heavy()
    asked = []

    def label(self, design):
        asked.append(design)
        return Label(design, len(asked) == 2, "", {"m1": 1.0})

    monkeypatch.setattr(SolverSource, "label", label)
    second = check.changes(unit, SOURCE)[1]
    told = check.confirmed(unit, SOURCE)
    assert (told.quantity, told.value) == (second.quantity, second.value)
    assert asked[1] == unit.changed(**{told.quantity: told.value}).groups
    asked.clear()
    assert check.confirmed(unit, SOURCE, attempts=1) is None and len(asked) == 1


def test_what_holds_ends_where_the_rod_changes_its_mind():
    unit = sized(SIZES | STIFF, TABLE, "PET", "SMP")
    first = check.by_rod(unit, SOURCE).foldable
    ends = check.holds(unit, SOURCE)
    assert set(ends) == set(check.CHANGEABLE)
    told = 0
    for name, (low, high) in ends.items():
        for end in (low, high):
            if end is not None:
                label = check.by_rod(unit.changed(**{name: end}), SOURCE)
                assert label.foldable is not first
                told += 1
    assert told
    # No contraction beyond what any material does.
    assert ends["contraction"][1] is None


def test_what_the_materials_leave_open():
    unit = sized(SIZES, TABLE, "PET", "SMP")
    over = check.uncertainty(unit, SOURCE, 60)
    assert over["draws"] == 60 > over["by_formula"] > 0
    # The answer for the materials' middle lies among those for their ranges.
    assert over["angle_low"] < check.by_rod(unit, SOURCE).evidence["m1"] < over["angle_high"]
    strict = replace(SOURCE, thresholds=Thresholds(need=2.0))
    assert check.uncertainty(unit, strict, 60)["folds"] < over["folds"]
    assert check.uncertainty(sized(SIZES | {
        "E_s": 3e9, "rho_s": 1380.0, "E_i": 3e7, "rho_i": 1100.0,
    }, TABLE), SOURCE) is None  # fmt: skip


def test_draws_near_the_threshold_count_too():
    unit = sized(SIZES, TABLE, "PET", "SMP")
    over = check.uncertainty(unit, SOURCE, 60)
    middle = (over["angle_low"] + over["angle_high"]) / 2
    near = replace(SOURCE, thresholds=Thresholds(need=middle))
    again = check.uncertainty(unit, near, 60)
    assert again["draws"] == over["draws"] and 0.1 < again["folds"] < 0.9
    assert (again["angle_low"], again["angle_high"]) == (over["angle_low"], over["angle_high"])


def test_what_the_rod_does_not_know_is_judged_by_formulas(monkeypatch):
    unit = sized(SIZES, TABLE, "PET", "SMP")
    some = replace(check.by_rod(unit, SOURCE), foldable=True, evidence={"m1": 9.0})
    labels = [some] * 40 + [replace(some, foldable=None), None] * 10
    monkeypatch.setattr(check, "_labels", lambda rod, designs: labels)
    over = check.uncertainty(unit, SOURCE, 60)
    rest = unit.drawn(60).iloc[40:]
    net = beam.formulas(rest)["net"].to_numpy()
    assert (over["draws"], over["by_formula"]) == (60, 20)
    assert over["folds"] == pytest.approx((40 + (net > 1).sum()) / 60)
    angles = np.append(np.full(40, 9.0), net * np.pi * rest["contraction"].to_numpy())
    # A fold ends at a full turn; 9 rad is beyond it.
    angles = angles.clip(-np.pi, 2 * np.pi)
    assert over["angle_low"] == pytest.approx(np.quantile(angles, 0.05))
    assert over["angle_high"] == 2 * np.pi
    # Another need is another count of what folds.
    strict = replace(SOURCE, thresholds=Thresholds(need=1e9))
    assert check.uncertainty(unit, strict, 60)["folds"] == pytest.approx(40 / 60)


def test_without_a_rod_nothing_is_scanned():
    unit = sized(SIZES | STIFF, TABLE, "PET", "SMP")
    source = SolverSource(Conditions(growth="isotropic"))
    assert check.by_rod(unit, source) is None and check.uncertainty(unit, source) is None
    assert check.holds(unit, source) is None and check.changes(unit, source) == []


@pytest.mark.parametrize(
    "peak, error, says",
    [(0.01, 0.1, "bears it"), (0.019, 0.1, "may break"), (0.03, 0.1, "may break"),
     (0.041, 0.1, "may break"), (0.05, 0.1, "breaks")],
)  # fmt: skip
def test_peak_strains_are_held_against_what_the_material_bears(peak, error, says):
    unit = sized(SIZES, TABLE, "PET", "SMP")
    evidence = {"strain": {"passive": peak}, "peak_errors": {"strain": {"passive": error}}}
    row = check.strained(unit, evidence)["passive"]
    assert row["says"] == says and (row["low"], row["high"]) == (0.02, 0.04)
    bare = replace(unit, strain={})
    assert check.strained(bare, evidence)["passive"]["says"] is None
