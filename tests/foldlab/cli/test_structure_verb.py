"""The verb ``structure``: an answer in words and JSON, its files, and what it refuses."""

import json
import sys

import numpy as np
import pytest
from PIL import Image
from pytest import approx

CROSS = """<svg xmlns="http://www.w3.org/2000/svg" width="90mm" height="120mm" viewBox="0 0 90 120">
<path d="M30 0H60V30H90V60H60V120H30V60H0V30H30Z" fill="none" stroke="black"/>
<path d="M30 30H60M30 60H60M30 90H60M30 30V60M60 30V60" fill="none" stroke="blue"/></svg>"""
MADE = (
    "structure net.svg --passive PET --active SMP --set h_s=0.1mm --set h_i=0.2mm --set l_i=5mm "
    "--set E_i=20MPa --set contraction=12% -o out"
)


@pytest.fixture
def net(foldlab, tmp_path):
    """The entry point in a folder with a net of a cube."""
    (tmp_path / "net.svg").write_text(CROSS)
    return foldlab


def test_a_net_folds(net, tmp_path):
    status, out, _ = net(f"{MADE} --gif --json")
    assert status == 0
    told = json.loads(out)
    assert told["foldable"] is True and told["outcome"] == "reached" and told["stable"] is True
    assert len(told["hinges"]) == 5 and all(h["folds"] for h in told["hinges"])
    assert told["effects"] == ["gravity", "ground", "contact"]
    assert told["mass"] == approx(0.00088, rel=0.02)
    assert told["bears"] == {"passive": True, "active": True}
    law = told["laws"][0]
    assert law["angle"] == approx(law["section"], rel=0.2)
    assert told["hinges"][0]["natural"] == approx(law["angle"], rel=1e-3)
    folder = tmp_path / "out"
    assert json.loads((folder / "result.json").read_text())["reason"] == told["reason"]
    assert json.loads((folder / "folded.fold").read_text())["file_frames"]
    assert (folder / "series" / "structure.pvd").read_text().count("<DataSet") == told["states"]
    with Image.open(folder / "fold.gif") as gif:
        assert 3 < gif.n_frames <= told["states"]
    assert {"states.png", "angles.png"} <= {p.name for p in folder.iterdir()}


def test_words_name_what_holds_a_hinge(net, tmp_path):
    status, out, err = net(f"{MADE} --set size=2m --set l_i=60mm --quick --no-pictures")
    assert status == 0
    assert "too heavy" in out and "hinges don't fold" in out
    assert "panels would sag by" in out and "mass: " in out
    assert "stands: yes" in out
    assert "hinges by the solver" not in err
    assert not (tmp_path / "out" / "states.png").exists()


def test_the_time_told_has_the_labels_of_the_hinges_in_it():
    from foldlab.cli.structure import readable

    told = {"reason": "", "mass": 0.0, "core_seconds": 1.5, "files": []}
    words = readable(told | {"laws": [{"core_seconds": 0.25}, {"core_seconds": 0.5}]})
    assert words["took"] == "2.2 core-seconds, 0.75 for the hinges"
    assert readable(told | {"laws": []})["took"] == "1.5 core-seconds, 0 for the hinges"


def test_a_path_that_does_not_end_keeps_what_there_is(net, tmp_path):
    status, out, err = net(f"{MADE} --quick --timeout 0 --no-pictures --json")
    assert status == 3
    assert json.loads(out)["foldable"] is None
    assert "not reached: unknown: the time allowed was used up" in err
    assert (tmp_path / "out" / "result.json").exists()


@pytest.mark.parametrize(
    "more, says",
    [
        ("--effects wind", "--effects 'wind'; expected some of gravity, ground, contact"),
        ("--effects gravity", "weight and ground come together"),
        ("--set l_s=1m", "l_s is the pattern's own"),
        ("--set size=0mm", "size = 0; expected a length above 0"),
        ("--set size=2kg", "size = '2kg'"),
        ("--set l_i=200mm", "leave no panel of it"),
        ("--set contraction=99%", "contraction = 0.99"),
        ("--set h_s=-1mm", "h_s = -0.001; expected a finite number above 0"),
        ("--passive unobtainium", "no passive material 'unobtainium'"),
    ],
)
def test_what_is_refused(net, tmp_path, more, says):
    status, _, err = net(f"{MADE} --quick {more}")
    assert status == 2
    assert says in err
    assert not (tmp_path / "out").exists()


def test_what_is_missing_is_told(net, foldlab, monkeypatch):
    status, _, err = net("structure net.svg --passive PET --set l_i=5mm")
    assert status == 2 and "the unit lacks h_s" in err
    status, _, err = net(MADE.replace("net.svg", "absent.fold"))
    assert status == 2 and "can't read the pattern" in err
    monkeypatch.setitem(sys.modules, "ipctk", None)
    status, _, err = net(MADE)
    says = 'a structure needs ipctk, which is not installed: pip install "foldlab[structure]"'
    assert status == 2 and says in err


