"""``foldlab augment`` with labels of the solver: scored on labels that exist, and resumed."""

import json

import pytest

from foldlab.datasets import load_dataset
from foldlab.labels.label import Label
from foldlab.labels.solver import SolverSource

PLAN = "--set initial=12 --set per_cycle=4 --set cycles=2 --set epochs=5 --set candidates=50"


@pytest.fixture
def test_table(tmp_path):
    table = load_dataset("gravity-5k", growth="uniaxial").head(60)
    table.attrs = {}
    table.to_parquet(tmp_path / "t.parquet")
    return "t.parquet"


@pytest.fixture
def asked(monkeypatch):
    """Designs that the solver was asked about, in this process."""
    seen = []

    def label(self, design):
        seen.append(dict(design))
        folds = design["stiffness_to_weight"] > 1
        return Label(
            design, folds, "so", {"history": [], "core_seconds": 0.1}, self.name, self.version
        )

    monkeypatch.setattr(SolverSource, "label", label)
    return seen


def test_labels_are_kept_and_a_second_run_makes_none(
    foldlab, test_table, asked, tmp_path, monkeypatch
):
    from foldlab.campaign import campaign

    def here(designs, source, store, *, workers, progress):
        known = store.known(source.name, source.version)
        rows = [
            source.label(d)
            for d in designs.to_dict("records")
            if json.dumps(d) not in known and campaign.design_key(d) not in known
        ]
        store.add_many(rows)

    monkeypatch.setattr(campaign, "run_campaign", here)
    line = f"augment --space full --source solver --test {test_table} --seeds 1 -o a --json {PLAN}"
    status, out, err = foldlab(line)
    assert status == 0, err
    assert "up to 32 labels by the solver, each at most 30 core-s" in err
    # Both strategies begin with the same designs.
    assert len(asked) == 12 + 2 * 4 and (tmp_path / "a" / "labels.db").exists()
    first = json.loads(out)
    again = json.loads(foldlab(line)[1])
    assert len(asked) == 20 and again == first
    assert (tmp_path / "a" / "curves.csv").exists()


def test_without_test_labels_nothing_is_labelled(foldlab, asked, monkeypatch, tmp_path):
    monkeypatch.setattr("foldlab.datasets.datasets", lambda: ["gravity-5k"])
    status, _, err = foldlab(f"augment --space full --source solver -o a {PLAN}")
    assert status == 2 and "too dear to make test labels first" in err
    assert not asked and not (tmp_path / "a").exists()
