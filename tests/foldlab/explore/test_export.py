"""The ZIP of a design holds what is known of it, each file whole, and no path of this machine."""

import io
import json
import zipfile

import pytest

from foldlab.explore import export
from foldlab.explore.asked import asked
from foldlab.explore.live import FIRST
from foldlab.explore.work import Desk
from foldlab.unit import record


@pytest.fixture(scope="module")
def made():
    """Of a unit in sizes and of the same in groups: the files of their ZIPs."""
    with pytest.MonkeyPatch.context() as patch:
        drawn = lambda out, *args, **options: (out / "shapes.png").write_bytes(b"a picture")  # noqa: E731
        patch.setattr(record, "draw", drawn)
        desk = Desk(lambda text: None)
        options = {"accuracy": 0.2, "seconds": 120, "contact": False}
        out = []
        for design in (FIRST, {"groups": dict(asked(FIRST).groups)}):
            answer = desk.do("export", {"design": design, **options})
            assert answer["name"] == "foldlab-unit.zip"
            with zipfile.ZipFile(io.BytesIO(answer["content"])) as archive:
                assert archive.testzip() is None
                out.append({name: archive.read(name) for name in archive.namelist()})
        return desk, *out


def test_numbers_figures_and_files_to_make_it_are_there(made):
    _, sizes, _ = made
    assert {
        "READ_ME.txt", "result.json", "design.json", "curves.npz", "series/unit.pvd", "shapes.png",
        "make/drawing.pdf", "make/flat-passive.stl", "make/folded-active.stl", "make/report.html",
        "make/unit.fold", "make/unit.json",
    } <= set(sizes)  # fmt: skip
    assert sizes["make/folded.png"] == b"a picture"
    assert not any(name.startswith(("/", "..")) or "\\" in name for name in sizes)


def test_the_design_and_the_label_are_those_that_were_asked(made):
    desk, sizes, _ = made
    design, result = (json.loads(sizes[f"{name}.json"]) for name in ("design", "result"))
    unit = asked(FIRST)
    assert design["groups"] == pytest.approx(unit.groups)
    assert design["physical"] == pytest.approx(unit.unit.physical)
    assert design["materials"]["active"] == "shape-memory polymer"
    assert result["foldable"] is True and result["label"]["design"] == pytest.approx(unit.groups)
    assert result["fold_angle"] == desk.last[3].evidence["fold_angle"]
    facts = json.loads(sizes["make/unit.json"])
    assert facts["answer"]["confirmed"] is True and facts["physical"] == design["physical"]


def test_a_design_without_a_size_has_no_files_to_make_it(made):
    _, _, groups = made
    assert json.loads(groups["design.json"])["physical"] is None
    assert "shapes.png" in groups and not any(name.startswith("make") for name in groups)


def test_the_same_design_is_not_solved_again(made, monkeypatch):
    from foldlab.labels.solver import SolverSource

    desk = made[0]
    monkeypatch.setattr(SolverSource, "follow", lambda *args: pytest.fail("solved again"))
    monkeypatch.setattr(export, "zipped", lambda *args: b"zip")
    same = {"design": FIRST, "accuracy": 0.2, "seconds": 120, "contact": False}
    assert desk.do("export", same)["content"] == b"zip"
    with pytest.raises(pytest.fail.Exception, match="solved again"):
        desk.do("export", same | {"contact": True})
