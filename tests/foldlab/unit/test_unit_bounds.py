"""A unit of materials, its changes and the advice on it, at the bounds where they turn."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from foldlab.cli.outputs import trouble
from foldlab.design import STANDARD_GRAVITY
from foldlab.errors import InputError
from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.label import Label
from foldlab.labels.solver import SolverSource
from foldlab.labels.timoshenko import fold_angle, lift_off_stiffness, weight_turning
from foldlab.materials import read_materials
from foldlab.unit import check, why
from foldlab.unit.sized import sized

SIZES = {
    "l_s": 0.04, "b_s": 0.01, "h_s": 1e-4, "h_i": 2e-4, "l_i": 0.01, "contraction": 0.25,
    "E_s": 3e9, "rho_s": 1380.0, "E_i": 3e7, "rho_i": 1100.0,
}  # fmt: skip
OWN = """\
name,role,E_low,E_high,rho_low,rho_high,contraction_low,contraction_high,strain_low,strain_high
gel,active,1e6,4e6,1000,1400,0.1,0.3,,
slate,passive,2e9,2e9,1200,1200,,,0.02,0.04
"""
TABLE = read_materials()
SOURCE = SolverSource(Conditions(), Effort(0.05))


@pytest.fixture
def table(tmp_path):
    """The shipped materials and two of one's own."""
    (tmp_path / "own.csv").write_text(OWN)
    return read_materials(tmp_path / "own.csv")


# -- sizes -----------------------------------------------------------------------------------------


def bare(*names):
    return {name: value for name, value in SIZES.items() if name not in names}


def test_a_material_gives_the_middle_of_what_it_leaves_open_and_the_rest_exactly(table):
    given = bare("E_s", "rho_s", "E_i", "rho_i", "contraction")
    unit = sized(given, table, "slate", "gel")
    middle = {"E_s": 2e9, "rho_s": 1200.0, "E_i": 2e6, "rho_i": 1200.0, "contraction": 0.2}
    assert {name: unit.physical[name] for name in middle} == pytest.approx(middle)
    assert unit.ranges == {"E_i": (1e6, 4e6), "rho_i": (1000, 1400), "contraction": (0.1, 0.3)}
    assert unit.strain == {"passive": (0.02, 0.04)}
    assert unit.physical["g_earth"] == STANDARD_GRAVITY
    drawn = unit.drawn(400)
    for group, (low, high), log in (
        ("E_ratio", (5e-4, 2e-3), True), ("rho_ratio", (1 / 1.2, 1.4 / 1.2), False),
        ("contraction", (0.1, 0.3), False),
    ):  # fmt: skip
        values, ends = drawn[group], np.array([low, high])
        at = np.log(values / low) / np.log(high / low) if log else (values - low) / np.ptp(ends)
        # One in each of as many equal parts.
        assert (np.sort(np.floor(400 * at)) == np.arange(400)).all()
    assert drawn["hinge_length"].to_numpy() == pytest.approx(0.25)
    assert drawn["h_ratio"].to_numpy() == pytest.approx(2.0)


@pytest.mark.parametrize(("off", "fits"), [(1e-7, True), (1e-5, False)])
def test_a_group_beside_its_quantity_has_to_say_the_same(off, fits):
    given = SIZES | {"h_ratio": 2.0 * (1 + off)}
    if fits:
        assert sized(given, TABLE).groups["h_ratio"] == pytest.approx(2.0)
    else:
        with pytest.raises(
            InputError, match=r"h_ratio and h_i contradict each other: h_i = 0\.000"
        ):
            sized(given, TABLE)


@pytest.mark.parametrize(("part", "whole"), [("l_i", "l_s"), ("b_i", "b_s")])
def test_a_hinge_may_be_as_large_as_its_sheet(part, whole):
    assert sized(SIZES | {part: SIZES[whole]}, TABLE).physical[part] == SIZES[whole]
    with pytest.raises(InputError, match=f"{part} = .* is more than {whole}"):
        sized(SIZES | {part: 1.001 * SIZES[whole]}, TABLE)


# -- changes ---------------------------------------------------------------------------------------

UNIT = sized(SIZES, TABLE)


@pytest.mark.parametrize(("margin", "found"), [(check.ROOM, False), (1.001 * check.ROOM, True)])
def test_a_change_has_to_leave_room_for_the_rod_s_error(margin, found, monkeypatch):
    label = Label({}, True, "", {"margin": margin})

    def scanned(unit, source, name, factors):
        return [(1.1, label)] if name == "h_i" and factors[0] > 1 else []

    monkeypatch.setattr(check, "_scanned", scanned)
    assert [c.quantity for c in check.changes(UNIT, SOURCE)] == ["h_i"] * found


