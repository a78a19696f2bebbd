"""Parts (d) to (f) of accuracy_vs_time: the ladder of label sources, classifiers, label budgets.

Costs are core-seconds of one thread that the labels themselves state; a rate in labels per hour is
3600 over their mean, with unknown labels paid for too.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import numpy as np
import pandas as pd
from sklearn.model_selection import train_test_split

from foldlab.campaign.campaign import run_campaign
from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.labels.asked import Effort
from foldlab.labels.foldability import TAGS, Thresholds
from foldlab.labels.screening import COARSE_ERROR, coarse_errors, near
from foldlab.labels.solver import SolverSource
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.models import make_classifier
from foldlab.learning.scoring import score, seconds_per_million

from ..common import OUT
from ..gravity_campaign import SHEETS

FINEST = "quarter, 0.5 %"
ODD = "snap|sideways|rocking|twisting|symmetric|bifurcation"  # see foldlab.labels.screening.decided


def ladder_sources(timeout: float) -> dict[str, Any]:
    """Name → label source, from the cheapest to the finest; the whole unit last."""
    return {
        "Timoshenko": TimoshenkoSource(FULL),
        "quarter, coarse": SolverSource(effort=Effort(refine="never", timeout=timeout)),
        "mixed": SolverSource(effort=Effort(refine="near", timeout=timeout)),
        "quarter, 2 %": SolverSource(effort=Effort(timeout=timeout)),
        FINEST: SolverSource(effort=Effort(accuracy=0.005, timeout=timeout)),
        "whole, 2 %": SolverSource(effort=Effort(timeout=4 * timeout), seed=0),
    }


def labelled(designs: pd.DataFrame, source, store: LabelStore, workers: int) -> pd.DataFrame:
    """Labels of the designs, in their order; those that the store lacks are computed.

    ``workers``: processes; 0 labels in a thread of this one.
    """
    with nullcontext() if workers else ThreadPoolExecutor(1) as executor:
        run_campaign(
            designs, source, store, executor=executor, workers=max(workers, 1), progress=False
        )
    frame = store.frame(source.name, source.version)
    order = designs[FULL.names].reset_index(drop=True).reset_index(names="row")
    return order.merge(frame, on=FULL.names).sort_values("row").reset_index(drop=True)


def raw(frame: pd.DataFrame) -> pd.Series:
    """What the tags alone say, whether or not the error leaves that open; NA without a state."""
    answer = frame["foldable"].astype("boolean").copy()
    if "F1" in frame:
        settled = frame["outcome"].isin(["unresolved"]) & frame["F1"].notna()
        tags = frame.loc[settled, list(TAGS)].astype(bool).all(axis=1)
        answer.loc[settled] = tags.astype("boolean")
    return answer


def wilson(k: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's 95 % interval of a fraction of k in n; (0, 1) of none."""
    if n == 0:
        return 0.0, 1.0
    p, d = k / n, 1 + z * z / n
    middle, half = (p + z * z / (2 * n)) / d, z / d * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def disagreement(answer: pd.Series, truth: pd.Series) -> dict[str, Any]:
    """How many of the labels known to both differ, with Wilson's interval."""
    both = (answer.notna() & truth.notna()).to_numpy()
    wrong = int((answer[both].astype(bool).to_numpy() != truth[both].astype(bool).to_numpy()).sum())
    low, high = wilson(wrong, int(both.sum()))
    fraction = float(wrong / both.sum()) if both.any() else None
    return {"compared": int(both.sum()), "wrong": wrong, "disagreement": fraction,
            "disagreement_low": low, "disagreement_high": high}  # fmt: skip


