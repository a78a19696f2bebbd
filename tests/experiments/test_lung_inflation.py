"""Rows of the study of inflation: a sphere beside its radial solution, meshes beside the finest."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import lung_inflation as study
from experiments.lung_inflation import LIMIT, LIMIT_STRETCH, RADIAL, Config, prepared
from foldlab.errors import InputError
from solver.cases.lung.mesh import hexahedra

CONFIG = Config(n=1, pressure=0.02, contraction=-0.1, steps=2, levels=(0,), tets=(), tets10=())


@pytest.fixture(scope="module")
def sphere():
    return study.thick_sphere(0)


def test_a_thick_sphere_follows_the_radial_solution_through_its_limit(sphere):
    *along, limit = sphere
    assert [row["stretch"] for row in along] == list(RADIAL)
    for row in along:
        assert row["radial"] == RADIAL[row["stretch"]]
        assert row["error"] == pytest.approx(row["pressure"] / row["radial"] - 1)
        assert abs(row["error"]) < 0.01
    assert limit["at"] == "limit" and limit["radial"] == LIMIT
    assert limit["error"] == pytest.approx(limit["pressure"] / LIMIT - 1, abs=1e-12)
    assert abs(limit["error"]) < 0.01 > abs(limit["stretch_error"])
    assert limit["stretch_error"] == pytest.approx(limit["stretch"] / LIMIT_STRETCH - 1)


def test_the_radial_solution_has_its_largest_pressure_at_its_limit():
    assert max(RADIAL.values()) < LIMIT and 1.4 < LIMIT_STRETCH < 1.75


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"pressure_drop": 1.01}, "pressure_drop = 1.01"),
        ({"pressure_drop": -0.01}, "pressure_drop = -0.01"),
        ({"steps": 0}, "steps = 0"),
        ({"pressure": 0.0}, "pressure = 0.0"),
        ({"nu": 0.5}, "0.5"),
        ({"levels": (0, 9)}, "no level 9; there are: 0"),
    ],
)
def test_settings_that_make_no_lung_are_refused(changes, says):
    config = replace(CONFIG, **changes)
    with pytest.raises(InputError, match=says):
        prepared(config, -0.1, config.levels)


def test_drops_of_nothing_and_of_all_are_drops():
    for drop in (0.0, 1.0):
        lung, tissue = prepared(replace(CONFIG, pressure_drop=drop, steps=1), -0.1, (0,))
        assert (lung.n, tissue.stiffness, tissue.nu) == (1, 75.0, 0.3)


def test_a_row_states_the_whole_spheres_energy_and_the_limit_in_pressure():
    lung, tissue = prepared(CONFIG, -0.1, (0,))
    body = hexahedra(lung, 0)
    row, curve = study.inflate("mesh", body, lung, tissue, CONFIG, limit=True)
    assert row["pressure"] == pytest.approx(0.02) and row["part"] == "wedge"
    assert row["depth"] / row["spacing"] == pytest.approx(row["aspect"]) and row["aspect"] > 0
    pressures, aspects = np.array(curve).T
    assert curve[0] == (0.0, 0.0) and (np.diff(pressures) > 0).all()
    assert row["limit"] == pytest.approx(pressures[-1]) and row["limit"] > 0.02
    at = int(np.flatnonzero(np.isclose(pressures, 0.02))[0])
    assert aspects[at] == pytest.approx(row["aspect"]) and at >= 2
    # A wedge is a 120th of the sphere, an octant an eighth: their energies agree.
    octant, _ = study.inflate("octant", hexahedra(lung, 0, part="octant"), lung, tissue, CONFIG)
    assert octant["energy"] == pytest.approx(row["energy"], rel=1e-5) and "limit" not in octant
    assert octant["unknowns"] > 10 * row["unknowns"] and row["nodes"] == len(body.nodes)
    assert row["memory_mb"] > 50 and row["iterations"] >= 2 and row["seconds"] > 0


def test_meshes_are_compared_with_the_finest_of_hexahedra(tracker, monkeypatch):
    aspects = iter((0.5, 0.4, 0.3, 0.2))
    asked = []

    def inflate(name, body, lung, tissue, config, limit=False):
        asked.append((name, body, limit))
        row = {"aspect": next(aspects), "mesh": name, "limit": 0.1, "unknowns": 10, "part": "wedge"}
        return row, [(0.0, 0.0), (0.1, 0.3)]

    monkeypatch.setattr(study, "inflate", inflate)
    monkeypatch.setattr(study, "thick_sphere", lambda level: [{"level": level}])
    monkeypatch.setattr(study, "hexahedra", lambda lung, level: ("hex", level))
    monkeypatch.setattr(
        study, "tetrahedra", lambda lung, size, part, order=1: ("tet", size, part, order)
    )
    monkeypatch.setattr(
        study, "plot_inflation",
        lambda *given: SimpleNamespace(savefig=lambda path, dpi: path.write_bytes(b"png")),
    )  # fmt: skip
    config = replace(CONFIG, levels=(0, 1), tets=(0.2,), tets10=(0.3,), picture=-1, stability=-1)
    result = study.run(config, tracker)
    assert asked == [
        ("hex27, level 0", ("hex", 0), True), ("hex27, level 1", ("hex", 1), True),
        ("tet4, 0.2 R", ("tet", 0.2, "wedge", 1), True),
        ("tet10, 0.3 R", ("tet", 0.3, "wedge", 2), True),
    ]  # fmt: skip
    beside = [row["beside_finest"] for row in result["table"]]
    assert beside == pytest.approx([0.25, 0.0, -0.25, -0.5])
    assert result["thick_sphere"] == [{"level": 0}]
    assert "stability" not in result and "series" not in result
    with pytest.raises(InputError, match="levels is empty"):
        study.run(replace(config, levels=()), tracker)
    with pytest.raises(InputError, match="no sphere 'tet9'; there are: tet4, hex27, tet10"):
        study.run(replace(config, spheres=("tet9",)), tracker)


def test_modes_are_told_with_their_pressure_up_to_the_limit(monkeypatch):
    class Classes:
        def __init__(self, octant):
            pass

        def count(self, wedge, u, e):
            return {"even": 0, "odd in one": 3 if e > 1 else 0}

    monkeypatch.setattr(study, "Classes", Classes)
    lung, tissue = prepared(CONFIG, -0.1, (0,))
    rows = study.modes(lung, tissue, replace(CONFIG, stability=0))
    pressures = [row["pressure"] for row in rows]
    assert pressures == sorted(pressures) and pressures[0] == 0.0
    assert pressures[-1] > 0.02 and any(p == pytest.approx(0.02) for p in pressures)
    for row in rows:
        assert row["total"] == row["odd in one"] == (3 if row["pressure"] > 0.02 * 1.0001 else 0)