def test_units_are_scanned_as_far_as_they_are_units():
    def factors(name, *given):
        return [f for f, _ in check._scanned(UNIT, SOURCE, name, given)]

    # No material contracts by more than a half.
    assert factors("contraction", 1.5, 2.0, 2.001, 1.1) == [1.5, 2.0]
    assert factors("l_i", 2.0, 4.001, 1.1) == [2.0]
    assert check.FACTORS[0] == 1.05 and check.FACTORS[-1] == pytest.approx(10)


def test_what_stays_ends_at_the_first_value_that_changes_it(monkeypatch):
    folds, not_ = Label({}, True, ""), Label({}, False, "")
    monkeypatch.setattr(check, "by_rod", lambda *_: folds)

    def scanned(unit, source, name, factors):
        up = factors[0] > 1
        if name == "h_i":
            return [(1.1, folds), (1.2, not_), (1.3, not_), (1.4, folds)] if up else [(0.9, folds)]
        return [(0.8, Label({}, None, ""))] if name == "l_s" and not up else []

    monkeypatch.setattr(check, "_scanned", scanned)
    ends = check.holds(UNIT, SOURCE)
    assert ends["h_i"] == [None, pytest.approx(1.2 * 2e-4)]
    assert ends["l_s"] == [pytest.approx(0.8 * 0.04), None] and ends["h_s"] == [None, None]
    monkeypatch.setattr(check, "by_rod", lambda *_: Label({}, None, ""))
    assert check.holds(UNIT, SOURCE) is None


def test_nine_of_ten_units_turn_by_what_lies_between_the_ends(table, monkeypatch):
    unit = sized(bare("E_i"), table, None, "gel")
    labels = [Label({}, k >= 25, "", {"m1": k / 20}) for k in range(101)]
    monkeypatch.setattr(check, "_labels", lambda rod, designs: labels[: len(designs)])
    over = check.uncertainty(unit, SOURCE, 101)
    assert (over["angle_low"], over["angle_high"]) == pytest.approx((0.25, 4.75))
    assert over["folds"] == pytest.approx(76 / 101) and over["draws"] == 101
    assert over["ranges"] == {"E_i": [1e6, 4e6]}
    assert over["by_formula"] == 0
    # No unit turns by more than a full turn, nor hangs down further than panels do.
    labels = [Label({}, True, "", {"m1": k - 50.0}) for k in range(101)]
    over = check.uncertainty(unit, SOURCE, 101)
    assert (over["angle_low"], over["angle_high"]) == pytest.approx((-np.pi, 2 * np.pi))


@pytest.mark.parametrize(
    ("peak", "error", "says"),
    [
        (0.016, 0.25, "may break"), (0.0159, 0.25, "bears it"), (0.05, 0.25, "may break"),
        (0.0541, 0.25, "breaks"), (0.0153, None, "bears it"), (0.0155, None, "may break"),
        (0.0571, None, "may break"), (0.0573, None, "breaks"),
    ],
)  # fmt: skip
def test_what_a_material_bears_is_judged_with_the_error_of_the_peak(peak, error, says):
    unit = replace(UNIT, strain={"passive": (0.02, 0.04)})
    errors = None if error is None else {"strain": {"passive": error}}
    row = check.strained(unit, {"strain": {"passive": peak}, "peak_errors": errors})["passive"]
    assert row["says"] == says and row["peak"] == peak
    # Where only one mesh is known, as when it is asked what breaks.
    assert row["error"] == (0.3 if error is None else error)


# -- advice ----------------------------------------------------------------------------------------

DESIGN = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.2, "hinge_width": 1.0, "h_ratio": 5.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.25,
}  # fmt: skip


def advised(source, *, m1=2.0, rows=None, events=(), mirrors=("x", "y"), end=0.4, ends=(), **more):
    rows = rows or [{"m1": m1, "m2": 0.0, "hinge": m1, "contraction": 0.25}]
    curves = np.zeros((4, 10, 3))

    def shape(y):
        here = curves.copy()
        here[0, -1, 1] = y
        return SimpleNamespace(state=SimpleNamespace(curves=here))

    last = shape(end).state
    model = SimpleNamespace(mirrors=mirrors)
    run = SimpleNamespace(
        history=rows, folding=SimpleNamespace(last=last, model=model),
        shapes=[shape(y) for y in ends or [end] * len(rows)],
    )  # fmt: skip
    evidence = {"m1": m1, "events": list(events), "outcome": "folds", "topples": False} | more
    foldable = evidence.pop("foldable", True)
    without = evidence.pop("without", ())
    return why.advise(Label(DESIGN, foldable, "", evidence), run, source, without)


def told(says, text):
    (one,) = [sentence for sentence in says if text in sentence] or [""]
    return one


