"""The design space: sampling, validation, groups ↔ SI."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kstest

from foldlab.design import (
    FULL,
    PATTERNED,
    PHYSICAL,
    REDUCED,
    Parameter,
    space_named,
    space_of,
    to_groups,
    to_physical,
)
from foldlab.errors import InputError


def test_bounds_are_those_of_the_dissertation():
    assert [(p.name, p.low, p.high) for p in REDUCED] == [
        ("E_ratio", 1e-3, 1e3),
        ("h_ratio", 0.1, 10),
        ("slenderness", 1e-3, 1e-1),
    ]
    assert len(FULL) == 9
    assert FULL["hinge_length"].scale == "linear"
    assert (FULL["contraction"].low, FULL["contraction"].high) == (0.02, 0.4)


@pytest.mark.parametrize("space", [REDUCED, FULL], ids=lambda s: s.name)
def test_latin_hypercube_has_one_design_in_each_stratum(space):
    n = 200
    unit = space.to_unit(space.sample(n, seed=5))
    for column in unit.T:
        assert sorted(np.floor(column * n).clip(0, n - 1)) == list(range(n))


@pytest.mark.parametrize("space", [REDUCED, FULL, PATTERNED], ids=lambda s: s.name)
def test_no_design_lies_beyond_its_bounds(space):
    # 10**log10(b) misses b by rounding for some of these, and a design beyond a bound is refused.
    narrow = space.with_bounds(slenderness=(0.0029, 0.0031), E_ratio=(0.07, 700.0))
    for k in (0.0, 1.0):
        corner = narrow.from_unit(np.full((1, len(narrow)), k)).iloc[0]
        ends = {p.name: (p.low, p.high)[int(k)] for p in narrow}
        assert corner.to_dict() == {n: pytest.approx(v, rel=1e-12) for n, v in ends.items()}
        assert all(p.low <= corner[p.name] <= p.high for p in narrow)
    beyond = narrow.from_unit(np.linspace(-0.1, 1.1, 13)[:, None] * np.ones(len(narrow)))
    for p in narrow:
        assert beyond[p.name].between(p.low, p.high).all()


def test_log_parameters_are_uniform_in_the_logarithm():
    designs = REDUCED.sample(2000, seed=0)
    logs = np.log10(designs["E_ratio"])
    assert kstest((logs + 3) / 6, "uniform").pvalue > 0.5
    assert kstest(designs["E_ratio"] / 1e3, "uniform").pvalue < 1e-6


def test_seed_decides_the_sample():
    pd.testing.assert_frame_equal(REDUCED.sample(50, seed=3), REDUCED.sample(50, seed=3))
    assert not REDUCED.sample(50, seed=3).equals(REDUCED.sample(50, seed=4))


def test_optimised_sample_fills_the_space_better():
    from scipy.stats import qmc

    plain = REDUCED.to_unit(REDUCED.sample(60, seed=1))
    better = REDUCED.to_unit(REDUCED.sample(60, seed=1, optimization="random-cd"))
    assert qmc.discrepancy(better) < qmc.discrepancy(plain)


def test_unit_cube_round_trip():
    designs = FULL.sample(100, seed=2)
    again = FULL.from_unit(FULL.to_unit(designs))
    np.testing.assert_allclose(again, designs, rtol=1e-12)


def test_with_bounds_narrows_one_group_only():
    space = REDUCED.with_bounds(slenderness=(1e-3, 3e-2))
    assert space["slenderness"].high == 3e-2
    assert space["E_ratio"] == REDUCED["E_ratio"]
    with pytest.raises(InputError, match="no group 'thickness'"):
        REDUCED.with_bounds(thickness=(1, 2))


def test_groups_to_si_by_hand():
    design = pd.DataFrame(
        {
            "E_ratio": [0.1],
            "rho_ratio": [2.0],
            "hinge_length": [0.25],
            "hinge_width": [0.5],
            "h_ratio": [5.0],
            "stiffness_to_weight": [4.0],
            "aspect": [0.2],
            "slenderness": [4e-3],
            "contraction": [0.3],
        }
    )
    si = to_physical(design, E_s=2e9, l_s=0.05, g_earth=10.0).iloc[0]
    assert si["h_s"] == pytest.approx(2e-4)
    assert si["h_i"] == pytest.approx(1e-3)
    assert si["b_i"] == pytest.approx(0.005)
    assert si["E_i"] == pytest.approx(2e8)
    # Γ = E h² / (rho g l³)
    assert si["rho_s"] == pytest.approx(2e9 * 4e-8 / (4.0 * 10 * 0.05**3))
    assert si["rho_i"] == pytest.approx(2 * si["rho_s"])


@pytest.mark.parametrize("absent", ["E_s", "rho_s", "l_s", "g_earth"])
def test_conversion_loses_nothing_whichever_scale_follows(absent):
    designs = FULL.sample(300, seed=7)
    scales = {"E_s": 3e6, "rho_s": 1100.0, "l_s": 0.08, "g_earth": 9.80665}
    del scales[absent]
    si = to_physical(designs, **scales)
    assert list(si.columns) == [name for name in PHYSICAL if name in si]
    np.testing.assert_allclose(to_groups(si)[FULL.names], designs, rtol=1e-13)
    np.testing.assert_allclose(to_physical(to_groups(si), **scales), si, rtol=1e-12)


def test_reduced_designs_convert_without_a_weight():
    designs = REDUCED.sample(20, seed=1)
    si = to_physical(designs, E_s=1e6, l_s=0.1)
    assert "rho_s" not in si
    np.testing.assert_allclose(to_groups(si)[REDUCED.names], designs, rtol=1e-13)


@pytest.mark.parametrize(
    ("scales", "message"),
    [
        ({"E_s": 1e6, "l_s": 0.1}, "exactly three"),
        ({"E_s": 1e6, "l_s": 0.1, "g_earth": 9.8, "rho_s": 1e3}, "exactly three"),
        ({"E_s": -1e6, "l_s": 0.1, "g_earth": 9.8}, "E_s = -1e"),
        ({"E_s": 1e6, "l_s": 0.1, "gravity": 9.8}, "no scale gravity"),
    ],
)
def test_scales_are_checked(scales, message):
    with pytest.raises(InputError, match=message):
        to_physical(FULL.sample(2, seed=0), **scales)


def test_to_groups_names_what_it_does_not_know():
    with pytest.raises(InputError, match="no physical quantity thickness"):
        to_groups(pd.DataFrame({"thickness": [1.0]}))
    with pytest.raises(InputError, match="no group follows"):
        to_groups(pd.DataFrame({"E_s": [1.0]}))


def _reduced(**changes):
    design = {"E_ratio": 1.0, "h_ratio": 1.0, "slenderness": 1e-2}
    return pd.DataFrame([design | changes])


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (_reduced().iloc[:0], "empty"),
        (_reduced().drop(columns="h_ratio"), "lacks h_ratio"),
        (_reduced(h_ratio="thick"), "not numeric"),
        (_reduced(h_ratio=np.nan), "h_ratio is nan in row 0"),
        (_reduced(E_ratio=np.inf), "E_ratio is inf"),
        (_reduced(E_ratio=-1.0), "must be above 0"),
        (_reduced(slenderness=0.2), "outside 0.001 … 0.1"),
        (
            pd.concat([_reduced(), _reduced(h_ratio=2.0)[["h_ratio"]]], axis=1),
            "column h_ratio stands 2 times",
        ),
    ],
)
def test_bad_tables_get_one_clear_error(frame, message):
    with pytest.raises(InputError, match=message):
        REDUCED.validate(frame)


def test_validate_keeps_order_and_drops_other_columns():
    frame = _reduced(note="x")[["note", "slenderness", "h_ratio", "E_ratio"]]
    assert list(REDUCED.validate(frame).columns) == REDUCED.names


def test_one_design_is_validated_as_a_table_of_one():
    for design in FULL.sample(5, seed=3).to_dict("records"):
        one = FULL.validate_one({"note": "x", **dict(reversed(design.items()))})
        assert one == design and list(one) == FULL.names
    out = {**design, "slenderness": 0.5}
    assert FULL.validate_one(out, bounds=False) == out
    for change, says in (
        ({"slenderness": 0.5}, "outside"), ({"E_ratio": -1.0}, "must be above 0"),
        ({"E_ratio": np.nan}, "finite"), ({"E_ratio": "soft"}, "E_ratio is 'soft'"),
        ({"E_ratio": [1.0, 2.0]}, "plain number"), ({"E_ratio": None}, "plain number"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            FULL.validate_one({**design, **change})
    with pytest.raises(InputError, match="lacks aspect; it has E_ratio, "):
        FULL.validate_one({k: v for k, v in design.items() if k != "aspect"})


def test_spaces_are_found_by_name_and_by_columns():
    assert space_named("full") is FULL
    assert space_of(FULL.sample(1, seed=0)) is FULL
    assert space_of(REDUCED.sample(1, seed=0)) is REDUCED
    with pytest.raises(InputError, match="no design space 'half'"):
        space_named("half")
    with pytest.raises(InputError, match="expected at least"):
        space_of(pd.DataFrame({"a": [1]}))


@pytest.mark.parametrize(
    ("low", "high", "scale"), [(2, 1, "log"), (0, 1, "log"), (0, np.inf, "linear"), (0, 1, "ln")]
)
def test_parameters_check_themselves(low, high, scale):
    with pytest.raises(InputError):
        Parameter("x", "x", low, high, scale, "")


# -- strips --------------------------------------------------------------------------------------


def test_a_patterned_design_is_a_full_one_and_its_strips():
    assert PATTERNED.names == [*FULL.names, "strips", "strip_share"]
    designs = PATTERNED.sample(400, seed=1)
    assert space_of(designs) is PATTERNED and space_of(designs[FULL.names]) is FULL
    assert set(designs["strips"]) == set(range(1, 11))
    # On a log scale each has its interval of half a strip to both sides.
    want = np.log(np.arange(1.5, 11) / np.arange(0.5, 10)) / np.log(21)
    counts = np.array([(designs["strips"] == n).sum() for n in range(1, 11)])
    np.testing.assert_allclose(counts, 400 * want, atol=2)
    again = PATTERNED.from_unit(PATTERNED.to_unit(designs))
    np.testing.assert_allclose(again, designs, rtol=1e-12)


@pytest.mark.parametrize("strips, says", [(2.5, "strips is 2.5 in row 0"), (11, "outside 1 … 10")])
def test_strips_are_counted(strips, says):
    designs = PATTERNED.sample(1, seed=0).assign(strips=float(strips))
    with pytest.raises(InputError, match=says):
        PATTERNED.validate(designs)
    with pytest.raises(InputError, match="whole"):
        Parameter("n", "n", 0.5, 3, "linear", "a count", whole=True)


def test_strips_in_si_and_back():
    designs = PATTERNED.sample(50, seed=3)
    si = to_physical(designs, E_s=1e6, rho_s=1e3, l_s=0.05)
    # The strips and as many gaps fill the hinge.
    np.testing.assert_allclose(designs["strips"] * (si["w_i"] + si["s_i"]), si["b_i"])
    np.testing.assert_allclose(to_groups(si)[PATTERNED.names], designs, rtol=1e-9)
    half = designs.assign(strips=designs["strips"].where(designs.index != 7, 2.5))
    with pytest.raises(InputError, match=r"strips is 2\.5 in row 7"):
        to_physical(half, E_s=1e6, rho_s=1e3, l_s=0.05)
    with pytest.raises(InputError, match="whole n"):
        to_groups(si.assign(b_i=1.05 * si["b_i"]))


@pytest.mark.parametrize(
    "change, told",
    [
        ({"E_ratio": np.nan}, "E_ratio is nan"),
        ({"h_ratio": 0.0}, "must be above 0"),
        ({"aspect": 1.001}, "outside 0.05 … 1"),
        ({"contraction": 0.0199}, "outside 0.02 … 0.4"),
    ],
)
def test_a_table_of_nothing_but_groups_is_checked_as_any_other(change, told):
    designs = FULL.sample(5, seed=0)
    kept = FULL.validate(designs)
    assert kept.equals(designs) and kept is not designs
    kept.iloc[0, 0] = -1.0
    assert (designs > 0).all(axis=None)
    ((name, value),) = change.items()
    designs.loc[3, name] = value
    for table in (designs, designs.assign(note="x")):
        with pytest.raises(InputError, match=told):
            FULL.validate(table)


def test_bounds_can_be_left_out_and_widths_of_strips_come_whole():
    designs = FULL.sample(2, seed=0).assign(aspect=1.5)
    assert FULL.validate(designs, bounds=False).equals(designs)
    with pytest.raises(InputError, match="must be above 0"):
        FULL.validate(designs.assign(aspect=-1.0), bounds=False)
    patterned = PATTERNED.sample(3, seed=0)
    assert PATTERNED.validate(patterned).equals(patterned.astype(float))
    patterned = patterned.astype(float)
    patterned.loc[1, "strips"] = 2.5
    with pytest.raises(InputError, match="give whole numbers"):
        PATTERNED.validate(patterned)
