"""What the quickstart ends with: one page of all that it made, and every file that it links to."""

import json
import shlex
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from urllib.parse import urlparse

import mlflow
import numpy as np
import pandas as pd
import pytest
import typer
from PIL import Image

from foldlab.cli import app, page, quickstart, showcase
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.learning.saving import load_model

SETTINGS = quickstart.Settings(
    n_train=300, n_test=60, n_fresh=500, map_points=900, proposals=1, verify=2, models=("tree",)
)
VOID = ("img", "meta", "path", "source")


class Page(HTMLParser):
    """Words, links, ids and blocks of a page; its tags must close."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.links, self.ids, self.blocks = [], [], [], [], []
        self.tags = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [v for name, v in attrs if name in ("src", "href", "srcset")]
        self.ids += [v for name, v in attrs if name == "id"]
        if tag == "pre":
            self.blocks.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if "pre" in self.open:
            self.blocks[-1] += data

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A folder with what a small quickstart left, its result, and what its page was made of."""
    folder, given = tmp_path_factory.mktemp("quick"), []
    write = page.write
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        patch.setattr(page, "write", lambda out, c: given.append(c) or write(out, c))
        result = quickstart.run(SETTINGS, folder / "out", print)
    return folder, result, given[0]


@pytest.fixture(scope="module")
def whole(shown):
    return Page((shown[0] / "out" / "index.html").read_text(encoding="utf-8"))


def test_every_link_of_the_page_leads_to_a_file_beside_it(shown, whole):
    out = shown[0] / "out"
    assert shown[1]["page"] == out / "index.html"
    inside = {f"#{name}" for name in whole.ids}
    assert len(whole.links) > 30 and len(set(whole.ids)) == len(whole.ids)
    for link in set(whole.links):
        assert not urlparse(link).scheme and not link.startswith("/")
        assert link in inside or (out / link).stat().st_size > 100, link
    assert "script" not in whole.tags
    pictures = {"unit/fold.gif", "map_under_weight.png", "regimes_validated.png"}
    assert pictures | {"designs/1/drawing.svg", "designs/1/report.html"} <= set(whole.links)


