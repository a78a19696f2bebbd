"""The pages of docs/ build without a warning, and every block of commands or Python in them runs.

A page's blocks run in their order, in one folder and one session of Python; a block with a title is
a file there.
"""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import written
import yaml

import foldlab
from foldlab import FULL, LabelStore, load_dataset
from foldlab.datasets import card
from foldlab.unit.told import readable

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")}


def test_the_pages_build_without_a_warning(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path / "site")],
        cwd=ROOT, capture_output=True, text=True, timeout=200,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    reference = (tmp_path / "site" / "reference" / "index.html").read_text(encoding="utf-8")
    assert 'id="foldlab.labels.label.Label"' in reference
    assert ":class:" not in reference and "InputError</code> for" in reference
    assert not (tmp_path / "site" / "hooks").exists()
    assert "groups to numbers" in (tmp_path / "site" / "source" / "index.html").read_text()


def test_every_page_stands_in_the_navigation():
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    named = [next(iter(entry.values())) for entry in settings["nav"]]
    assert sorted(named) == sorted(f"{name}.md" for name in PAGES)


@pytest.mark.parametrize("page", sorted(PAGES))
def test_the_blocks_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    names = {"__name__": "__main__"}
    for language, title, text in written.blocks(PAGES[page]):
        if title:
            (tmp_path / title).write_text(text, encoding="utf-8")
            if title.endswith(".sh"):
                subprocess.run(["bash", "-n", title], check=True)
            elif title.endswith(".py"):
                compile(text, title, "exec")
        elif language == "python":
            exec(compile(text, f"{page}.md", "exec"), names)
        elif language == "sh":
            for line in text.replace("\\\n", " ").splitlines():
                written.run_command(line, monkeypatch, capsys)
        else:
            pytest.fail(f"{page}.md has a block of {language or 'no language'}, which nothing runs")
    sys.modules.pop("mine", None)


