"""Parts (a) to (c) of accuracy_vs_time: errors of elements, of steppers and of the quarter."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments._accuracy import paths, plots
from experiments._accuracy.paths import UNIT_LEVELS, UNITS, P, Solved
from experiments.accuracy_vs_time import Config
from foldlab.labels.foldability import Thresholds
from solver.cases.unit import problem_p

ROW = {"unknowns": 10, "core_seconds": 2.0, "outcome": "reached"}


def test_an_error_is_of_the_larger_of_the_angle_and_what_counts_as_folded():
    assert paths._error(1.1, 1.0, 0.5) == pytest.approx(0.1)
    assert paths._error(0.1, 0.2, 0.5) == pytest.approx(0.2)
    assert paths._error(-1.1, -1.0, 0.5) == pytest.approx(0.1)
    assert paths._error(None, 1.0, 0.5) is None


def test_problem_p_is_solved_for_its_angle_or_not_at_all(monkeypatch):
    made = paths.solved(P, "hex20", 0)
    assert made.angle == pytest.approx(problem_p.ANGLE, rel=0.1)
    assert made.scale == pytest.approx(0.3 * np.pi) and made.folding is None
    assert made.row["steps"] >= 12 and made.row["outcome"] == "reached"
    assert made.row["iterations"] > made.row["steps"] and made.row["core_seconds"] > 0
    whole = paths.solved(P, "hex20", 0, whole=True)
    assert whole.angle == pytest.approx(made.angle, rel=1e-5)
    assert 3 < whole.row["unknowns"] / made.row["unknowns"] < 5
    stuck = SimpleNamespace(
        reached=False, iterations=3, points=[0, 0], outcome=SimpleNamespace(name="STUCK")
    )
    monkeypatch.setattr(paths, "trace", lambda *_, **__: stuck)
    lost = paths.solved(P, "hex20", 0)
    assert lost.angle is None and lost.row["steps"] == 1 and lost.row["outcome"] == "stuck"


@pytest.mark.parametrize("ending", ["REACHED", "TIMEOUT"])
def test_a_unit_is_followed_on_the_mesh_and_in_the_time_that_it_is_given(ending, monkeypatch):
    seen = {}

    def build(unit, meshing, *, supports, watch):
        seen.update(unit=unit, meshing=meshing, mirrors=supports.mirrors, watch=watch)

    folding = SimpleNamespace(
        ending=paths.unit_path.Ending[ending], states=[0] * 7, iterations=20,
        model=SimpleNamespace(scene=SimpleNamespace(size=99)), last=SimpleNamespace(curves="c"),
    )  # fmt: skip
    monkeypatch.setattr(paths.folding_unit, "build", build)
    monkeypatch.setattr(paths.unit_path, "fold", lambda model: folding)
    monkeypatch.setattr(paths, "core_seconds", lambda: 500.0)
    monkeypatch.setattr(
        paths.foldability, "measure",
        lambda curves, length: SimpleNamespace(m1=2.0 if (curves, length) == ("c", 0.25) else 0.0),
    )  # fmt: skip
    made = paths.solved("grounded", "hex20", 1, limit=7.0)
    assert made.angle == (2.0 if ending == "REACHED" else None)
    assert made.scale == Thresholds().angle(0.2) and made.folding is folding
    assert seen["meshing"].level is UNIT_LEVELS[1] and seen["meshing"].element == "hex20"
    assert seen["watch"].deadline == 507.0 and seen["mirrors"] == ("x", "y")
    assert seen["unit"].stiffness_to_weight == 0.02
    assert (made.row["unknowns"], made.row["iterations"], made.row["steps"]) == (99, 20, 6)
    assert made.row["outcome"] == ending.lower()
    paths.solved("grounded", "hex20", 1, whole=True)
    assert seen["mirrors"] == () and seen["watch"].deadline == 560.0


def references(monkeypatch, coarse, fine=None, refined=None, folding="folding"):
    asked = []

    def solved(scene, element, level, *, limit):
        asked.append((element, level, limit))
        angle = coarse if len(asked) == 1 else fine
        return Solved(angle, 0.5, ROW, folding if len(asked) == 1 else None)

    monkeypatch.setattr(paths, "solved", solved)
    monkeypatch.setattr(
        paths.unit_path, "refined", lambda given, mesh: refined if mesh is UNIT_LEVELS[3] else 1 / 0
    )
    monkeypatch.setattr(paths, "_angle", lambda folding, design: folding)
    return asked


def test_a_reference_is_refined_from_the_coarser_mesh_and_states_its_change(monkeypatch):
    asked = references(monkeypatch, 1.9, refined=2.0)
    assert paths.reference("folds", 10.0, 3) == (2.0, pytest.approx(0.05))
    assert asked == [("hex27", 2, 10.0)]
    # Where the state lies elsewhere the path is followed, in four times the time.
    asked = references(monkeypatch, 0.3, fine=0.4)
    assert paths.reference("folds", 10.0, 3) == (0.4, pytest.approx(0.2))
    assert asked == [("hex27", 2, 10.0), ("hex27", 3, 40.0)]
    asked = references(monkeypatch, 1.9, fine=2.0, folding=None)
    assert paths.reference(P, 10.0, 3)[0] == 2.0 and len(asked) == 2
    for coarse, fine in ((None, 2.0), (1.9, None)):
        references(monkeypatch, coarse, fine=fine)
        with pytest.raises(RuntimeError, match="folds: no reference on level 3"):
            paths.reference("folds", 10.0, 3)


def test_each_element_has_a_row_for_each_of_its_meshes(monkeypatch):
    asked = []

    def solved(scene, element, level, limit=None):
        asked.append((scene, element, level))
        return Solved(None if level == 1 else 1.1, 0.5, ROW)

    monkeypatch.setattr(paths, "solved", solved)
    monkeypatch.setattr(paths, "reference", lambda scene, limit, level: (1.0, 1e-4 * level))
    config = Config(scenes=(P, "folds"), elements=("tet4", "hex20"), levels=(0, 1),
                    first_order_levels=(2,), reference=3)  # fmt: skip
    said = []
    rows, reference = paths.elements(config, said.append)
    assert said == rows
    assert asked[:2] == [(P, "tet4", 0), (P, "hex20", 0)]  # to compile
    assert [(r["scene"], r["element"], r["level"]) for r in rows] == [
        (scene, *rest) for scene in (P, "folds")
        for rest in (("tet4", 2), ("hex20", 0), ("hex20", 1))
    ]  # fmt: skip
    assert [r["error"] for r in rows[:3]] == [pytest.approx(0.1), pytest.approx(0.1), None]
    assert rows[0]["core_seconds"] == 2.0
    assert reference[1] == {"scene": "folds", "angle": 1.0, "changed_from_coarser": 1e-4 * 3}


def test_the_whole_is_compared_with_its_quarter(monkeypatch):
    def solved(scene, element, level, *, whole, limit):
        assert element == "hex27" and limit == 9.0
        lost = scene == "folds" and not whole
        seconds = 12.0 if whole else 3.0
        return Solved(None if lost else 1.0 + 0.1 * whole, 0.5, ROW | {"core_seconds": seconds})

    monkeypatch.setattr(paths, "solved", solved)
    config = Config(scenes=(P, "folds"), whole_levels=(0,), limit=9.0)
    rows = paths.wholes(config, lambda _: None)
    quarter, whole, _, alone = rows
    assert (quarter["model"], whole["model"]) == ("quarter", "whole")
    assert quarter["ratio"] is quarter["apart"] is None
    assert whole["ratio"] == 4.0 and whole["apart"] == pytest.approx(0.1)
    assert alone["apart"] is None and alone["ratio"] == 4.0
    figure = plots.draw_wholes(rows)
    (ax,) = figure.axes
    assert [bar.get_height() for bar in ax.patches] == [3.0, 3.0, 12.0, 12.0]
    assert ax.texts[0].get_text() == "×4.0\napart 1e-01" and ax.texts[1].get_text() == "×4.0"


def test_steppers_are_compared_with_steps_half_as_long_along_the_path_and_at_its_end(monkeypatch):
    asked = []

    def trace(scene, start, stepper, *, max_steps, events):
        asked.append((type(stepper).__name__, stepper.rtol, stepper, max_steps))
        finest = stepper.rtol == 1e-12
        loads = np.linspace(0, 1, 5 if finest else 3)
        # The angle is 2 e²: a chord over half of it is off by 2/16, in its middle.
        points = [SimpleNamespace(x=2 * e**2 if finest or e < 1 else 2.02, e=e) for e in loads]
        return SimpleNamespace(
            points=points, loads=loads, last=points[-1], reached=stepper.rtol != 1e-3,
            iterations=8, outcome=SimpleNamespace(name="REACHED", value="so"),
        )  # fmt: skip

    monkeypatch.setattr(paths, "trace", trace)
    monkeypatch.setattr(paths, "_stepping", lambda name, level: ("s", 0, lambda x, e: x, 0.3))
    config = Config(stepper_scenes=(P,), steps=(4, 10), rtols=(1e-3, 1e-6))
    rows = paths.steppers(config, lambda _: None)
    (kind, rtol, finest, most), *rest = asked
    assert (kind, rtol, finest.step, most) == ("LoadSteps", 1e-12, 1 / 20, 2000)
    assert [a[:2] for a in rest] == [("LoadSteps", r) for r in (1e-3, 1e-6)] * 4 + [
        ("ArcLength", r) for r in (1e-3, 1e-6)
    ] * 2
    assert [a[2].order for a in rest[:8]] == [3] * 4 + [0] * 4 and rest[0][2].step == 0.25
    arc = rest[-1][2]
    assert arc.a == pytest.approx(0.03) and arc.b == pytest.approx(0.1)
    lost, made = rows[0], rows[1]
    assert lost["error"] is lost["end_error"] is None and lost["rtol"] == 1e-3
    # Chords of halves against chords of quarters, of an angle of 2.
    assert made["end_error"] == pytest.approx(0.01)
    e = np.linspace(0, 1, 401)
    off = np.interp(e, [0, 0.5, 1], [0, 0.5, 2.02]) - np.interp(
        e, np.linspace(0, 1, 5), 2 * np.linspace(0, 1, 5) ** 2
    )
    assert made["error"] == pytest.approx(np.abs(off).max() / 2)
    assert (made["steps"], made["iterations"], made["steps_asked"]) == (2, 8, 4)


def test_the_flat_sheets_angle_is_no_full_turn(monkeypatch):
    monkeypatch.setattr(paths.problem_p, "fold_angle", lambda scene, x, e: x)
    angle = paths._turning("scene")
    assert angle(6.28, 0.1) == pytest.approx(6.28 - 2 * np.pi)
    assert angle(6.1, 0.1) == 6.1 and angle(6.28, 0.9) == 6.28


def test_scenes_are_of_three_weights():
    weights = [
        UNITS[name]["stiffness_to_weight"] for name in ("folds", "near lift-off", "grounded")
    ]
    assert weights == [1.0, 0.05, 0.02]


def test_pictures_of_elements_leave_out_what_has_no_error():
    rows = [
        {"scene": "a", "element": "hex20", "core_seconds": s, "error": e}
        for s, e in ((1.0, 0.1), (2.0, None), (3.0, 0.0))
    ]
    (ax,) = plots.draw_elements(rows).axes
    assert ax.lines[0].get_xydata().tolist() == [[1.0, 0.1], [3.0, 1e-7]]


def test_pictures_of_steppers_count_the_paths_that_end_early():
    rows = [
        {"scene": "a", "stepper": "load steps", "rtol": 1e-3, "core_seconds": 1.0, "error": 0.1,
         "end_error": 0.0},
        {"scene": "a", "stepper": "arc length", "rtol": 1e-6, "core_seconds": 2.0, "error": None,
         "end_error": None},
    ]  # fmt: skip
    path, end = plots.draw_steppers(rows).axes
    assert path.get_title() == "a: 1 of 2 paths end early"
    drawn = [line.get_xydata().tolist() for line in path.lines if len(line.get_xdata())]
    assert drawn == [[[1.0, 0.1]]]
    floored = [line.get_xydata().tolist() for line in end.lines if len(line.get_xdata())]
    assert floored == [[[1.0, plots.FLOOR]]]


def test_pictures_of_classifiers_and_budgets_show_errors():
    rows = [
        {"model": "tree", "labels": 10, "accuracy": a, "label_core_seconds": 5.0,
         "train_seconds": 0.5, "seconds_per_million": 2.0}
        for a in (0.8, 0.9)
    ]  # fmt: skip
    axes = plots.draw_classifiers(rows).axes
    drawn = [ax.lines[0].get_xydata()[0] for ax in axes]
    assert np.array(drawn) == pytest.approx(np.array([[5.0, 0.15], [0.5, 0.15], [2.0, 0.15]]))
    rows = [
        {"labels_are": "coarse", "budget": 10.0, "accuracy": a, "labels": 3} for a in (0.8, 0.9)
    ] + [{"labels_are": "Timoshenko", "budget": 0.1, "accuracy": 0.6, "labels": 200}]
    (ax,) = plots.draw_budgets(rows, [{"labels_are": "coarse", "accuracy": 0.97}]).axes
    mean, hour, formula, _ = ax.lines
    assert mean.get_xydata()[0] == pytest.approx([10.0, 0.15])
    assert hour.get_xydata()[0] == pytest.approx([3600, 0.03])
    assert formula.get_ydata() == pytest.approx([0.4, 0.4])
    band = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (pytest.approx(0.1), pytest.approx(0.2))
