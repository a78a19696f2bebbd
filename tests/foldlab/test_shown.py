"""How labels, spaces, answers and maps show themselves."""

import pickle

import pytest
from matplotlib.figure import Figure

from foldlab import FULL, PATTERNED, REDUCED, Answer, Label, TimoshenkoSource, Wish, make_classifier
from foldlab import regime_map as draw_map
from foldlab.inverse.answer import Proposal
from foldlab.labels.sources import SOURCES, make_source


def test_a_label_is_one_line_and_a_table_that_escapes_what_a_source_says():
    design = {"E_ratio": 0.25, "h_ratio": 1.0}
    label = Label(
        design, True, "it turns <b>enough</b>", {"fold_angle": 1.25, "history": [0] * 999}
    )
    assert repr(label) == "Label(folds, 1.25 rad; it turns <b>enough</b>)"
    html = label._repr_html_()
    assert "E_ratio" in html and "0.25" in html and "folds, 1.25 rad" in html
    assert "<b>" not in html and "&lt;b&gt;enough" in html
    assert repr(Label(design, None, "gave up", source="x")) == "Label(unknown; x: gave up)"
    assert repr(Label(design, False, "flat")) == "Label(does not fold; flat)"


def test_a_space_tells_its_bounds_also_where_they_were_changed():
    narrow = REDUCED.with_bounds(h_ratio=(0.5, 2))
    assert repr(narrow).startswith("DesignSpace(reduced: E_ratio 0.001 to 1000, h_ratio 0.5 to 2")
    html = FULL._repr_html_()
    assert html.count("<tr>") == 1 + len(FULL)
    assert all(p.name in html and p.meaning in html for p in FULL)


def test_an_answer_lists_its_designs():
    groups = {"E_ratio": 0.125, "h_ratio": 2.0, "slenderness": 0.01}
    empty = Answer(Wish(), 3, (), "nothing folds", 0.1)
    assert repr(empty) == "Answer(0 of 3 designs; nothing folds)"
    assert "nothing folds" in empty._repr_html_()
    one = Answer(
        Wish(), 1, (Proposal(groups, {}, (None, None), None, None, None, 0.5, {}),), "done", 0.1
    )
    assert "<td>0.125</td>" in one._repr_html_() and "<th>h_ratio</th>" in one._repr_html_()


@pytest.mark.parametrize("name", SOURCES)
def test_a_source_says_in_a_line_what_is_not_usual_and_all_of_it_in_a_table(name):
    source = make_source(name)
    assert repr(source) == f"{type(source).__name__}()"
    html = source._repr_html_()
    assert f"{name}, version {source.version}" in html and "<td>space</td>" in html
    assert repr(pickle.loads(pickle.dumps(source))) == repr(source)


def test_settings_of_a_source_are_told_record_by_record():
    source = make_source("solver", {"growth": "isotropic", "accuracy": 0.05}, space=PATTERNED)
    assert repr(source) == "SolverSource(growth='isotropic', accuracy=0.05, space='patterned')"
    row = "<tr><td>accuracy</td><td>0.05</td><td>0.02</td></tr>"
    assert row in source._repr_html_()
    assert "<tr><td>timeout</td><td>60.0</td><td></td></tr>" in source._repr_html_()
    plate = TimoshenkoSource(assumption="plate")
    assert repr(plate) == "TimoshenkoSource(assumption='plate')" and "1-plate" in str(
        plate._repr_html_()
    )


def test_a_map_plots_itself():
    labels = TimoshenkoSource().evaluate(REDUCED.sample(100, seed=0))
    tree = make_classifier("tree", REDUCED).fit(labels[REDUCED.names], labels["foldable"])
    figure = draw_map(tree, points=3 * 5**2, slices=[1e-3, 1e-2, 1e-1]).plot(title="mine")
    assert isinstance(figure, Figure) and figure.get_suptitle() == "mine"