@pytest.mark.parametrize(
    ("script", "source", "made"),
    [("job.sh", "ladder", "labels.db"), ("array.sh", "rod", "piece-7.parquet")],
)
def test_jobs_of_a_cluster_run(script, source, made, tmp_path):
    """With an srun that starts what it is given, on one core."""
    (text,) = (text for _, title, text in written.blocks(PAGES["cluster"]) if title == script)
    assert "--source solver" in text
    for old, new in (("solver", source), ("-n 1000", "-n 3"), ("designs.parquet", "designs.csv")):
        text = text.replace(old, new)
    (tmp_path / script).write_text(text)
    FULL.sample(3, seed=0).to_csv(tmp_path / "designs.csv", index=False)
    (tmp_path / "srun").write_text('#!/bin/bash\nexec "$@"\n')
    (tmp_path / "srun").chmod(0o755)
    slurm = {"SLURM_JOB_ID": str(os.getpid()), "SLURM_CPUS_PER_TASK": "1"}
    path = [str(tmp_path), str(Path(sys.executable).parent), os.environ["PATH"]]
    done = subprocess.run(
        ["bash", script], cwd=tmp_path, capture_output=True, text=True, timeout=200,
        env=os.environ | slurm | {"SLURM_ARRAY_TASK_ID": "7", "PATH": ":".join(path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    if script == "job.sh":
        with LabelStore(tmp_path / made, mode="read") as store:
            assert len(store.frame()) == 3
    else:
        assert len(pd.read_parquet(tmp_path / made)) == 3


def test_every_correction_of_the_theory_names_tests_that_there_are():
    points = re.split(r"^- \*\*", PAGES["theory"], flags=re.MULTILINE)[1:]
    assert len(points) >= 20
    for point in points:
        named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", point)
        assert "Held by" in point and named, point
        for path, name in named:
            code = (ROOT / path).read_text(encoding="utf-8")
            assert f"\ndef {name}(" in code, f"{path} has no {name}"


def test_figures_of_the_dataset_are_counted_from_it():
    table = load_dataset("gravity")
    growth = table["growth"].value_counts()
    page = " ".join(PAGES["dataset"].split())
    spent, unknown = table["core_seconds"].sum(), int(table["foldable"].isna().sum())
    for told in (
        f"{len(table):_} labels of self-folding units", f"{growth['uniaxial']:_} whose layer",
        f"{growth['isotropic']} whose layer", f"{spent:_.0f} core-seconds", f"{unknown} labels are",
    ):  # fmt: skip
        assert told.replace("_", " ") in page
    rows = [line.split("|")[1] for line in PAGES["dataset"].splitlines() if line[:3] == "| `"]
    assert set(re.findall(r"`(.+?)`", "".join(rows))) <= set(table.columns)
    cited = re.search(r"Cite: (.*)\.", card("gravity")).group(1)
    assert cited in page and cited in " ".join(PAGES["cite"].split())
    assert f"holds {len(table):_} labels".replace("_", " ") in README


def test_figures_of_accuracy_and_cost_are_those_of_the_readme_and_have_a_command():
    for heading, *lines in (s.splitlines() for s in PAGES["accuracy"].split("\n## ")[1:]):
        for line in lines:
            if line.startswith("| "):
                assert line.replace("(#models)", "(#learning-under-gravity)") in README
        names = re.findall(r"python -m experiments\.(\w+)", "\n".join(lines))
        assert names, heading
        assert all((ROOT / "experiments" / f"{name}.py").exists() for name in names)


def test_every_picture_is_in_the_gallery_with_what_makes_it():
    found = re.findall(r"!\[[^]]+\]\((\w+\.png)\)\n\n(.*?)(?=\n\n)", PAGES["gallery"], re.DOTALL)
    assert sorted(name for name, _ in found) == sorted(
        p.name for p in (ROOT / "docs").glob("*.png")
    )
    for name, caption in found:
        assert (ROOT / "docs" / name).stat().st_size < 200_000
        if "the page of `foldlab explore`" in caption:
            continue
        assert re.search(r"`out/[\w/]+\.png` of\s", caption), name
        if run := re.search(r"`python -m experiments\.(\w+)", caption):
            assert (ROOT / "experiments" / f"{run.group(1)}.py").exists(), name
        else:
            assert "`foldlab simulate" in caption, name


def test_every_line_of_an_answer_is_explained_in_its_order():
    body = inspect.getsource(readable).partition("return {")[2]
    lines = re.findall(r'^        "([a-z_ ]+)": |\{"(to make it)"', body, re.MULTILINE)
    told = re.findall(r"^\| (`.+?`) \|", PAGES["unit"], re.MULTILINE)
    assert re.findall(r"`([^`]+)`", " ".join(told)) == ["".join(pair) for pair in lines]
    assert len(lines) == 12


def test_it_is_cited_by_the_version_that_there_is():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == foldlab.__version__ and cited["license"] == "MIT"
    (entry,) = (text for _, title, text in written.blocks(PAGES["cite"]) if title)
    for told in (cited["title"], cited["version"], cited["license"], cited["authors"][0]["name"]):
        assert f"{{{told}}}" in entry


def test_the_cells_of_the_input_deck_are_the_right_way_out_and_fill_the_unit():
    page = written.blocks(PAGES["source"])
    names = {"__name__": "mine"}
    exec(next(text for _, title, text in page if title == "mine.py").split("@dataclass")[0], names)
    design = FULL.sample(1, seed=3).iloc[0].to_dict()
    nodes, volumes, what = {}, dict.fromkeys(("PASSIVE", "ACTIVE"), 0.0), ""
    for line in names["deck"](design).splitlines():
        if line.startswith("*"):
            what = line
            continue
        first, *rest = line.split(",")
        if what == "*NODE":
            nodes[first] = np.array([float(x) for x in rest])
        elif what.startswith("*ELEMENT"):
            p = [nodes[name.strip()] for name in rest]
            # Corners of a C3D8: around the bottom, then around the top above them.
            volume = np.linalg.det([p[1] - p[0], p[3] - p[0], p[4] - p[0]])
            assert volume > 0
            np.testing.assert_allclose([p[2] - p[3], p[6] - p[7]], [p[1] - p[0]] * 2, atol=1e-8)
            volumes[what.split("=")[-1]] += volume
    b, length, wide = design["aspect"], design["hinge_length"], design["hinge_width"]
    sheet = b * (1 - length * (1 - wide)) * design["slenderness"]  # as narrow as the hinge at it
    layer = length * wide * b * design["h_ratio"] * design["slenderness"]
    assert volumes == pytest.approx({"PASSIVE": sheet, "ACTIVE": layer}, rel=1e-6)