def test_hinges_of_one_kind_and_answer_are_a_row_with_their_angles_in_degrees():
    from foldlab.cli.structure import rows

    def hinge(angle, **changed):
        return {
            "fold": "valley",
            "natural": 1.5,
            "folds": True,
            "why": "",
            "angle": angle,
        } | changed

    hinges = [
        hinge(1.0), hinge(0.25, fold="mountain"), hinge(1.2, natural=1.5 + 1e-9),
        hinge(0.1, folds=False, why="too heavy"), hinge(0.2502, fold="mountain"),
        hinge(0.3, natural=0.5, folds=None),
    ]  # fmt: skip
    valley = {"hinges": 2, "fold": "valley", "angle": "57.3° to 68.8°", "alone": "85.9°"}
    valley |= {"folds": "yes", "why not": ""}
    mountain = {"hinges": 2, "fold": "mountain", "angle": "14.3°"}
    assert rows({"hinges": hinges}) == [
        valley,
        valley | mountain,
        valley | {"hinges": 1, "angle": "5.7°", "folds": "no", "why not": "too heavy"},
        valley | {"hinges": 1, "angle": "17.2°", "alone": "28.6°", "folds": "–"},
    ]


def test_words_have_strains_in_per_cent_and_grams():
    from foldlab.cli.structure import readable

    told = {
        "reason": "all 2 hinges fold", "strain": {"passive": 0.0123, "active": 0.256},
        "bears": {"passive": True, "active": None}, "stable": False, "clearance": 1e-4,
        "mass": 0.00456, "laws": [], "core_seconds": 2.0, "files": ["a", "b"],
    }  # fmt: skip
    words = readable(told)
    assert words == {
        "answer": "all 2 hinges fold", "strain of the sheet": "1.2 %, borne",
        "strain of the active layer": "26 %, at which it may break", "stands": "no",
        "panels": "touch", "mass": "4.56 g", "took": "2 core-seconds, 0 for the hinges",
        "files": "a, b",
    }  # fmt: skip
    for apart in (None, np.inf):
        assert "panels" not in readable(told | {"clearance": apart})
    bare = readable(told | {"bears": {"active": False}, "stable": None})
    assert bare["strain of the sheet"] == "1.2 %" and bare["stands"] == "not known"
    assert bare["strain of the active layer"] == "26 %, more than it bears"
    assert list(readable(told | {"strain": None})) == ["answer", "mass", "took", "files"]


STRIP = """<svg xmlns="http://www.w3.org/2000/svg" width="40mm" height="10mm" viewBox="0 0 40 10">
<rect width="40" height="10" fill="none" stroke="black"/>
<path d="M20 0V10" fill="none" stroke="blue"/></svg>"""


def test_the_solid_has_the_last_word(net, tmp_path):
    pytest.importorskip("gmsh")
    (tmp_path / "net.svg").write_text(STRIP)
    line = f"{MADE} --quick --solid --effects none"
    status, out, _ = net(f"{line} --json")
    assert status == 0
    told = json.loads(out)
    (hinge,) = told["hinges"]
    assert told["foldable"] is told["solid"]["foldable"] is True
    assert told["reason"].startswith("as a solid: all 1 hinges fold; least room")
    assert "(rigid panels: all 1 hinges fold" in told["reason"]
    assert hinge["solid"] == told["solid"]["angles"][0]
    assert hinge["solid"] == approx(hinge["angle"], rel=0.15) and hinge["solid_error"] > 0
    assert (tmp_path / "out" / "solid.vtu").exists()
    assert str(told["files"]).count("solid.vtu") == str(told["files"]).count("solid.png") == 1
    with Image.open(tmp_path / "out" / "solid.png") as image:
        colours = image.convert("RGB").reduce(4).getcolors(10**6)
    orange = sum(n for n, (r, _, b) in colours if r > b + 60)
    blue = sum(n for n, (r, _, b) in colours if b > r + 20)
    assert 100 < orange < blue  # the layer, and the panels around it
    status, out, _ = net(f"{line} --no-pictures")
    assert "as a solid" in out and "±" in out and " as a solid\n" in out


def test_a_solid_that_ends_early_leaves_it_open(net, tmp_path):
    pytest.importorskip("gmsh")
    (tmp_path / "net.svg").write_text(STRIP)
    status, out, err = net(f"{MADE} --quick --solid --no-pictures --timeout 0.01 --json")
    assert status == 3
    told = json.loads(out)
    assert told["foldable"] is None and told["hinges"][0]["solid"] is None
    assert "not reached: as a solid: unknown" in err


def test_a_solid_needs_gmsh(net, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    status, _, err = net(f"{MADE} --quick --solid")
    assert status == 2 and "pip install 'foldlab[gmsh]'" in err