def ladder(config, say: Callable[[dict], None]) -> list[dict]:
    """(d): each source on the same designs, against the finest."""
    designs = SHEETS.sample(config.ladder, seed=config.seed + 7000)
    tables = {}
    OUT.mkdir(exist_ok=True)
    with LabelStore(OUT / "accuracy_vs_time.db") as store:
        for name, source in ladder_sources(config.timeout).items():
            part = designs.head(config.ladder_whole) if name.startswith("whole") else designs
            if not len(part):
                continue
            tables[name] = labelled(part, source, store, config.workers)
    truth = tables[FINEST]["foldable"].astype("boolean")
    rows = []
    for name, frame in tables.items():
        spent = "seconds" if name == "Timoshenko" else "core_seconds"
        known, reference = frame["foldable"].astype("boolean"), truth.head(len(frame))
        row = {
            "source": name,
            "labels": len(frame),
            "known": float(known.notna().mean()),
            **disagreement(known, reference),
            "core_seconds_mean": float(frame[spent].mean()),
            "core_seconds_median": float(frame[spent].median()),
            "labels_per_hour": 3600 / float(frame[spent].mean()),
        }
        say(row)
        rows.append(row)
    return rows


def cheap_labels(config) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """The dataset (uniaxial), and coarse and accurate labels of some of its designs, made now.

    The accurate ones are few: they tell what a label of the dataset would cost on this machine now.
    """
    table = load_dataset(config.dataset)
    table = table[table["growth"] == "uniaxial"].reset_index(drop=True)
    pick = np.random.default_rng(config.seed).permutation(len(table))[: config.cheap]
    designs = table.loc[pick, FULL.names]
    OUT.mkdir(exist_ok=True)
    with LabelStore(OUT / "accuracy_vs_time.db") as store:
        source = SolverSource(effort=Effort(refine="never", timeout=config.timeout))
        coarse = labelled(designs, source, store, config.workers)
        source = SolverSource(effort=Effort(timeout=config.timeout))
        fine = labelled(designs.head(config.clocked), source, store, config.workers)
    coarse.index = pick
    fine.index = pick[: len(fine)]
    return table, coarse, fine


def mixing(table: pd.DataFrame, coarse: pd.DataFrame, fine: pd.DataFrame) -> list[dict]:
    """Mixed labels by the width of the band that is refined, from coarse and accurate labels.

    Where a coarse measure lies within the band around its threshold, or the coarse path is in
    doubt, the accurate label of the dataset counts and its cost is added. ``wrong`` compares to the
    dataset. Band 0 refines only what is in doubt, None everything.
    """
    # This machine's pace against that of the dataset's labels, from designs labelled by both.
    pace = fine["core_seconds"].sum() / table.loc[fine.index, "core_seconds"].sum()
    there = table.loc[coarse.index]
    cheap, truth = raw(coarse), there["foldable"].astype("boolean")
    settled = coarse["error_estimate"].notna()
    # Labels that cost nothing more than the coarse path, for they ended with it.
    extra = (pace * there["core_seconds"] - coarse["core_seconds"]).clip(lower=0)
    closed = Thresholds().closed(coarse["m1"], coarse["m2"])
    doubt = ~settled | closed | (coarse["unstable_modes"] != 0)
    doubt |= coarse["events"].astype(str).str.contains(ODD)
    rows = []
    t = Thresholds()
    for band in (0.0, 0.05, COARSE_ERROR, 0.3, np.inf):
        crosses = [
            bool(near(row, g, t, coarse_errors(row["m1"], g, t, band))) or not np.isfinite(band)
            for row in coarse.to_dict("records")
            for g in [row["contraction"]]
        ]
        refined = doubt | np.array(crosses)
        answer = cheap.where(~refined, truth)
        cost = coarse["core_seconds"] + extra.where(refined, 0.0)
        rows.append(
            {
                "band": band if np.isfinite(band) else None,
                "refined": float(refined.mean()),
                **disagreement(answer, truth),
                "core_seconds_mean": float(cost.mean()),
                "labels_per_hour": 3600 / float(cost.mean()),
            }
        )
    return [{"band": "coarse", "refined": 0.0, **disagreement(cheap, truth),
             "core_seconds_mean": float(coarse["core_seconds"].mean()),
             "labels_per_hour": 3600 / float(coarse["core_seconds"].mean())}, *rows]  # fmt: skip


