"""The parts of inverse design by themselves: limits, scores, boxes and what counts as confirmed."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from foldlab.design import FULL, PHYSICAL, REDUCED, to_groups, to_physical
from foldlab.errors import InputError
from foldlab.inverse.answer import Answer, Proposal, rows
from foldlab.inverse.confirm import as_wished, confirm
from foldlab.inverse.propose import propose
from foldlab.inverse.region import Region, _quantity
from foldlab.inverse.robust import Score, pattern_points
from foldlab.inverse.wish import (
    SCALES,
    Angle,
    Wish,
    box_parameters,
    limits_of,
    mass_of,
    quantities_of,
)
from foldlab.labels.label import Label
from foldlab.materials import read_materials

UNIT = {
    "l_s": 0.05, "b_s": 0.02, "h_s": 2e-4, "l_i": 0.01, "b_i": 0.015, "h_i": 3e-4, "E_s": 3e9,
    "rho_s": 1300.0, "E_i": 4e7, "rho_i": 1100.0, "contraction": 0.2, "g_earth": 9.80665,
}  # fmt: skip


# -- bounds met exactly ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "allowed", "refused"),
    [
        ("margin", (0.0, 0.499), (-1e-9, 0.5)),
        ("min_probability", (0.5, 0.999), (0.4999, 1.0)),
        ("max_mass", (1e-9,), (0.0, np.inf)),
        ("max_length", (1e-9,), (0.0, np.inf)),
        ("max_width", (1e-9,), (0.0, np.inf)),
        ("max_thickness", (1e-9,), (0.0, np.inf)),
    ],
)
def test_a_wish_takes_what_lies_within_its_bounds_and_names_what_does_not(name, allowed, refused):
    for value in allowed:
        assert getattr(Wish(**{name: value}), name) == value
    for value in refused:
        with pytest.raises(InputError, match=f"{name} = "):
            Wish(**{name: value})


def test_a_wish_is_complete_by_itself():
    assert Wish().margin == 0.02 and Wish(want=Angle(1.0, 0.1)).margin == 0
    assert Wish(want=Angle(1.0, 0.1), margin=0.1).margin == 0.1
    assert Wish(passive=("a", "b"), active=("c",)).pairs == [("a", "c"), ("b", "c")]
    assert Wish().pairs == [(None, None)]
    for value, tolerance in ((0.0, 1.0), (1.0, 0.0), (np.inf, 1.0), (1.0, np.inf)):
        with pytest.raises(InputError, match="both must be above 0"):
            Angle(value, tolerance)
    with pytest.raises(InputError, match="expected two numbers"):
        Wish(ranges={"l_s": (1.0, 2.0, 3.0)})
    with pytest.raises(InputError, match="lower end first"):
        Wish(ranges={"l_s": (1.0, 1.0)})
    with pytest.raises(InputError, match="n = 0; ask for at least one"):
        propose(Wish(), object(), 0, seed=0)


# -- limits ----------------------------------------------------------------------------------------


def test_every_quantity_of_a_unit_follows_from_groups_and_scales():
    groups = to_groups(pd.DataFrame([UNIT]))
    names = [*FULL.names, *SCALES, "g_earth"]
    logs = np.log10([*groups[FULL.names].iloc[0], *(UNIT[n] for n in (*SCALES, "g_earth"))])
    found = quantities_of(logs[None], names).iloc[0]
    for name, value in UNIT.items():
        assert found[name] == pytest.approx(value, rel=1e-12), name
    scales = {name: UNIT[name] for name in ("l_s", "rho_s", "g_earth")}
    back = to_physical(groups, **scales)
    assert mass_of(quantities_of(logs[None], names)) == pytest.approx(mass_of(back))


def told(wish, pair=(None, None), table=None):
    return {limit.text: limit for limit in limits_of(wish, pair, table)}


def test_limits_say_in_si_units_what_was_asked_for():
    wish = Wish(
        fixed={"h_s": 2e-4}, ranges={"E_i": (1e7, 2e8)}, max_length=0.1, max_width=0.03,
    )  # fmt: skip
    limits = told(wish)
    assert (limits["h_s = 0.0002 m"].low, limits["h_s = 0.0002 m"].high) == (np.log10(2e-4),) * 2
    assert limits["E_i in 1e+07 … 2e+08 Pa"].powers == {"E_ratio": 1.0, "E_s": 1.0}
    for text, quantity, most in (("l_s ≤ 0.1 m", "l_s", 0.1), ("b_s ≤ 0.03 m", "b_s", 0.03)):
        limit = limits[text]
        assert (limit.quantity, limit.low, limit.high) == (quantity, -np.inf, np.log10(most))
    asked = ["h_s = 0.0002 m", "E_i in 1e+07 … 2e+08 Pa", "l_s ≤ 0.1 m", "b_s ≤ 0.03 m"]
    assert [text for text, limit in limits.items() if limit.soft] == asked
    assert limits["l_s in 1e-06 … 10 m (the bounds)"].high == 1


def test_materials_limit_what_they_say_of_their_own_layer():
    table = read_materials()
    limits = told(Wish(passive=("PET",), active=("SMP",)), ("PET", "SMP"), table)
    soft = {limit.quantity: limit for limit in limits.values() if limit.soft}
    assert list(soft) == ["E_s", "rho_s", "E_i", "rho_i", "contraction"]
    for quantity, name, column in (
        ("E_s", "polyester film", "E"), ("rho_s", "polyester film", "rho"),
        ("E_i", "shape-memory polymer", "E"), ("rho_i", "shape-memory polymer", "rho"),
        ("contraction", "shape-memory polymer", "contraction"),
    ):  # fmt: skip
        ends = [np.log10(table.loc[name, f"{column}_{end}"]) for end in ("low", "high")]
        assert [soft[quantity].low, soft[quantity].high] == pytest.approx(ends)
        assert soft[quantity].text.endswith(f"({name})")


def test_a_unit_that_is_one_keeps_every_law_and_bound():
    groups = to_groups(pd.DataFrame([UNIT])).iloc[0].to_dict()
    value = {name: np.log10(v) for name, v in (groups | UNIT).items()}
    wish = Wish(space=FULL, ranges={"l_s": (0.01, 0.1)})
    limits = told(wish)
    for text, limit in limits.items():
        at = sum(power * value[name] for name, power in limit.powers.items())
        assert limit.low - 1e-9 <= at <= limit.high + 1e-9, text
    # Γ = E_s h_s²/(ρ_s g l_s³): twice as stiff is twice as much, and no longer what it was.
    law = limits["the definition of Γ"]
    at = sum(power * (value | {"E_s": np.log10(6e9)})[n] for n, power in law.powers.items())
    assert at == pytest.approx(np.log10(2))
    assert limits["g_earth = 9.807 m/s²"].soft is law.soft is False


def test_designs_exceed_a_limit_on_mass_or_thickness_by_decades():
    wish = Wish(
        space=FULL, ranges={"l_s": (0.01, 0.1)}, max_mass=1e-3, max_thickness=1e-3,
        fixed={"rho_s": 1300.0},
    )  # fmt: skip
    region = Region(wish, limits_of(wish, (None, None)))
    groups = to_groups(pd.DataFrame([UNIT])).iloc[0].to_dict() | UNIT
    x = np.log10([[groups[name] for name in region.names]])
    mass, thickness = region.measure("mass", x)[0], region.measure("thickness", x)[0]
    assert thickness == pytest.approx(5e-4)
    for most_mass, most_thickness in ((mass / 10, 1.0), (1.0, thickness / 10), (mass, thickness)):
        tight = replace(wish, max_mass=float(most_mass), max_thickness=float(most_thickness))
        region.wish = tight
        want = 1.0 if tight.max_mass != mass else 0.0
        assert region.excess(x)[0] == pytest.approx(want, abs=1e-12)


def test_designs_are_even_in_the_logarithm_and_keep_every_limit():
    wish = Wish(ranges={"E_ratio": (1.0, 100.0), "h_ratio": (0.5, 2.0)})
    region = Region(wish, limits_of(wish, (None, None)))
    x = region.sample(4000, np.random.default_rng(0))
    assert x.shape == (4000, 3)
    for limit in region.limits:
        at = x @ [limit.powers.get(name, 0.0) for name in region.names]
        assert limit.low - 1e-9 <= at.min() and at.max() <= limit.high + 1e-9
    for name, (low, high) in {**wish.ranges, "slenderness": (1e-3, 0.1)}.items():
        at = x[:, region.names.index(name)]
        unit = (at - np.log10(low)) / np.log10(high / low)
        assert np.mean(unit) == pytest.approx(0.5, abs=0.03)
        assert np.std(unit) == pytest.approx(12**-0.5, rel=0.05)
    # Walkers go only where they are accepted.
    kept = x[x[:, 0] < 1.0]
    moved = region.walk(kept, 5, np.random.default_rng(1), accept=lambda y: y[:, 0] < 1.0)
    assert moved[:, 0].max() < 1.0 and not np.allclose(moved, kept)


def test_quantities_are_told_with_their_units():
    assert _quantity("E_s", 1.2345e9) == "1.23e+09 Pa" and _quantity("h_ratio", 2.0) == "2"
    assert PHYSICAL["l_s"] == "m" and _quantity("l_s", 0.05) == "0.05 m"


# -- scores and boxes ------------------------------------------------------------------------------


class Box:
    """P(foldable) 1 within a box of the unit cube about its middle, of these half-widths."""

    classes_ = np.array([False, True])

    def __init__(self, *half, inside=1.0):
        self.half, self.inside = np.array(half), inside

    def predict_proba(self, designs):
        off = np.abs(REDUCED.to_unit(designs) - 0.5)
        p = np.where((off <= self.half + 1e-9).all(axis=1), self.inside, 1 - self.inside)
        return np.column_stack([1 - p, p])


MIDDLE = np.full((1, 3), 0.5)


@pytest.mark.parametrize("d", [1, 3, 6, 7])
def test_a_box_is_looked_at_in_its_middle_its_corners_and_faces_and_inside(d):
    points = pattern_points(d)
    seen = {tuple(row) for row in points.tolist()}
    assert len(points) == 1 + min(2**d, 64) + 2 * d + 16
    assert (0.5,) * d in seen and points.min() == 0 and points.max() == 1
    corners = {row for row in seen if set(row) <= {0.0, 1.0}}
    assert len(corners) == min(2**d, 64)
    faces = {tuple(np.where(np.arange(d) == k, end, 0.5)) for k in range(d) for end in (0.0, 1.0)}
    assert faces <= seen


def test_a_score_is_what_is_predicted_beyond_what_is_required():
    designs = REDUCED.from_unit(MIDDLE)
    for want, p in (("foldable", 0.9), ("flat", 0.1)):
        score = Score(Wish(want=want, min_probability=0.6), Box(1, 1, 1, inside=0.9), None)
        assert score(designs) == pytest.approx(p - 0.6)
    angle = Wish(want=Angle(2.0, 0.5), fixed={"hinge_length": 0.25, "contraction": 0.2})

    class Regressor:
        def predict(self, groups):
            assert list(groups) == REDUCED.names
            return np.full(len(groups), 44.0)

    designs = designs.assign(hinge_length=0.25, contraction=0.2)
    assert Score(angle, None, Regressor())(designs) == pytest.approx(0.5 - abs(44 * 0.05 - 2))


def test_the_margin_is_the_half_width_of_the_largest_cube():
    score = Score(Wish(), Box(0.3, 0.13, 0.4), None)
    assert score.margin(MIDDLE) == pytest.approx(0.13, abs=3e-4)
    # Off the middle the nearer side counts.
    aside = MIDDLE + np.array([[0.0, 0.05, 0.0]])
    assert score.margin(aside) == pytest.approx(0.08, abs=3e-4)


def test_a_box_grows_side_by_side_and_keeps_half_the_margin_to_the_boundary():
    half = np.array([0.3, 0.13, 0.4])
    score = Score(Wish(margin=0.04), Box(*half), None)
    margin = score.margin(MIDDLE)
    low, high = score.box(MIDDLE, margin)
    reach = np.maximum(0.5 - low, high - 0.5)[0]
    assert (reach <= half - 0.02 + 1e-6).all()
    assert reach[1] == pytest.approx(0.11, abs=1e-3)
    # In the other directions it comes near to the boundary.
    assert (reach > 0.7 * (half - 0.02)).all() and (np.minimum(0.5 - low, high - 0.5) > 0.1).all()
    at_the_bounds = Score(Wish(margin=0.04), Box(1, 1, 1), None)
    low, high = at_the_bounds.box(MIDDLE, at_the_bounds.margin(MIDDLE))
    assert (low == 0).all() and (high == 1).all()


def test_margin_and_box_extend_along_what_the_wanted_behaviour_depends_on():
    assert [p.name for p in box_parameters(Wish())] == REDUCED.names
    want = Angle(1.0, 0.1)
    names = [p.name for p in box_parameters(Wish(want=want))]
    assert names == [*REDUCED.names, "hinge_length", "contraction"]
    assert [p.name for p in box_parameters(Wish(space=FULL, want=want))] == FULL.names


# -- what counts as confirmed ----------------------------------------------------------------------


def a_proposal(**changed):
    box = {"E_ratio": (0.1, 10.0), "h_ratio": (1.0, 2.0), "slenderness": (0.01, 0.02)}
    groups = {"E_ratio": 1.0, "h_ratio": 1.5, "slenderness": 0.015}
    given = {
        "groups": groups, "physical": {}, "materials": (None, None), "mass": None,
        "probability": 0.9, "angle": None, "margin": 0.1, "box": box,
    }  # fmt: skip
    return Proposal(**(given | changed))


@pytest.mark.parametrize(
    ("checked", "held", "unknown", "confirmed"),
    [
        (0, 0, 0, None), (16, 16, 0, True), (16, 15, 0, False), (16, 15, 1, None),
        (16, 0, 16, None), (16, 14, 1, False),
    ],
)  # fmt: skip
def test_a_box_is_confirmed_where_all_of_it_held(checked, held, unknown, confirmed):
    proposal = a_proposal(box_checked=checked, box_held=held, box_unknown=unknown)
    assert proposal.box_confirmed is confirmed


def test_what_was_confirmed_is_a_fraction_of_all_proposals():
    label = Label({}, True, "so")
    done = [a_proposal(label=label, confirmed=c) for c in (True, True, False, None)]
    assert Answer(Wish(), 4, tuple(done), "", 0.0).confirmed_fraction == 0.5
    assert Answer(Wish(), 5, (*done, a_proposal()), "", 0.0).confirmed_fraction is None
    assert Answer(Wish(), 4, (), "", 0.0).confirmed_fraction is None
    assert Answer(Wish(), 4, tuple(done), "", 0.0).complete
    assert not Answer(Wish(), 5, tuple(done), "", 0.0).complete


@pytest.mark.parametrize(
    ("evidence", "wished"),
    [
        ({"fold_angle": 1.25}, True),  # by as much as is tolerated
        ({"fold_angle": 0.75}, True),
        ({"fold_angle": 1.2501}, False),
        ({"normalised_angle": 20.0}, True),
        ({"normalised_angle": 30.0}, False),
        ({}, None),
    ],
)
def test_a_wanted_angle_is_met_within_its_tolerance(evidence, wished):
    wish = Wish(want=Angle(1.0, 0.25))
    groups = {"hinge_length": 0.25, "contraction": 0.2}
    assert as_wished(wish, Label({}, True, "", evidence), groups) is wished


@pytest.mark.parametrize("want", ["foldable", "flat"])
@pytest.mark.parametrize("foldable", [True, False, None])
def test_a_wanted_label_is_the_source_s(want, foldable):
    wished = None if foldable is None else foldable == (want == "foldable")
    assert as_wished(Wish(want=want), Label({}, foldable, ""), {}) is wished


@pytest.mark.parametrize(
    ("options", "corners", "inside"),
    [({}, 8, 8), ({"corners": 3}, 3, 8), ({"corners": 0, "inside": 2}, 0, 2)],
)
def test_a_design_is_confirmed_with_corners_and_points_of_its_box(options, corners, inside):
    asked = []

    class Source:
        name, version = "s", "1"

        def label(self, design):
            asked.append(dict(design))
            return Label(design, design["E_ratio"] < 9.9, "so")

    answer = Answer(Wish(), 1, (a_proposal(),), "", 0.0)
    (done,) = confirm(answer, Source(), **options).proposals
    assert asked[0] == pytest.approx(done.groups) and len(asked) == 1 + corners + inside
    ends = np.array(list(done.box.values()))
    at = np.array([[row[name] for name in done.box] for row in asked[1:]])
    on_corner = np.isclose(at[..., None], ends, rtol=1e-9).any(axis=2).all(axis=1)
    assert on_corner.tolist() == [True] * corners + [False] * inside
    assert (at >= ends[:, 0] * (1 - 1e-9)).all() and (at <= ends[:, 1] * (1 + 1e-9)).all()
    assert len(np.unique(at[:corners], axis=0)) == corners
    stiff = int((at[:, 0] >= 9.9).sum())
    counts = done.box_checked, done.box_held, done.box_unknown
    assert counts == (corners + inside, corners + inside - stiff, 0) and done.confirmed is True


def test_rows_of_a_table_hold_what_is_known():
    label = Label({}, True, "so", {"m1": 1.0})
    known = a_proposal(
        mass=0.001, angle=1.5, label=label, confirmed=True, box_checked=16, box_held=12
    )
    full, bare = rows(Answer(Wish(), 2, (known, a_proposal(probability=None)), "", 0.0))
    more = {"margin": 0.1, "probability": 0.9, "fold_angle": 1.5, "mass_kg": 0.001}
    assert full == {**known.groups, **more, "confirmed": True, "box": "12/16"}
    assert bare == {**known.groups, "margin": 0.1}
    plain = known.as_dict()
    assert plain["reason"] == "so" and plain["evidence"] == {"m1": 1.0}
    assert plain["box_confirmed"] is False and plain["box"]["h_ratio"] == [1.0, 2.0]
    assert "label" not in plain and "reason" not in a_proposal().as_dict()