@pytest.mark.parametrize(("fraction", "superfluous"), [(0.0499, True), (0.0501, False)])
def test_weight_is_superfluous_below_the_accuracy_that_was_asked_for(fraction, superfluous):
    # Of the angle, or of what counts as folded where the angle is less.
    for m1, scale in ((2.0, 2.0), (0.1, np.pi / 4)):
        for sign in (1, -1):
            without = [{"without": "gravity,ground", "change": sign * fraction * scale}]
            says = told(advised(SOURCE, m1=m1, without=without), "superfluous")
            assert bool(says) is superfluous
            assert not says or "by 5 % (measured without it), less than the 5 % asked" in says


def test_weight_that_was_left_out_is_told_with_where_it_would_count():
    source = SolverSource(Conditions(effects="none"), Effort(0.05))
    says = told(advised(source), "weight was left out")
    gamma, least = weight_turning(DESIGN) / 2.0 / 0.05, lift_off_stiffness(DESIGN)
    assert f"more than 5 % where Γ < {gamma:.2g}, and" in says and f"Γ < {least:.2g}; there" in says


def test_panels_that_crossed_are_told_with_where_they_did():
    rows = [{"m1": 2.0, "m2": 0.0, "hinge": 2.0, "contraction": g} for g in (0.1, 0.2, 0.25)]
    says = advised(SOURCE, rows=rows, ends=(0.1, -0.1, -0.2), end=-0.2)
    assert "by 20 % contraction; add contact" in told(says, "passed through each other")
    assert not told(advised(SOURCE, rows=rows), "passed through")
    assert not told(advised(SOURCE, end=0.0), "passed through")
    assert not told(advised(SOURCE, end=-0.2, mirrors=("x",)), "passed through")
    touching = SolverSource(Conditions("gravity,ground,contact"), Effort(0.05))
    assert told(advised(touching), "contact never acted")
    assert not told(advised(touching, events=[{"kind": "contact"}]), "contact never acted")


@pytest.mark.parametrize(("off", "would_do"), [(0.049, True), (0.051, False)])
@pytest.mark.parametrize("foldable", [True, None])
def test_the_formula_would_do_within_the_error_that_was_asked_for(off, would_do, foldable):
    groups = ("E_ratio", "h_ratio", "slenderness", "hinge_length", "contraction")
    simple = float(fold_angle(*(DESIGN[name] for name in groups)))
    says = told(advised(SOURCE, m1=simple / (1 - off), foldable=foldable), "Timoshenko")
    assert bool(says) is (would_do and foldable is not None)
    assert not says or f"gives {simple:.3g} rad" in says


@pytest.mark.parametrize("measure", ["m1", "hinge", "m2"])
@pytest.mark.parametrize(("turn", "small"), [(0.547, True), (0.549, False)])
def test_rotations_are_small_where_their_sine_is_off_by_less_than_was_asked_for(
    measure, turn, small
):
    # θ²/6 = 5 % at 0.5477 rad, of any of the turns and anywhere on the path.
    still = {"m1": 0.0, "m2": 0.0, "hinge": 0.0, "contraction": 0.1}
    rows = [still | {measure: turn if measure == "m2" else -turn}, still | {"contraction": 0.25}]
    says = told(advised(SOURCE, m1=0.0, rows=rows), "small strain and small rotations")
    assert bool(says) is small
    assert not says or ("more than 0.55 rad" in says and "off by about 5 %" in says)


@pytest.mark.parametrize(
    ("mirrors", "part"), [((), "the whole unit"), (("x",), "half of it"), (("x", "y"), "a quarter")]
)
def test_a_lost_symmetry_is_told_with_what_was_followed_instead(mirrors, part):
    event = {"kind": "rocking", "contraction": 0.123}
    says = told(advised(SOURCE, events=[event], mirrors=mirrors), "symmetric state is lost")
    assert "lost at 12.3 % contraction (rocking)" in says and f"went on with {part}: " in says
    assert told(advised(SOURCE, events=[{"kind": "lift-off"}]), "a quarter was enough")


def test_toppling_is_told_of_what_is_held_upright():
    free = replace(SOURCE, conditions=Conditions(upright=False))
    assert told(advised(SOURCE, topples=True), "--free shows where it lands")
    assert not told(advised(free, topples=True), "--free") and not told(advised(SOURCE), "--free")


# -- trouble ---------------------------------------------------------------------------------------


def test_what_a_system_refused_is_told_whatever_it_was_and_its_causes_where_they_are_a_disk():
    first = FileNotFoundError(2, "No such file", "a.txt")
    assert "can't read or write (No such file: a.txt)" in trouble(first)
    around = RuntimeError("x")
    around.__cause__ = first
    assert trouble(around) is None
    around.__cause__ = OSError(5, "Input/output error")
    assert "Input/output error" in trouble(around)
    assert trouble(None) is None