def calibration(table: pd.DataFrame, coarse: pd.DataFrame) -> dict[str, Any]:
    """The coarsest mesh's error against the dataset, and how many keep the bound that is stated.

    As :data:`foldlab.labels.screening.COARSE_ERROR` and ``COARSE_SLIP`` define them, where both
    paths reached the full contraction.
    """
    there = table.loc[coarse.index]
    reached = (coarse["contraction_reached"] >= coarse["contraction"] * (1 - 1e-9)) & (
        there["contraction_reached"] >= there["contraction"] * (1 - 1e-6)
    )
    reached &= coarse["error_estimate"].notna() & there["error_estimate"].notna()
    a, b = coarse[reached], there[reached]
    need = Thresholds().angle(b["contraction"])
    along = (a["m1"] - b["m1"]).abs() / Thresholds().scale(b["m1"], b["contraction"])
    off = np.maximum(along, (a["m2"] - b["m2"]).abs() / need)
    slip = np.maximum((a["m3"] - b["m3"]).abs(), (a["m4"] - b["m4"]).abs())
    kept = int((off <= COARSE_ERROR).sum())
    low, high = wilson(kept, len(a))
    quantiles = {"median": 0.5, "90": 0.9, "95": 0.95, "99": 0.99}
    return {
        "designs": len(a),
        **{f"error_{name}": float(off.quantile(q)) for name, q in quantiles.items()},
        **{f"slip_{name}": float(slip.quantile(q)) for name, q in quantiles.items()},
        "bound": COARSE_ERROR,
        "within": kept / len(a) if len(a) else None,
        "within_low": low,
        "within_high": high,
    }


