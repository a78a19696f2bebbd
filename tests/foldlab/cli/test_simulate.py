"""``foldlab simulate`` as a user meets it, and what it asks of the solver's label source."""

import json
import sys

import numpy as np
import pytest
import pyvista
from PIL import Image

from foldlab.cli import app as cli
from foldlab.labels import foldability
from foldlab.labels.asked import Conditions
from foldlab.labels.solver import SolverSource
from foldlab.unit import render

GROUPS = {
    "E_ratio": 0.1,
    "h_ratio": 5,
    "hinge_length": 0.2,
    "aspect": 0.2,
    "slenderness": 4e-3,
    "contraction": 0.3,
}
HEAVY = {**GROUPS, "rho_ratio": 1.0, "hinge_width": 1.0, "stiffness_to_weight": 1.0}
PROBLEM_P = 3.772  # rad; references: two independent codes agree within 0.1 %


def sets(**groups):
    return " ".join(f"--set {name}={value}" for name, value in groups.items())


@pytest.fixture
def simulate(tmp_path, monkeypatch, capsys):
    """Call the verb in a fresh folder; returns (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def call(line):
        monkeypatch.setattr(sys, "argv", ["foldlab", "simulate", *line.split()])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out = capsys.readouterr()
        return end.value.code, out.out, out.err

    return call


def test_problem_p_in_numbers_files_and_pictures(simulate, tmp_path):
    line = f"{sets(**GROUPS)} --effects none --growth uniaxial --accuracy 0.05 -o p --json"
    status, out, err = simulate(line)
    assert (status, err.count("\n"), out.count("\n")) == (0, 1, 1)
    result = json.loads(out)
    told = result["expected"]
    assert err.startswith("expected: ") and f"{told['memory_mb']:.0f} MB" in err
    assert 0 < told["low"] <= told["seconds"] <= told["high"] < 60
    assert result["fold_angle"] == pytest.approx(PROBLEM_P, rel=0.01)
    assert result["measures"]["m1"] == result["fold_angle"]
    assert set(result["tags"].values()) == {True} and result["foldable"] and result["stable"]
    assert (result["outcome"], result["unstable_modes"]) == ("folds", 0)
    assert abs(result["fold_angle"] / PROBLEM_P - 1) < result["error_estimate"] < 0.05
    assert result["effects"] == ["elastic"]
    assert result["rest_gap"] is None and result["penetration"] is None
    assert result["contraction_reached"] == 0.3
    assert result["need"] == pytest.approx(0.3 * np.pi)
    assert result["turning_hinge"] + result["turning_ends"] == pytest.approx(PROBLEM_P, rel=0.02)
    assert result["strain"]["passive"] == pytest.approx(0.0774, rel=0.03)
    assert set(result["stress"]) == {"passive", "active"}
    assert set(result["interface"]) == {"opening", "shear"}
    assert result["peak_errors"]["strain"]["passive"] < 0.1
    # What acts on nothing is not made up.
    assert result["design"]["stiffness_to_weight"] is None
    assert result["design"]["hinge_width"] == 1
    for name in ("seconds", "peak_memory_mb", "unknowns", "steps", "iterations"):
        assert result[name] > 0, name
    files = [
        "result.json",
        "curves.npz",
        "series/unit.pvd",
        "shapes.png",
        "angle.png",
        "strain.png",
    ]
    assert result["files"] == [f"p/{name}" for name in files]
    kept = json.loads((tmp_path / "p" / "result.json").read_text())
    assert kept["label"]["evidence"]["history"][-1][1] == pytest.approx(kept["fold_angle"])
    assert [row["m1"] for row in kept["path"]][-1] == kept["fold_angle"]
    curves = np.load(tmp_path / "p" / "curves.npz")
    assert curves["curves"].shape == (result["steps"], 4, 1000, 3)
    again = foldability.measure(curves["curves"][-1], GROUPS["hinge_length"])
    assert again.m1 == pytest.approx(result["fold_angle"])
    for name in ("shapes.png", "angle.png", "strain.png"):
        with Image.open(tmp_path / "p" / name) as image:
            assert image.size[0] >= 1800 and np.asarray(image.convert("L")).std() > 5
    check_series(tmp_path / "p" / "series" / "unit.pvd", curves)


def check_series(path, curves):
    """All states, of the whole unit, mirrored the right way round, as the curves have it."""
    reader = pyvista.get_reader(str(path))
    assert reader.time_values == list(range(len(curves["load"])))
    for k in range(len(curves["load"])):
        reader.set_active_time_point(k)
        unit = reader.read()[0]
        assert unit.field_data["load"] == pytest.approx(curves["load"][k])
        np.testing.assert_allclose(unit.bounds, (-0.1, 0.1, -0.5, 0.5, 0, 0.024), atol=1e-12)
        det = np.linalg.det(unit.cell_data["F"].reshape(-1, 3, 3))
        assert det.min() > 0.3, "a displacement mirrored the wrong way tears the unit at its planes"
        shape = unit.warp_by_vector("displacement")
        for end, wanted in ((-0.5, curves["curves"][k, 0, 0]), (0.5, curves["curves"][k, 0, -1])):
            # The node nearest to the curve's end, on the middle of the sheet.
            off = np.linalg.norm(unit.points - (0, end, 0.002), axis=1)
            assert off.min() < 0.001
            assert np.linalg.norm(shape.points[off.argmin()] - wanted) < 1.1 * off.min() + 1e-6


@pytest.mark.parametrize(
    "line, message",
    [
        (sets(**GROUPS), "lacks stiffness_to_weight (gravity acts"),
        (sets(**{**GROUPS, "stiffness_to_weight": 0}), "stiffness_to_weight = 0; expected"),
        (f"{sets(E_ratio=0.1, aspect=1)} --effects none", "lacks hinge_length, h_ratio, slender"),
        (f"{sets(**GROUPS, gamma=1)}", "no group 'gamma' in the full space"),
        (f"{sets(**{**GROUPS, 'aspect': 'wide'})}", "aspect = 'wide': expected a plain number"),
        (f"{sets(**{**HEAVY, 'hinge_width': 2})}", "hinge_width = 2; expected at most 1"),
        (f"{sets(**HEAVY)} --effects gravity", "effects 'gravity'; expected"),
        (f"{sets(**HEAVY)} --growth sideways", "growth 'sideways'; expected"),
        (f"{sets(**HEAVY)} --question exists", "set growth=isotropic"),
        (f"{sets(**HEAVY)} --barrier soft", "barrier 'soft'; expected"),
        (f"{sets(**HEAVY)} --need 0", "need = 0.0; expected a finite number above 0"),
        (f"{sets(**HEAVY)} --shear -1", "shear = -1.0; expected a finite number above 0"),
        (f"{sets(**HEAVY)} --accuracy 0", "accuracy = 0.0; expected"),
        (
            f"{sets(**HEAVY)} --strips 999 --timeout 1",
            "strips = 999; expected a whole number up to 50",
        ),
        (f"{sets(**HEAVY, strips=3)} --strips 3", "leave the setting out"),
        (sets(**HEAVY, strip_share=0.5), "lacks strips; add"),
        (sets(**HEAVY, strips=2.5, strip_share=0.5), "strips = 2.5; expected a whole number"),
        (f"{sets(**HEAVY)} --animate --no-pictures", "--animate draws a picture"),
        (f"{sets(**HEAVY)} --ablate", "--ablate belongs to --why"),
        (f"{sets(**HEAVY)} -o taken/deeper", "can't make the folder taken/deeper: taken is a file"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(simulate, tmp_path, line, message):
    (tmp_path / "taken").write_text("a file")
    status, out, err = simulate(f"{line} --json")
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_out_of_time_keeps_what_there_is(simulate, tmp_path):
    """A deadline that had passed when the first model was built raised OutOfTime."""
    (tmp_path / "old" / "series").mkdir(parents=True)
    for name in ("shapes.png", "fold.gif", "series/unit.pvd", "series/unit_00000.vtu", "mine.txt"):
        (tmp_path / "old" / name).write_text("of another design")
    thick = sets(**{**HEAVY, "h_ratio": 10, "slenderness": 0.03})
    status, out, err = simulate(f"{thick} --timeout 0.001 -o old --json")
    assert status == 3 and "not reached: unknown: the time allowed was used up" in err
    assert "warning: the active layer is 0.3 l_s thick and the hinge only 0.2 l_s long" in err
    kept = json.loads((tmp_path / "old" / "result.json").read_text())
    for result in (kept, json.loads(out)):
        assert (result["foldable"], result["outcome"], result["fold_angle"]) == (
            None,
            "timeout",
            None,
        )
        assert result["effects"] == ["elastic", "gravity", "ground"]
    kept = sorted(path.name for path in (tmp_path / "old").rglob("*") if path.is_file())
    assert kept == ["mine.txt", "result.json"]


def test_an_accuracy_that_was_not_reached_is_told(simulate, tmp_path):
    small = sets(**{**GROUPS, "contraction": 0.05})
    line = f"{small} --effects none --accuracy 1e-3 --no-pictures --json"
    status, out, err = simulate(line)
    assert status == 3 and json.loads(out)["foldable"] is True
    error = json.loads(out)["error_estimate"]
    # Missed by a little is missed.
    assert 1e-3 < error < 4e-3
    assert f"not reached: the error of the angle is {100 * error:.2g} %, 0.1 % was asked" in err
    assert (tmp_path / "out" / "simulate" / "result.json").exists()
    assert simulate(line.replace("1e-3", "0.05"))[0] == 0


def test_weight_is_in_the_summary_and_in_the_film(simulate, tmp_path):
    (tmp_path / "c.toml").write_text("E_ratio = 0.1\nrho_ratio = 0.1\ncontraction = 0.1\n")
    more = {n: v for n, v in HEAVY.items() if n not in ("E_ratio", "rho_ratio", "contraction")}
    line = f"--config c.toml {sets(**more)} --accuracy 0.1 --animate -o g"
    status, out, err = simulate(line)
    assert (status, err.count("\n")) == (0, 1) and err.startswith("expected: ")
    assert "m1 turning along the sheet" in out and "events: lift-off at" in out
    assert "effects: elastic, gravity, ground" in out and "g/fold.gif" in out
    result = json.loads((tmp_path / "g" / "result.json").read_text())
    # physics.md §3, over h_s
    assert 0 <= result["rest_gap"] <= 0.25 and 0 < result["penetration"] <= 0.1
    with Image.open(tmp_path / "g" / "fold.gif") as film:
        assert film.n_frames == result["steps"]


def test_where_nothing_renders_the_unit_is_drawn_from_the_side(simulate, tmp_path, monkeypatch):
    # The process that would draw ends at once, as VTK's does without a driver.
    monkeypatch.setattr(render.sys, "executable", "false")
    groups = sets(**{**GROUPS, "contraction": 0.05})
    status, out, err = simulate(f"{groups} --effects none --accuracy 0.1 --animate -o s --json")
    assert status == 0
    assert err.count("\n") == 2 and "VTK can't render here: shapes.png shows the unit from" in err
    names = [path.split("/")[-1] for path in json.loads(out)["files"]]
    assert names == ["result.json", "curves.npz", "unit.pvd", "shapes.png", "angle.png"]
    with Image.open(tmp_path / "s" / "shapes.png") as image:
        assert np.asarray(image.convert("L")).std() > 5
    assert not (tmp_path / "s" / "fold.gif").exists()


def test_an_angle_that_is_needed_and_what_breaks_on_the_way(simulate):
    line = f"{sets(**GROUPS)} --effects none --accuracy 0.05 --no-pictures -o p"
    status, out, _ = simulate(f"{line} --need 3 --passive-strain 0.05 --json")
    found = json.loads(out)
    assert (status, found["foldable"], found["outcome"]) == (0, False, "breaks")
    assert "more than the 3 rad" in found["reason"] and "0.05 borne" in found["reason"]
    status, out, _ = simulate(f"{line} --need 4")
    assert status == 0 and "too_little" in out and "> 4 rad" in out
    assert "passive 0.077" in out


def test_a_folded_state_is_looked_for_on_a_mesh_that_may_curl(tmp_path):
    """The release got displacements of a mesh with fewer nodes, and raised."""
    source = SolverSource(Conditions(effects="none", growth="isotropic"), question="exists")
    run = source.run({**HEAVY, "contraction": 0.05}, 0)
    assert run.settled
    loads = [shape.load for shape in run.shapes]
    assert loads == sorted(loads) and loads.count(1.0) == 2 and loads[-1] == 2
    # Contraction along the fold, too, curls the hinge.
    at = loads.index(1.0)
    assert run.history[at]["m2"] < 0.01 < run.history[-1]["m2"]
    assert run.write_series(tmp_path / "unit.pvd") == loads


def test_a_unit_that_is_free_topples():
    """It stayed on the symmetric quarter, where nothing tips over."""
    held, free = (
        SolverSource(Conditions(upright=upright)).run({**HEAVY, "contraction": 0.12}, 0)
        for upright in (True, False)
    )
    for run in (held, free):
        assert run.settled and [h.kind for h in run.folding.happenings] == ["toppling"]
    assert held.folding.last.topples and not free.folding.last.topples
    for run, mirrors in ((held, ("x", "y")), (free, ("x",))):
        assert run.shapes[-1].model.mirrors == mirrors
    # One panel's end is lower than the other's; on one side or the other.
    ends = free.shapes[-1].state.curves[0, [0, -1], 2]
    assert abs(ends[0] - ends[1]) > 0.02
    assert free.history[-1]["m1"] == pytest.approx(held.history[-1]["m1"], rel=0.01)


def test_why_is_told_to_the_eye_and_in_json(simulate, tmp_path):
    line = f"{sets(**HEAVY)} --accuracy 0.1 --no-pictures --why --ablate -o w"
    status, out, _ = simulate(line)
    assert status == 0
    assert "what each effect contributed" in out and "without gravity,ground: " in out
    kept = json.loads((tmp_path / "w" / "result.json").read_text())["why"]
    assert [row["effect"] for row in kept["effects"]] == ["elastic", "gravity", "ground", "solving"]
    (bare,) = kept["without"]
    status, out, _ = simulate(f"{sets(**HEAVY)} --accuracy 0.1 --no-pictures --effects none --json")
    alone = json.loads(out)
    assert alone["fold_angle"] == pytest.approx(bare["fold_angle"], rel=1e-9)
    assert "why" not in alone and alone["plan"]["element"] == "hex27"
    assert all(sentence in simulate(line)[1] for sentence in kept["advice"][:1])


def test_materials_that_change_on_the_way(simulate):
    line = f"{sets(**GROUPS)} --effects none --accuracy 0.1 --no-pictures --json"
    status, out, _ = simulate(f"{line} --active-stiffness 2")
    assert status == 0
    changed = json.loads(out)["fold_angle"]
    status, out, _ = simulate(line.replace("E_ratio=0.1", "E_ratio=0.2"))
    assert changed == pytest.approx(json.loads(out)["fold_angle"], rel=1e-4)
    status, _, err = simulate(f"{line} --passive-density -1")
    assert status == 2 and "passive_density = -1.0" in err


def test_friction_is_an_effect_where_it_is_asked_for(simulate):
    line = f"{sets(**{**HEAVY, 'contraction': 0.02})} --accuracy 0.2 --no-pictures --json"
    effects = [json.loads(simulate(line + more)[1])["effects"] for more in ("", " --friction 0.3")]
    assert effects[1] == [*effects[0], "friction"]
    status, _, err = simulate(line + " --friction -1")
    assert status == 2 and "friction = -1; expected a number from 0 on" in err