def test_a_unit_folds_in_a_film_until_its_panels_press_on_each_other(shown, whole):
    folder = shown[0] / "out" / "unit"
    answer = json.loads((folder / "result.json").read_text())
    with Image.open(folder / "fold.gif") as film:
        assert film.n_frames >= 15
        frames = []
        for k in (0, film.n_frames // 2, film.n_frames - 1):
            film.seek(k)
            frames.append(np.asarray(film.convert("L"), float))
    assert np.abs(frames[0] - frames[1]).max() > 60 < np.abs(frames[1] - frames[2]).max()
    kinds = {event["kind"] for event in answer["events"]}
    assert {"lift-off", "contact"} <= kinds and answer["foldable"] and answer["stable"]
    # Both materials bear it.
    assert {row["says"] for row in answer["strain"].values()} == {"bears it"}
    with np.load(folder / "curves.npz") as file:
        middle = file["curves"][-1, 0]
    # The panels stand side by side (y along the sheet, of its length) and do not cross.
    assert -1e-3 < middle[-1, 1] - middle[0, 1] < 0.02 and middle[-1, 2] > 0.3
    told = f"It folds: {np.degrees(answer['fold_angle']):.3g}°"
    assert told in whole.text and "press on each other" in whole.text


def test_designs_are_told_in_millimetres_with_drawing_and_files(shown, whole):
    folder = shown[0] / "out" / "designs" / "1"
    facts = json.loads((folder / "unit.json").read_text())
    assert facts["physical"] | showcase.SHEET == pytest.approx(facts["physical"])
    assert facts["answer"]["fold_angle"] == pytest.approx(np.pi / 2, abs=showcase.TOLERANCE)
    assert whole.tags.count("svg") == SETTINGS.proposals == shown[1]["confirmed"]
    sizes = [
        f"{1e3 * facts['physical'][k]:.4g}" for k in ("l_s", "b_s", "h_s", "l_i", "b_i", "h_i")
    ]
    assert f"1 {' '.join(sizes)} {100 * facts['physical']['contraction']:.4g}" in whole.text
    assert "by the solver, and 4 of 4 of its box's worst corners" in whole.text
    assert facts["missing"] == {} and "not written" not in whole.text


def test_the_map_says_where_the_solver_agrees(shown, whole):
    assert shown[2].mapped.checked["verified"] == 2 == shown[1]["verified"]
    assert "The solver was asked of 2 of them" in whole.text
    checked = {
        "verified": 9, "verified_known": 8, "verified_agree": 5, "verified_core_seconds": 1.5,
    }  # fmt: skip
    mapped = replace(shown[2].mapped, checked=checked, sure=(3, 4))
    text = Page(page.html(replace(shown[2], mapped=mapped))).text
    assert "asked of 9 of them" in text and "3 of 4 where the model is sure" in text
    assert "2 of 4 between the white lines; 1.5 core-seconds" in text
    assert (
        "asked of"
        not in Page(page.html(replace(shown[2], mapped=replace(mapped, checked={})))).text
    )


def test_where_the_model_is_sure_is_by_its_probability(monkeypatch):
    fitted, _ = load_model("gravity")
    table = FULL.sample(200, seed=0)
    p = fitted.predict_proba(table)[:, 1]
    table["predicted"] = p > 0.5
    table["foldable"] = pd.array(p > 0.3, dtype="boolean")
    table.loc[np.arange(0, 200, 7), "foldable"] = ~table["foldable"]
    table.loc[np.arange(3, 200, 7), "foldable"] = pd.NA
    sure = [k for k in range(200) if not 0.1 <= p[k] <= 0.9 and (k - 3) % 7]
    monkeypatch.setattr(showcase, "verification", lambda *_, quiet: (table, {"verified": 200}))
    mapped = showcase.heavy_map(900, 200, seed=0, workers=1)
    assert mapped.sure == (len([k for k in sure if k % 7]), len(sure)) and len(sure) < 170


@pytest.mark.filterwarnings("ignore")  # MLflow's own calls
def test_the_python_on_the_page_loads_a_model_and_gets_probabilities(
    shown, whole, monkeypatch, capsys
):
    monkeypatch.chdir(shown[0])
    (code,) = [block for block in whole.blocks if block.startswith("import mlflow")]
    mlflow.set_tracking_uri(None)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    names = {}
    try:
        exec(compile(code, "page", "exec"), names)
    finally:
        mlflow.set_tracking_uri(None)
    assert "probability" in capsys.readouterr().out
    tree, _ = load_model(shown[0] / "out" / "model")
    told = names["model"].predict(names["designs"])["probability"]
    np.testing.assert_array_equal(told, tree.predict_proba(names["designs"])[:, 1])


def test_the_commands_on_the_page_are_those_that_there_are(whole):
    known = typer.main.get_command(app.app)
    lines = [shlex.split(block) for block in whole.blocks if block.startswith("foldlab ")]
    assert len(lines) == 6
    for _, verb, *given in lines:
        if verb != "--help":
            with known.get_command(None, verb).make_context(verb, list(given)) as context:
                assert context.params
    assert any(block.startswith("mlflow ui --backend-store-uri sqlite") for block in whole.blocks)


def test_what_each_part_took_adds_up(shown, whole):
    seconds = shown[2].seconds
    assert all(name in whole.text for name in seconds)
    assert f"all {sum(seconds.values()):.1f}" in whole.text


def test_what_could_not_be_made_is_told_and_not_linked(shown):
    contents = shown[2]
    (made,) = contents.designed.made
    kept = [name for name in made["files"] if name != "cut.dxf"]
    poor = {**made, "files": kept, "missing": {"cut.dxf": "No module named 'ezdxf'"}}
    files = [name for name in contents.folding.files if name != "fold.gif"]
    text = page.html(
        replace(
            contents,
            designed=replace(contents.designed, made=[poor]),
            folding=replace(contents.folding, files=files),
        )
    )
    told = Page(text)
    assert "cut.dxf: No module named 'ezdxf'" in told.text
    assert "VTK can’t render in three dimensions here" in told.text
    assert not {"designs/1/cut.dxf", "unit/fold.gif"} & set(told.links)
    bare = Page(page.html(replace(contents, designed=None, folding=None)))
    assert "--set proposals=5" in bare.text and "--set unit=true" in bare.text
    assert "svg" not in bare.tags and not any(link.startswith("unit/") for link in bare.links)


def test_names_are_text_and_no_tags(shown):
    unit = shown[2].folding.unit
    evil = replace(unit, materials={"passive": "<b>foil</b> & <script>", "active": "SMP"})
    folding = replace(shown[2].folding, unit=evil)
    rows = [{**row, "model": "<i>tree</i>"} for row in shown[2].rows]
    addresses = {"<i>tree</i>": "models:/<b>"}
    changed = {"folding": folding, "rows": rows, "best": "<i>tree</i>", "addresses": addresses}
    text = page.html(replace(shown[2], **changed))
    assert "&lt;b&gt;foil&lt;/b&gt; &amp; &lt;script&gt;" in text and "<script" not in text
    assert "<i>tree" not in text and "models:/<b>" not in text


def test_a_folder_of_somebodys_own_is_no_place_for_designs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / "designs").mkdir(parents=True)
    mine = tmp_path / "out" / "designs" / "mine.txt"
    mine.write_text("mine")
    with pytest.raises(InputError, match=r"designs holds other things than designs; move it"):
        quickstart.run(SETTINGS, tmp_path / "out", print)
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "out", mine.parent, mine]
    mine.unlink()
    (mine.parent / "1").mkdir()
    (mine.parent / "1" / "unit.json").write_text("{}")
    showcase.check_designs(mine.parent)
