"""What accuracy_vs_time computes from its measurements: intervals, mixtures, slopes, choices."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments._accuracy import labels, plots
from experiments.accuracy_vs_time import Config, chosen, run
from foldlab.errors import InputError
from foldlab.labels.screening import COARSE_ERROR


def test_wilsons_interval():
    assert labels.wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert labels.wilson(5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)
    assert labels.wilson(0, 0) == (0.0, 1.0)


def booleans(*values):
    return pd.Series(pd.array(values, dtype="boolean"))


def test_only_labels_known_to_both_are_compared():
    found = labels.disagreement(
        booleans(True, False, True, None, True), booleans(True, True, None, True, True)
    )
    assert (found["compared"], found["wrong"]) == (3, 1)
    assert found["disagreement"] == pytest.approx(1 / 3)
    nothing = labels.disagreement(booleans(None), booleans(True))
    assert nothing["disagreement"] is None and nothing["compared"] == 0


def coarse_labels():
    """Four designs of |g|π = 0.314: clear, 5 % above the threshold, a full turn, no state."""
    m1 = [1.0, 0.33, 6.5, np.nan]
    frame = pd.DataFrame({"m1": m1, "contraction": 0.1, "m2": 0.0, "m3": 1.0, "m4": 1.0})
    frame["unstable_modes"], frame["events"], frame["core_seconds"] = 0.0, "[]", 1.0
    frame["error_estimate"] = [COARSE_ERROR] * 3 + [np.nan]
    frame["foldable"] = booleans(True, None, True, None)
    frame["outcome"] = ["folds", "unresolved", "folds", "timeout"]
    for tag in labels.TAGS:
        frame[tag] = pd.Series([True, True, True, None], dtype=object)
    return frame


def test_tags_answer_where_the_error_leaves_it_open():
    assert labels.raw(coarse_labels()).tolist() == [True, True, True, pd.NA]


def test_a_mixture_pays_for_what_it_refines():
    coarse = coarse_labels()
    table = pd.DataFrame({"foldable": booleans(True, False, True, None), "core_seconds": 3.0})
    fine = table.assign(core_seconds=6.0)  # this machine is half as fast
    rows = {row["band"]: row for row in labels.mixing(table, coarse, fine)}
    assert rows["coarse"]["wrong"] == 1 and rows["coarse"]["core_seconds_mean"] == 1.0
    # in doubt: the full turn and the one without a state
    assert rows[0.0]["refined"] == 0.5 and rows[0.0]["wrong"] == 1
    assert rows[0.0]["core_seconds_mean"] == pytest.approx((1 + 1 + 6 + 6) / 4)
    assert rows[COARSE_ERROR]["refined"] == 0.75 and rows[COARSE_ERROR]["wrong"] == 0
    assert rows[None]["refined"] == 1.0 and rows[None]["labels_per_hour"] == pytest.approx(600)


def test_error_bars_reach_from_the_lower_to_the_upper_end():
    row = {"disagreement": 0.1, "disagreement_low": 0.09, "disagreement_high": 0.3,
           "labels_per_hour": 50.0, "source": "rod", "wrong": 1, "compared": 10}  # fmt: skip
    (bar,) = plots.draw_ladder([row], []).axes[0].containers
    (ends,) = bar.lines[2][0].get_segments()
    assert ends == pytest.approx(np.array([[50.0, 0.09], [50.0, 0.3]]))


def test_an_hour_follows_the_slope_of_the_measured_rows():
    rows = [
        {"labels_are": "coarse", "labels": n, "accuracy": 1 - 2 / n**0.5} for n in (100, 400, 900)
    ]
    (found,) = labels.in_an_hour(rows, {"coarse": 0.25, "accurate": 1.0})
    assert found["labels"] == 14_400 and found["beyond"] == 16
    assert found["exponent"] == pytest.approx(0.5)
    assert found["accuracy"] == pytest.approx(1 - 2 / 120)


def test_the_cheapest_mesh_is_one_that_holds_in_every_scene():
    def row(scene, element, error, seconds):
        return {"scene": scene, "element": element, "level": 1, "error": error,
                "core_seconds": seconds}  # fmt: skip

    rows = [
        row("a", "tet4", 0.01, 0.1),
        row("b", "tet4", 0.5, 0.1),
        row("a", "hex8", 0.01, 0.1),
        row("b", "hex8", None, 0.1),
        row("a", "hex20", 0.01, 2.0),
        row("b", "hex20", 0.04, 2.0),
        row("a", "hex27", 0.001, 3.0),
        row("b", "hex27", 0.002, 3.0),
    ]
    found = chosen({"elements": rows})
    assert [r["take"] for r in found] == ["hex20 on mesh 1", "hex27 on mesh 1"]
    assert found[0]["wrong"].startswith("4.00%") and found[0]["costs"].startswith("4 core")


def test_parts_that_are_not_there_are_refused():
    with pytest.raises(InputError, match="expected some of a, b"):
        run(Config(parts=("a", "z")), SimpleNamespace())
    with pytest.raises(InputError, match="expected 1 to 4"):
        run(Config(reference=5), SimpleNamespace())
