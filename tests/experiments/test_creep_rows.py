"""Rows of the experiments on creep: errors beside the exact curves, and what a hinge loses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import creep, creeping_hinge, furrow, neural_tube, problem_p
from experiments.creep import STEPS, follow
from foldlab.errors import InputError
from solver.cases.tissue import creep as case
from solver.cases.tissue import furrow as furrow_case

MODEL = case.MODELS["Kelvin-Voigt"]
CONFIG = creep.Config(models=("Kelvin-Voigt",), step=0.05, tolerance=1e-4, until=1.4)


def test_errors_are_fractions_of_the_exact_peak():
    row, curve = follow(CONFIG, MODEL, "fixed, order 1", 0.01)
    axial, lateral = MODEL.exact(curve["t"].to_numpy())
    peak = np.abs(MODEL.exact(np.linspace(0, 1.4, 2001)[1:])[0]).max()
    assert row["axial"] == pytest.approx(np.abs(curve["axial"] - axial).max() / peak)
    assert row["lateral"] == pytest.approx(np.abs(curve["lateral"] - lateral).max() / peak)
    # Strains are told over σ: those of E = 1, some percent off by finite steps and strains.
    assert 0 < row["lateral"] < row["axial"] < 0.1
    assert row["number"] == len(curve) == 28 and row["iterations"] >= 28
    assert row["stress"] == 0.01 and row["model"] == "Kelvin-Voigt" and row["dissipated"] > 0
    dense = np.linspace(0, 1.4, 2001)[1:]
    apart = np.abs(MODEL.response(dense) - MODEL.exact(dense)[0]).max() / peak
    assert row["one_dimensional"] == pytest.approx(apart)
    # Per σ², so that it depends on the small σ hardly at all.
    less, _ = follow(CONFIG, MODEL, "fixed, order 1", 0.001)
    assert less["dissipated"] == pytest.approx(row["dissipated"], rel=0.02)


def test_second_order_and_adaptive_steps_are_nearer_to_the_exact_curve():
    rows = {steps: follow(CONFIG, MODEL, steps, 1e-3)[0] for steps in STEPS}
    assert rows["fixed, order 2"]["axial"] < rows["fixed, order 1"]["axial"]
    assert rows["adaptive, order 2"]["axial"] < 1e-2
    assert rows["adaptive, order 1"]["number"] > rows["adaptive, order 2"]["number"]
    looser, _ = follow(replace(CONFIG, tolerance=1e-2), MODEL, "adaptive, order 2", 1e-3)
    assert looser["number"] < rows["adaptive, order 2"]["number"]


def test_the_worst_of_each_kind_of_steps_is_told(tracker, monkeypatch):
    asked = []

    def follow(config, model, steps, stress):
        asked.append((model.name, steps, stress))
        n = len(asked)
        row = {"steps": steps, "axial": n / 100, "lateral": (20 - n) / 100, "seconds": float(n)}
        curve = {"model": model.name, "steps": steps, "t": [0.1], "axial": 1.0, "lateral": 1.0}
        return row, pd.DataFrame(curve)

    monkeypatch.setattr(creep, "follow", follow)
    result = creep.run(replace(CONFIG, models=("Kelvin-Voigt", "Maxwell"), stress=0.02), tracker)
    assert asked == [
        (name, steps, stress)
        for name in ("Kelvin-Voigt", "Maxwell")
        for steps, stress in [*zip(STEPS, [0.02] * 4, strict=True), (STEPS[-1], 1.0)]
    ]
    # Rows 1, 6 have the printed steps, 4 and 9 the best ones; 5 and 10 the printed load.
    assert result["worst_printed_steps"] == 0.06 and result["worst_adaptive"] == 0.16
    assert result["slowest"] == 10.0 and len(result["table"]) == 10
    assert [row["steps"] for row in result["table"]][4::5] == ["adaptive, printed σ"] * 2
    with pytest.raises(InputError, match="no model 'Voigt'; there are: "):
        creep.run(replace(CONFIG, models=("Voigt",)), tracker)


HINGE = creeping_hinge.Config(contraction=0.02, stiffness_to_weight=2.0, until=2.0, t_fin=0.05)


def test_a_hinge_that_relaxes_loses_of_its_angle_under_weight_alone():
    heavy, curve = creeping_hinge.follow(HINGE, 0.5, True)
    light, _ = creeping_hinge.follow(HINGE, 0.5, False)
    # Folded is the end of the contraction.
    at = int(np.argmin(np.abs(curve["t"] - HINGE.t_fin)))
    assert curve["t"].iloc[at] == pytest.approx(HINGE.t_fin)
    assert (
        heavy["folded"] == curve["angle"].iloc[at] and heavy["at_last"] == curve["angle"].iloc[-1]
    )
    assert heavy["lost"] == pytest.approx(1 - heavy["at_last"] / heavy["folded"])
    assert curve["t"].iloc[-1] == pytest.approx(2.0) and heavy["steps"] == len(curve) - 1
    assert heavy["lost"] > 0.01 > abs(light["lost"]) and light["folded"] > heavy["folded"] > 0
    assert (heavy["fraction"], heavy["weight"], light["weight"]) == (0.5, True, False)
    more, _ = creeping_hinge.follow(HINGE, 0.75, True)
    assert more["lost"] > heavy["lost"]


def test_a_furrow_is_followed_in_equal_steps_and_pictured_at_its_start_middle_and_end():
    config = furrow.Config(steps=4, contraction=0.05, t_fin=0.08)
    model = furrow_case.build(0, element="hex8", contraction=0.05)
    row, history, shapes = furrow.follow(config, model, "hex8:0")
    assert history["t"].tolist() == pytest.approx([0, 0.02, 0.04, 0.06, 0.08])
    assert history["load"].tolist() == pytest.approx([0, 0.25, 0.5, 0.75, 1.0])
    assert [load for load, _ in shapes] == pytest.approx([0, 0.5, 1.0])
    assert not shapes[0][1].any() and np.abs(shapes[2][1]).max() > np.abs(shapes[1][1]).max() > 0
    for name in ("depth", "indentation", "cavity"):
        assert row[name] == history[name].iloc[-1]
    assert row["dissipated"] == history["dissipated"].iloc[-1] > 0
    assert (row["steps"], row["elements"]) == (4, len(model.body.cells))
    assert row["internal"] == 6 * model.body.weights.size and row["iterations"] >= 4
    assert row["peak_memory_mb"] > 50 and row["unknowns"] > 0


def test_a_mesh_is_an_element_and_a_level(tracker):
    for mesh, says in (("hex8", "mesh 'hex8'; expected element:level"), ("hex9:0", "hex9")):
        with pytest.raises(InputError, match=says):
            furrow.run(furrow.Config(meshes=(mesh,)), tracker)


def test_the_tubes_closure_at_three_places_is_drawn(tracker, monkeypatch):
    seen = {}

    def study(config, tracker, name, build, shown, axes, draw):
        seen.update(name=name, build=build, shown=shown, second=axes[1], draw=draw)
        return {"table": [1]}

    monkeypatch.setattr(neural_tube, "study", study)
    assert neural_tube.run(neural_tube.TINY, tracker) == {"table": [1]}
    assert seen["shown"] == ("closure", "closure_middle", "closure_posterior")
    assert seen["second"][0] == "closed" and seen["name"] == "neural_tube"
    assert seen["build"] is neural_tube.neural_tube.build and seen["draw"] is neural_tube.draw


def test_problem_p_has_a_row_for_each_element_and_mesh_with_its_error_at_its_contraction(
    tracker, monkeypatch
):
    asked = []

    def mesh(sizes, element, *, bent):
        asked.append((element, bent))
        return sizes

    def follow_to(scene, steps):
        asked[-1] += (steps,)
        point = SimpleNamespace(x=0, e=1.0, unstable=2)
        start = SimpleNamespace(x=0, e=0.0, unstable=0)
        return SimpleNamespace(
            points=[start, point], last=point, iterations=9, reached=scene.element != "tet4",
            outcome=SimpleNamespace(value="told"),
        )  # fmt: skip

    def scene(body, g, *, growth):
        return SimpleNamespace(size=100, element=asked[-1][0], growth=growth)

    monkeypatch.setattr(problem_p.problem_p, "mesh", mesh)
    monkeypatch.setattr(problem_p.problem_p, "scene", scene)
    monkeypatch.setattr(
        problem_p.problem_p, "fold_angle", lambda s, x, e: 0.9 * e * problem_p.ANGLES[s.growth]
    )
    monkeypatch.setattr(problem_p, "follow_to", follow_to)
    monkeypatch.setattr(problem_p, "picture", lambda *_: None)
    monkeypatch.setattr(problem_p, "write_series", lambda *_: SimpleNamespace(path="there"))
    config = problem_p.Config(
        levels=(0, 1), isotropic_levels=(2,), elements=("hex27", "tet4"), steps=6
    )
    result = problem_p.run(config, tracker)
    rows = result["table"]
    assert [(r["growth"], r["element"], r["level"]) for r in rows] == [
        ("uniaxial", "hex27", 0), ("uniaxial", "hex27", 1), ("uniaxial", "tet4", 0),
        ("uniaxial", "tet4", 1), ("isotropic", "hex27", 2), ("isotropic", "tet4", 2),
    ]  # fmt: skip
    # Isotropic paths take three times as many steps, on meshes that are not bent.
    assert asked[0] == ("hex27", True, 6) and asked[-1] == ("tet4", False, 18)
    for row in rows:
        if row["element"] == "tet4":
            assert row["angle"] is row["error"] is None
        else:
            assert row["error"] == pytest.approx(0.1)
            assert row["angle"] == pytest.approx(0.9 * problem_p.ANGLES[row["growth"]])
        assert (row["unknowns"], row["iterations"], row["unstable"]) == (100, 9, 2)
    curves = tracker.tables["curves"]
    assert curves["g"].tolist() == [0.0, -0.3] * 6 and curves["unstable"].tolist() == [0, 2] * 6
    other = problem_p.run(replace(config, g=-0.2), tracker)
    assert {row["error"] for row in other["table"]} == {None}
