"""A table of designs with its labels beside it, whoever made them and when."""

import pandas as pd
import pytest

from foldlab.campaign import campaign
from foldlab.campaign.campaign import labelled
from foldlab.design import REDUCED
from foldlab.labels.label import Label
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource

SOURCE = TimoshenkoSource()


@pytest.fixture
def designs():
    table = REDUCED.sample(12, seed=0).assign(predicted=True, foldable_too=range(12))
    return table.set_index(pd.Index(range(100, 112)))


def test_labels_stand_beside_their_designs_in_order_with_what_else_is_known(designs):
    table = labelled(designs, SOURCE, progress=False)
    assert table.index.equals(designs.index)
    pd.testing.assert_frame_equal(table[list(designs)], designs)
    expected = SOURCE.evaluate(designs)["foldable"].to_numpy(bool)
    assert (table["foldable"].to_numpy(bool) == expected).all()


def test_designs_that_stand_twice_have_the_same_label_twice(designs):
    twice = pd.concat([designs, designs.iloc[:3]])
    table = labelled(twice, SOURCE, progress=False)
    assert len(table) == 15 and table["foldable"].iloc[-3:].equals(table["foldable"].iloc[:3])


def test_what_the_store_has_is_not_asked_again(designs, tmp_path, monkeypatch):
    with LabelStore(tmp_path / "s.db") as store:
        first = labelled(designs, SOURCE, store, progress=False)
        monkeypatch.setattr(TimoshenkoSource, "label_many", None)
        again = labelled(designs.iloc[::-1], SOURCE, store, progress=False)
    assert again.iloc[::-1]["foldable"].equals(first["foldable"])


def test_what_was_not_labelled_is_unknown(designs, monkeypatch):
    def half(designs, source, store, **_):
        rows = designs.iloc[::2].to_dict("records")
        store.add_many(Label(d, True, "so", {}, source.name, source.version) for d in rows)

    monkeypatch.setattr(campaign, "run_campaign", half)
    table = labelled(designs, SOURCE)
    assert table["foldable"].isna().tolist() == [False, True] * 6 and len(table) == 12


def test_a_rate_is_of_the_time_that_a_run_took(designs, tmp_path):
    with LabelStore(tmp_path / "s.db") as store:
        report = campaign.run_campaign(designs, SOURCE, store, progress=False)
    assert 0 < report.seconds < 60 and report.computed == 12
    assert report.rate == 12 / report.seconds
