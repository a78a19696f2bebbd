"""``foldlab check`` and ``foldlab materials`` as a maker meets them."""

import json

import pytest

from foldlab.labels.solver import SolverSource

SIZES = "--set l_s=40mm --set b_s=10mm --set h_s=0.1mm --set h_i=0.2mm --set l_i=10mm"
PET = f"--passive PET --active SMP {SIZES} --set contraction=20%"
SILICONE = (
    "--set l_s=100mm --set b_s=25mm --set h_s=1mm --set h_i=1mm --set l_i=20mm "
    "--set contraction=20% --set E_s=1MPa --set rho_s=1000 --set E_i=0.3MPa --set rho_i=1000"
)


def test_a_unit_in_millimetres_and_materials_is_answered_in_degrees(foldlab, tmp_path):
    status, out, err = foldlab(f"check {PET} --accuracy 0.05 -o c")
    assert status == 0
    assert err.startswith("first answer, of a rod: folds by 39.") and " rad" not in err + out
    assert "metres" not in err
    lines = dict(line.split(": ", 1) for line in out.splitlines())
    assert lines["folds"] == "yes" and lines["to change"] == "nothing"
    assert lines["angle"].startswith("39") and "36° count as folded" in lines["angle"]
    assert "passive 0.4" in lines["strain"] and "bears it: its limit is 2 to 4 %" in lines["strain"]
    assert "units fold by the rod" in lines["over the materials"]
    assert "E_i 0.5 MPa to 30 MPa" in lines["over the materials"]
    assert "h_i above 0.1" in lines["it stays so for"]
    saved = json.loads((tmp_path / "c" / "result.json").read_text())
    assert saved["physical"]["l_s"] == 0.04 and saved["label"]["foldable"] is True
    assert {"shapes.png", "angle.png", "curves.npz"} <= {p.name for p in (tmp_path / "c").iterdir()}


def test_what_does_not_fold_is_told_with_a_change_that_the_solver_confirmed(foldlab):
    status, out, err = foldlab(f"check {SILICONE} --accuracy 0.05 --no-pictures --json")
    assert status == 0 and "first answer" in err
    told = json.loads(out)
    assert told["foldable"] is False and told["confirmed"] is True
    change = told["change"]
    assert change["from"] == told["physical"][change["quantity"]]
    # The changed unit folds, asked anew.
    again = SILICONE + f" --set {change['quantity']}={change['to']!r}"
    status, out, _ = foldlab(f"check {again} --accuracy 0.05 --no-pictures --json -o again")
    assert json.loads(out)["foldable"] is True
    assert json.loads(out)["fold_angle"] == pytest.approx(change["fold_angle"])


def test_a_quick_answer_needs_no_solver_and_leaves_no_files(foldlab, tmp_path, monkeypatch):
    monkeypatch.setattr(SolverSource, "follow", None)
    status, out, _ = foldlab(f"check {PET} --quick --json")
    told = json.loads(out)
    assert status == 0 and told["foldable"] is True and told["confirmed"] is False
    assert 0.6 < told["fold_angle"] < 0.8 and not list(tmp_path.iterdir())
    # What counts as folded may be said in degrees.
    status, out, _ = foldlab(f"check {PET} --quick --json --need 90deg")
    assert json.loads(out)["foldable"] is False
    status, _, err = foldlab(f"check {PET} --quick --growth isotropic")
    assert status == 3 and "leave --quick out" in err and "solver is asked" not in err


@pytest.mark.parametrize(
    "line, words",
    [
        (f"check {SIZES}", "lacks E_s, rho_s, E_i, rho_i, contraction"),
        (f"check {PET} --set h_s=0.1MPa", "h_s = '0.1MPa': expected a quantity in m, such as 40mm"),
        (f"check {PET} --passive cheese", "no passive material 'cheese'"),
        (f"check {PET} --need 90mm", "an angle, such as 90deg"),
        (f"check {PET} --need 90", "need = 90 rad is more than a full turn; 90 degrees are 90deg"),
        (f"check {PET} --set length=4mm", "no quantity 'length' that has a unit; there are E_s,"),
        (f"check {PET} --growth sideways", "growth 'sideways'"),
        (f"check {PET} --materials no.csv", "give a readable CSV file"),
    ],
)
def test_wrong_input_is_one_sentence_and_no_file(foldlab, tmp_path, line, words):
    status, out, err = foldlab(line)
    assert (status, out) == (2, "") and words in err
    assert err.count("error: ") == 1 and "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_a_sheet_of_many_metres_is_asked_about(foldlab):
    bare = SIZES.replace("mm", "")
    status, out, err = foldlab(f"check {PET.replace(SIZES, bare)} --quick")
    assert status == 0 and "folds: no" in out
    assert "l_s is 40 m: numbers without a unit are in metres" in err


def test_simulate_takes_the_same_quantities(foldlab):
    line = f"simulate {PET} --accuracy 0.2 --no-pictures --json"
    status, out, _ = foldlab(line)
    told = json.loads(out)
    assert status == 0 and told["design"]["hinge_length"] == pytest.approx(0.25)
    assert told["design"]["stiffness_to_weight"] == pytest.approx(40.97, rel=1e-3)


def test_materials_are_listed_with_what_they_rest_on(foldlab, tmp_path):
    status, out, _ = foldlab("materials")
    assert status == 0 and "PET, polyester, Mylar" in out and "2 to 4" in out
    own = tmp_path / "own.csv"
    own.write_text(
        "name,role,E_low,E_high,rho_low,rho_high,contraction_low,contraction_high\n"
        "slate,passive,1e10,1e10,2700,2700,,\n"
    )
    status, out, _ = foldlab("materials --materials own.csv --json")
    rows = {row["name"]: row for row in json.loads(out)["materials"]}
    assert rows["slate"]["E_low"] == 1e10 and rows["slate"]["strain_low"] is None
    assert rows["polyester film"]["aliases"] == "PET;polyester;Mylar"
