"""``--files`` of ``check`` and ``design``: all of a unit's files, or none and one sentence."""

import errno
import json

import ezdxf
import numpy as np
import pytest
import trimesh
from gmsh_mark import needs_gmsh

import foldlab.inverse.propose as foldlab_propose
import foldlab.making.folder as foldlab_making
import foldlab.unit.record as foldlab_record
from foldlab.cli.outputs import new_folder
from foldlab.errors import InputError
from foldlab.labels.solver import SolverSource
from foldlab.making.folder import FILES

UNIT = (
    "check --passive PET --active SMP --set l_s=40mm --set b_s=10mm --set h_s=0.1mm "
    "--set h_i=0.2mm --set l_i=10mm --set b_i=6mm --set contraction=20% --accuracy 0.2 "
    "--no-pictures"
)
WISH = "design --space full --want angle --angle 1.5 -n 2 --passive PET --active SMP --files made"


def everything(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@needs_gmsh
def test_a_checked_unit_comes_with_its_files(foldlab, tmp_path):
    status, out, _ = foldlab(f"{UNIT} --files below/made --json")
    told = json.loads(out)
    assert status == 0
    assert told["made"] == {"folder": "below/made", "files": [*FILES], "missing": {}}
    made = tmp_path / "below" / "made"
    assert everything(tmp_path / "below") == ["made", *sorted(f"made/{name}" for name in FILES)]
    facts = json.loads((made / "unit.json").read_text())
    assert facts["physical"]["b_i"] == 0.006 and facts["answer"]["foldable"] is told["foldable"]
    assert facts["answer"]["fold_angle"] == pytest.approx(told["fold_angle"])
    # One unit in all of them.
    lines = ezdxf.readfile(made / "cut.dxf").modelspace().query("LWPOLYLINE")
    sizes = {line.dxf.layer: np.ptp(np.array(line.get_points("xy")), axis=0) for line in lines}
    assert sizes["outline"] == pytest.approx([40, 10]) and sizes["active"] == pytest.approx([10, 6])
    assert trimesh.load(made / "flat-passive.stl").extents == pytest.approx([40, 10, 0.1], rel=1e-6)
    creases = json.loads((made / "unit.fold").read_text())
    turned = np.radians(sum(a for a in creases["edges_foldAngle"]))
    assert turned == pytest.approx(told["fold_angle"], rel=0.01)
    page = (made / "report.html").read_text()
    assert "It folds" in page and f"{np.degrees(told['fold_angle']):.3g}°" in page
    # Again, into the same folder.
    before = everything(tmp_path)
    status, out, err = foldlab(f"{UNIT} --files below/made")
    assert (status, out) == (2, "") and "below/made is there already; give a new folder" in err
    assert everything(tmp_path) == before


@needs_gmsh
def test_strips_are_solved_and_cut(foldlab, tmp_path):
    line = f"{UNIT} --set strips=3 --set strip_share=60% --files made --json"
    status, out, err = foldlab(line)
    told = json.loads(out)
    assert status == 0 and "a rod does not know such units" in err
    assert (told["design"]["strips"], told["design"]["strip_share"]) == (3, 0.6)
    assert told["rod"] is told["holds"] is told["over_materials"] is None
    # Less of an active layer bends less.
    _, solid, _ = foldlab(f"{UNIT} --json")
    assert 0.5 < told["fold_angle"] / json.loads(solid)["fold_angle"] < 0.99
    lines = ezdxf.readfile(tmp_path / "made" / "cut.dxf").modelspace().query("LWPOLYLINE")
    cuts = [np.array(x.get_points("xy")) for x in lines if x.dxf.layer == "strips"]
    assert [np.ptp(cut, axis=0).round(9).tolist() for cut in cuts] == [[10, 1.2]] * 3
    facts = json.loads((tmp_path / "made" / "unit.json").read_text())
    assert (facts["strips"], facts["strip_share"]) == (3, 0.6)
    volume = 10 * 1.2 * 3 * 0.2e-9
    assert facts["mass"]["active"] == pytest.approx(volume * facts["physical"]["rho_i"])
    status, _, err = foldlab(f"{UNIT} --set strips=3")
    assert status == 2 and "add --set strip_share=" in err
    status, _, err = foldlab(f"{UNIT} --set strips=2.5 --set strip_share=60%")
    assert status == 2 and "whole number" in err and "Traceback" not in err


@pytest.mark.parametrize(
    "line, words",
    [
        (f"{UNIT} --quick --files made", "leave --quick out"),
        (f"{UNIT} --files taken", "taken is there already"),
        (f"{UNIT} --files taken/made", "taken is a file"),
        (WISH, "nothing in the wish limits l_s; add --set l_s=… or --max-length"),
        (
            WISH.replace("--passive PET --active SMP", "--set l_s=40mm"),
            "nothing in the wish limits E_s; add --set E_s=… or materials",
        ),
        (
            "design --weightless --set l_s=40mm --passive PET --active SMP --files made",
            "the wish leaves b_s, l_i open; add --set b_s=…",
        ),
    ],
)
def test_what_cannot_be_made_is_one_sentence_before_any_work(
    foldlab, tmp_path, monkeypatch, line, words
):
    (tmp_path / "taken").write_text("a file")

    def begun(*_, **__):
        raise AssertionError("work began")

    monkeypatch.setattr(SolverSource, "follow", begun)
    monkeypatch.setattr(foldlab_propose, "propose", begun)
    status, out, err = foldlab(line)
    assert (status, out) == (2, "") and words in err
    assert err.count("error: ") == 1 and "Traceback" not in err
    assert everything(tmp_path) == ["taken"]


def test_a_disk_that_fills_up_leaves_nothing(foldlab, tmp_path, monkeypatch):
    def full(folder, dossier):
        (folder / "cut.dxf").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(foldlab_making, "write", full)
    status, out, err = foldlab(f"{UNIT} --files below/made")
    assert (status, out) == (2, "") and "No space left on device" in err
    assert everything(tmp_path) == []


def test_each_proposal_is_solved_and_has_a_folder(foldlab, tmp_path, monkeypatch):
    monkeypatch.setattr(foldlab_record, "draw", lambda *_, **__: [])
    line = f"{WISH} --set l_s=40mm --set b_s=10mm --json"
    status, out, err = foldlab(line)
    told = json.loads(out)
    assert status == 0 and "1 of 2, by the solver under its weight: " in err
    units = told["made"]["units"]
    assert [unit["folder"] for unit in units] == ["1", "2"]
    for unit, proposal in zip(units, told["proposals"], strict=True):
        facts = json.loads((tmp_path / "made" / unit["folder"] / "unit.json").read_text())
        for name in ("l_s", "b_s", "b_i", "l_i", "h_s", "h_i", "E_s", "E_i", "contraction"):
            assert facts["physical"][name] == pytest.approx(proposal["physical"][name], rel=1e-9)
        assert facts["physical"]["l_s"] == 0.04 and facts["physical"]["b_s"] == 0.01
        assert facts["materials"] == {
            "passive": "polyester film", "active": "shape-memory polymer"
        }  # fmt: skip
        # Of what a material turns out to be its whole range is told.
        assert facts["ranges"]["E_i"] == [5e5, 3e7] and "contraction" not in facts["ranges"]
        assert facts["answer"]["fold_angle"] == unit["fold_angle"] is not None
        assert facts["answer"]["reason"] == unit["reason"]
        page = (tmp_path / "made" / unit["folder"] / "report.html").read_text()
        assert "to change" not in page
    assert everything(tmp_path / "made")[:1] == ["1"] and len(everything(tmp_path)) > 20


def test_a_new_folder_is_whole_or_not_there(tmp_path):
    with new_folder(tmp_path / "a" / "b") as draft:
        (draft / "file").write_text("x")
        assert not (tmp_path / "a" / "b").exists() and draft.parent == tmp_path / "a"
    assert everything(tmp_path) == ["a", "a/b", "a/b/file"]
    with pytest.raises(InputError, match="is there already"), new_folder(tmp_path / "a" / "b"):
        pass
    with pytest.raises(ZeroDivisionError), new_folder(tmp_path / "c" / "d") as draft:
        (draft / "file").write_text("half")
        raise ZeroDivisionError
    with pytest.raises(KeyboardInterrupt), new_folder(tmp_path / "a" / "e") as draft:
        raise KeyboardInterrupt
    assert everything(tmp_path) == ["a", "a/b", "a/b/file"]