def split(table: pd.DataFrame, config) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Labels to learn from (unknown ones too: they cost) and known ones that nothing else sees."""
    known = table[table["foldable"].notna()]
    _, test = train_test_split(
        known,
        test_size=config.test,
        random_state=config.seed,
        stratify=known["foldable"].astype(bool),
    )
    train = table.drop(index=test.index)
    return train.sample(frac=1, random_state=config.seed), test


def classifiers(config, say: Callable[[dict], None]) -> list[dict]:
    """(e): accuracy against labels, and what labelling, training and prediction cost."""
    table = load_dataset(config.dataset)
    train, test = split(table[table["growth"] == "uniaxial"].reset_index(drop=True), config)
    X, y = test[FULL.names], test["foldable"]
    rows = []
    for name in config.models:
        for count in [*config.counts, len(train)]:
            for seed in range(config.seeds if count < len(train) else 1):
                part = train.sample(min(count, len(train)), random_state=seed)
                model, seconds = _fitted(name, part, seed)
                if model is None:
                    continue
                result = score(model, X, y)
                row = {
                    "model": name,
                    "labels": len(part),
                    "seed": seed,
                    "accuracy": result["accuracy"],
                    "accuracy_low": result["accuracy_interval"][0],
                    "accuracy_high": result["accuracy_interval"][1],
                    "false_positive_rate": result["false_positive_rate"],
                    "label_core_seconds": float(part["core_seconds"].sum()),
                    "train_seconds": seconds,
                    "seconds_per_million": seconds_per_million(model, X),
                    "test": len(test),
                }
                say(row)
                rows.append(row)
    return rows


def _fitted(name: str, labels: pd.DataFrame, seed: int, column: str = "foldable"):
    """A model and its seconds of training; None where all known labels say the same."""
    known = labels[labels[column].notna()]
    if known[column].nunique() < 2:
        return None, 0.0
    start = time.perf_counter()
    # From groups alone: what labels teach is the question here, not what is known without.
    model = make_classifier(name, FULL, seed=seed, inputs="groups")
    model.fit(known[FULL.names], known[column].astype(bool).to_numpy())
    return model, time.perf_counter() - start


def prices(coarse: pd.DataFrame, fine: pd.DataFrame) -> dict[str, float]:
    """Core-seconds per label on this machine: the mean of the coarse ones, and by how much more the
    accurate ones cost on the same designs."""
    each = float(coarse["core_seconds"].mean())
    both = fine["core_seconds"].sum() / coarse.loc[fine.index, "core_seconds"].sum()
    return {"accurate": each * float(both), "coarse": each}


def budgets(config, table, coarse, price, say: Callable[[dict], None]) -> list[dict]:
    """(f): the same budget of core-seconds as accurate labels, as coarse ones or half of each.

    A budget for which there are too few labels is left out. The coarse and the accurate halves are
    labels of different designs. Timoshenko's labels, which cost nothing, come last.
    """
    known = table["foldable"].notna()
    # Tested on accurate labels of designs that have no cheap label, and that nobody learns from.
    others = table[known & ~table.index.isin(coarse.index)]
    _, test = train_test_split(others, test_size=config.budget_test, random_state=config.seed,
                               stratify=others["foldable"].astype(bool))  # fmt: skip
    X, y = test[FULL.names], test["foldable"]
    free = table.drop(index=test.index)
    rough = coarse.assign(foldable=raw(coarse))
    rows = []
    for budget in config.budgets:
        for seed in range(config.seeds):
            draw = {
                "accurate": _drawn(free, budget / price["accurate"], seed),
                "coarse": _drawn(rough, budget / price["coarse"], seed),
            }
            half = [
                _drawn(rough, budget / 2 / price["coarse"], seed),
                _drawn(free.drop(index=rough.index), budget / 2 / price["accurate"], seed),
            ]
            if all(part is not None for part in half):
                draw["half coarse, half accurate"] = pd.concat(half)
            for kind, part in draw.items():
                if part is None:
                    continue
                model, seconds = _fitted(config.budget_model, part, seed)
                if model is None:
                    continue
                result = score(model, X, y)
                row = {
                    "labels_are": kind, "budget": budget, "seed": seed, "labels": len(part),
                    "accuracy": result["accuracy"], "train_seconds": seconds, "test": len(test),
                    "false_positive_rate": result["false_positive_rate"],
                }  # fmt: skip
                say(row)
                rows.append(row)
    many = SHEETS.sample(config.formula_labels, seed=config.seed + 2000)
    formula = TimoshenkoSource(FULL)
    start = time.perf_counter()
    labels = formula.evaluate(many)
    spent = time.perf_counter() - start
    model, seconds = _fitted(config.budget_model, labels, config.seed)
    result = score(model, X, y)
    row = {
        "labels_are": "Timoshenko", "budget": spent, "seed": config.seed, "labels": len(many),
        "accuracy": result["accuracy"], "train_seconds": seconds, "test": len(test),
        "false_positive_rate": result["false_positive_rate"],
    }  # fmt: skip
    say(row)
    return [*rows, row]


def in_an_hour(rows: list[dict], price: dict[str, float], hour: float = 3600.0) -> list[dict]:
    """What an hour of labels would train: error ∝ labels^−p through the means of each kind's rows.

    ``beyond``: how many times more labels that are than the most that were trained on; above 1 it
    is an extrapolation, and errors of the labels themselves, which no number of them mends, are not
    in it.
    """
    projected = []
    for kind, each in price.items():
        part = pd.DataFrame([r for r in rows if r["labels_are"] == kind])
        if part.empty:
            continue
        means = (1 - part.groupby("labels")["accuracy"].mean()).clip(lower=1e-4)
        if len(means) < 3:
            continue
        slope, level = np.polyfit(np.log(means.index), np.log(means), 1)
        count = hour / each
        projected.append(
            {
                "labels_are": kind,
                "labels": int(count),
                "core_seconds_per_label": each,
                "accuracy": float(1 - np.exp(level + slope * np.log(count))),
                "exponent": float(-slope),
                "beyond": count / float(means.index.max()),
            }
        )
    return projected


def _drawn(labels: pd.DataFrame, count: float, seed: int) -> pd.DataFrame | None:
    count = int(count)
    if not 1 <= count <= len(labels):
        return None
    return labels.sample(count, random_state=seed)
