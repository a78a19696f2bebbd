"""The folder that a unit is made by: what is in it, what the page and the JSON say."""

import json
import re
import sys
from base64 import b64encode
from dataclasses import replace
from html.parser import HTMLParser

import pandas as pd
import pytest
from gmsh_mark import needs_gmsh

from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.making import dxf, folder
from foldlab.making.folder import FILES, Dossier, write
from foldlab.materials import read_materials
from foldlab.unit.sized import sized

PRICES = (
    "name,role,E_low,E_high,rho_low,rho_high,contraction_low,contraction_high,stimulus,"
    "price_low,price_high\n"
    "foil,passive,1e8,1e8,1000,1000,,,,10,20\n"
    "gel,active,1e7,1e7,2000,2000,0.2,0.2,warm water,100,100\n"
)
SIZES = {
    "l_s": 0.1, "b_s": 0.025, "h_s": 1e-3, "h_i": 1e-3, "l_i": 0.02, "b_i": 0.02,
    "contraction": 0.2,
}  # fmt: skip


@pytest.fixture(scope="module")
def dossier(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "own.csv"
    path.write_text(PRICES)
    unit = sized(SIZES, read_materials(path), "foil", "gel")
    source = SolverSource(Conditions(), Effort(0.05))
    run, label = source.follow(unit.groups)
    e = label.evidence
    answer = {
        "foldable": label.foldable, "fold_angle": e["m1"], "need": e["need"], "core_seconds": 1.5,
        "physical": dict(unit.physical), "made": None,
    }  # fmt: skip
    told = {
        "angle": "64° ± 1°, 36° count as folded", "why": "folds by 1 rad <&> h_s is thin",
        "strain": "passive 1 % (bears it)", "core_seconds": 1.5,
    }  # fmt: skip
    return Dossier(unit, answer, told, source, run)


class Page(HTMLParser):
    """Words, sources and links of a page; its tags must close."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.sources = [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("img", "meta", "path"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@needs_gmsh
def test_the_folder_holds_every_file_that_is_told_of(dossier, tmp_path):
    assert write(tmp_path, dossier) == {}
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)
    assert all(path.stat().st_size > 500 for path in tmp_path.iterdir())
    facts = json.loads((tmp_path / "unit.json").read_text())
    assert facts["files"] == list(FILES) and facts["missing"] == {}
    assert facts["physical"] == pytest.approx({**dossier.unit.physical})
    assert facts["units"]["l_s"] == "m" and facts["units"]["mass"] == "kg"
    # 25 mm · 80 mm + 20 mm · 20 mm of 1 mm at 1 g/cm³, and 20 mm · 20 mm of 1 mm at 2 g/cm³.
    assert facts["mass"] == pytest.approx({"passive": 2.4e-3, "active": 8e-4, "total": 3.2e-3})
    assert facts["cost"] == pytest.approx([2.4e-3 * 10 + 0.08, 2.4e-3 * 20 + 0.08])
    assert facts["answer"] == {
        k: dossier.answer[k] for k in ("foldable", "fold_angle", "need", "core_seconds")
    }
    creases = json.loads((tmp_path / "unit.fold").read_text())
    turned = sum(creases["edges_foldAngle"]) * 3.141592653589793 / 180
    assert turned == pytest.approx(dossier.answer["fold_angle"], rel=1e-3)


@needs_gmsh
def test_the_report_is_a_page_that_needs_no_network(dossier, tmp_path):
    write(tmp_path, dossier)
    text = (tmp_path / "report.html").read_text()
    page = Page(text)
    words = " ".join(" ".join(page.words).split())
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert len(page.sources) == 2 and not re.search(r"(src|href|url)\W+https?:", text)
    assert "It folds: 64° ± 1°" in words and "folds by 57.3° <&> h s is thin" in words
    assert "Self-folding unit, 100 mm × 25 mm, foil and gel" in words
    assert "3.2 g (sheet 2.4 g, active layer 0.8 g)" in words
    assert "0.104 to 0.128, by your prices per kg" in words and "warm water" in words
    assert "with weight on a ground" in words and "1.5 core-seconds" in words
    assert "hinge 20 mm wide" in words and "passive 1 % (bears it)" in words
    # The drawing's views, without its frame.
    assert "side view: length 1:1, thickness 10:1" in words and "all sizes in mm" not in words
    picture = tmp_path / "unit.png"
    picture.write_bytes(b"\x89PNG mine")
    write(tmp_path, replace(dossier, picture=picture))
    assert b64encode(picture.read_bytes()).decode() in (tmp_path / "report.html").read_text()
    assert (tmp_path / "folded.png").read_bytes() == picture.read_bytes()


def test_what_cannot_be_written_is_told_and_the_rest_is_there(dossier, tmp_path, monkeypatch):
    def absent(unit):
        raise ImportError("No module named 'ezdxf'")

    def refused(path, *_):
        path.write_text("half")
        raise ValueError("Gmsh made no solids")

    monkeypatch.setattr(dxf, "dxf", absent)
    monkeypatch.setattr("foldlab.making.step.write_flat", refused)
    monkeypatch.setattr("foldlab.making.step.write_folded", refused)
    missing = write(tmp_path, replace(dossier, missing={}))
    assert missing["cut.dxf"] == "No module named 'ezdxf'; pip install 'foldlab[make]'"
    assert missing["flat.step"] == missing["folded.step"] == "Gmsh made no solids"
    assert {path.name for path in tmp_path.iterdir()} == set(FILES) - set(missing)
    facts = json.loads((tmp_path / "unit.json").read_text())
    assert facts["missing"] == missing and facts["files"] == [k for k in FILES if k not in missing]
    words = Page((tmp_path / "report.html").read_text()).words
    assert any("not written: No module named 'ezdxf'" in w for w in words)


def test_gmsh_without_its_x_libraries_is_told_and_the_rest_is_there(dossier, tmp_path, monkeypatch):
    """Importing it raises OSError there, which ended the verb after all its work."""

    class Bare:
        @staticmethod
        def find_spec(name, path=None, target=None):
            if name == "gmsh":
                raise OSError("libGLU.so.1: cannot open shared object file")

    monkeypatch.delitem(sys.modules, "gmsh", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Bare, *sys.meta_path])
    missing = write(tmp_path, replace(dossier, missing={}))
    assert set(missing) == {"flat.step", "folded.step"}
    assert all("libGLU.so.1" in why and "libglu1-mesa" in why for why in missing.values())
    assert {path.name for path in tmp_path.iterdir()} == set(FILES) - set(missing)


def test_a_path_that_ended_early_is_no_folded_shape_without_a_word(dossier, tmp_path):
    history = [dict(row) for row in dossier.run.history]
    history[-1]["contraction"] = 0.123
    early = replace(dossier, run=replace(dossier.run, history=history))
    assert dossier.reached is None and early.reached == 0.123
    write(tmp_path, early)
    assert json.loads((tmp_path / "unit.json").read_text())["contraction_reached"] == 0.123
    words = " ".join(Page((tmp_path / "report.html").read_text()).words)
    assert "pass through each other" not in words and not dossier.crossed
    assert "that at 12.3 % contraction, where the path ended, not at 20 %" in words


def test_panels_that_pass_through_each_other_are_told(dossier, tmp_path):
    shape = dossier.run.shapes[-1]
    curves = shape.state.curves * (1, -1, 1)
    last = replace(shape, state=replace(shape.state, curves=curves))
    through = replace(dossier, run=replace(dossier.run, shapes=[last]))
    write(tmp_path, through)
    assert json.loads((tmp_path / "unit.json").read_text())["panels_cross"] is True
    words = " ".join(Page((tmp_path / "report.html").read_text()).words)
    assert "its panels pass through each other, for contact was left out" in words
    touching = SolverSource(Conditions(effects="gravity,ground,contact"))
    assert not replace(through, source=touching).crossed


def test_without_a_run_there_is_no_folded_shape_and_no_price_is_made_up(tmp_path):
    unit = sized(SIZES, read_materials(), "PET", "SMP")
    answer = {"foldable": None}
    bare = Dossier(unit, answer, {}, SolverSource())
    missing = write(tmp_path, bare)
    assert {n for n in missing if n.startswith("folded")} == {
        "folded.png", "folded.step", "folded-passive.stl", "folded-active.stl"
    }  # fmt: skip
    words = " ".join(Page((tmp_path / "report.html").read_text()).words)
    assert "Unknown" in words and "needs price_low and price_high per kg of both" in words
    assert json.loads((tmp_path / "unit.json").read_text())["cost"] is None
    assert "file_frames" not in json.loads((tmp_path / "unit.fold").read_text())


def test_prices_are_read_from_a_users_table_and_none_are_shipped(tmp_path):
    assert read_materials()[["price_low", "price_high"]].isna().all(axis=None)
    path = tmp_path / "own.csv"
    path.write_text(PRICES)
    table = read_materials(path)
    assert table.loc["foil", ["price_low", "price_high"]].tolist() == [10, 20]
    assert pd.isna(table.loc["polyester film", "price_low"])
    unit = sized(SIZES, table, "foil", "gel")
    assert unit.price == {"passive": (10.0, 20.0), "active": (100.0, 100.0)}
    assert unit.stimulus == "warm water" and unit.changed(l_s=0.2).price == unit.price


def test_making_loads_neither_gmsh_nor_ezdxf_before_they_are_used():
    import subprocess

    code = (
        "import sys, foldlab.cli.app, foldlab.making.folder, foldlab.making.step, "
        "foldlab.making.dxf; print([m for m in ('gmsh', 'ezdxf', 'pyvista') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert folder.FILES
