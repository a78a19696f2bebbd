"""Which few numbers decide lift-off and folding under weight, and where is Timoshenko enough?

Short rules in the terms of :mod:`foldlab.labels.beam`, each with its accuracy on solver labels
(fitted ones in five folds), as Python, LaTeX and SymPy; how much each group matters to boosted
trees (permutation importance on labels that they have not seen); and from which stiffness-to-weight
on the formula without weight is right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import sympy
from matplotlib.figure import Figure
from sklearn.inspection import permutation_importance
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_val_predict, train_test_split
from sklearn.tree import DecisionTreeClassifier, export_text

from foldlab.datasets import load_dataset
from foldlab.design import FULL
from foldlab.labels import beam
from foldlab.learning.features import as_labels
from foldlab.learning.models import make_classifier
from foldlab.learning.scoring import clopper_pearson
from foldlab.plots import STYLE, SYMBOLS

from .common import counted, main, save_figure

T, E, W, S, LIFT = sympy.symbols("T E W S lambda", real=True)
COLUMNS = {T: "turning", E: "edge", W: "weight", S: "sag", LIFT: "lift_off"}
m, n, length, width, gamma, slender, c = sympy.symbols(
    "m n l_i b_i Gamma h c", positive=True
)  # h_i/h_s, E_i/E_s, l_i/l_s, b_i/b_s, Γ, h_s/l_s, |g|
GROUPS = {
    m: "h_ratio", n: "E_ratio", length: "hinge_length", width: "hinge_width",
    gamma: "stiffness_to_weight", slender: "slenderness", c: "contraction",
}  # fmt: skip


@dataclass(frozen=True)
class Config:
    seed: int = 0
    dataset: str = "gravity"
    leaves: int = 8
    limit: int = 0
    """Labels to use at most; 0: all."""


TINY = Config(limit=300)


def terms() -> dict[sympy.Symbol, sympy.Expr]:
    """T, S and λ in the groups, as :mod:`foldlab.labels.beam` computes them (λ: ``lift_off``)."""
    curved = 6 * (1 + m) / (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n)))
    panel = (1 - length) / 2
    bending = (1 + m**3 * n) / 12 + m * n * (1 + m) ** 2 / (4 * (1 + m * n))
    turned = curved * length / (slender * sympy.pi)
    taken = panel**2 * length / (2 * bending * width * gamma * c * sympy.pi)
    return {T: turned, S: 4 * panel**3 / (gamma * c * sympy.pi), LIFT: turned / taken}


def run(config: Config, tracker) -> dict[str, Any]:
    table = load_dataset(config.dataset, growth="uniaxial", space="full")
    known = table[counted(table) & table["foldable"].notna().to_numpy()]
    known = known.head(config.limit) if config.limit else known
    parts = beam.formulas(known)[list(COLUMNS.values())]
    folds = as_labels(known["foldable"])
    up = (known["outcome"] != "grounded").to_numpy()
    splits = StratifiedKFold(5, shuffle=True, random_state=config.seed)

    rows = [
        _row("folds", T > 1, parts, folds),
        _row("folds", T + E > 1, parts, folds),
        _row("folds", T + E - W - S > 1, parts, folds),
        _row("leaves the ground", LIFT > 1, parts, up),
    ]
    for question, names, truth in (
        ("folds", [T, E, W, S], folds), ("folds", [T, W, S], folds),
        ("leaves the ground", [LIFT, S], up),
    ):  # fmt: skip
        rows.append(_fitted(question, names, parts, truth, splits))
    X = known[FULL.names].reset_index(drop=True)
    tree = DecisionTreeClassifier(max_leaf_nodes=config.leaves, random_state=config.seed)
    sums = beam.formulas(known)
    right = cross_val_predict(tree, sums, folds, cv=splits) == folds
    words = export_text(tree.fit(sums, folds), feature_names=list(sums), decimals=3)
    rows.append(_told("folds", f"tree of {tree.get_n_leaves()} leaves", "", words, right))

    train, test = train_test_split(
        np.arange(len(X)), test_size=0.3, random_state=config.seed, stratify=folds
    )
    model = make_classifier("boosted", FULL, seed=config.seed)
    model.fit(X.iloc[train], folds[train])
    lost = permutation_importance(
        model, X.iloc[test], folds[test], n_repeats=5, random_state=config.seed
    )
    importance = dict(sorted(zip(FULL.names, map(float, lost.importances_mean), strict=True),
                             key=lambda pair: -pair[1]))  # fmt: skip
    enough = _enough(known, parts, folds)
    figure = picture(known, parts, folds, importance, enough)
    save_figure(figure, "gravity_rules")
    tracker.figure("gravity_rules", figure)
    tracker.table("rules", pd.DataFrame(rows))
    return {
        "labels": len(known),
        "importance": importance,
        "timoshenko_is_right": enough,
        "terms": {str(k): sympy.latex(v) for k, v in terms().items()},
        "table": rows,
    }


def _row(question: str, rule: sympy.Rel, parts: pd.DataFrame, truth: np.ndarray) -> dict[str, Any]:
    """A rule without anything fitted."""
    names = sorted(rule.free_symbols, key=str)
    says = sympy.lambdify(names, rule, "numpy")(*(parts[COLUMNS[s]].to_numpy() for s in names))
    return _told(question, str(rule), sympy.latex(rule), _python(rule), says == truth)


def _fitted(question, names, parts, truth, splits) -> dict[str, Any]:
    """A weighted sum of terms against 1, the weights by logistic regression in five folds."""
    X = parts[[COLUMNS[s] for s in names]].to_numpy()
    if question != "folds":
        X = np.log(X)
    X = np.clip(X, -50, 50)  # far from the threshold a term decides by itself
    model = LogisticRegression(C=100.0, max_iter=2000)
    right = cross_val_predict(model, X, truth, cv=splits) == truth
    model.fit(X, truth)
    scale = -model.intercept_[0] if question == "folds" else 1.0
    weights = [round(float(w), 3) for w in model.coef_[0] / scale]
    logs = names if question == "folds" else [sympy.log(s) for s in names]
    bound = 1 if question == "folds" else round(-float(model.intercept_[0]), 3)
    rule = sum(w * s for w, s in zip(weights, logs, strict=True)) > bound
    return _told(question, f"{rule} (fitted)", sympy.latex(rule), _python(rule), right)


def _python(rule: sympy.Rel) -> str:
    names = {s: sympy.Symbol(COLUMNS[s]) for s in rule.free_symbols}
    return sympy.pycode(rule.xreplace(names), fully_qualified_modules=False)


def _told(question: str, rule: str, latex: str, python: str, right: np.ndarray) -> dict[str, Any]:
    low, high = clopper_pearson(int(right.sum()), len(right))
    return {
        "question": question, "rule": rule, "accuracy": float(right.mean()),
        "accuracy_low": low, "accuracy_high": high, "latex": latex, "python": python,
    }  # fmt: skip


def _enough(known: pd.DataFrame, parts: pd.DataFrame, folds: np.ndarray) -> list[dict[str, float]]:
    """How often T + E > 1 alone is right, by the stiffness-to-weight group."""
    weight = known["stiffness_to_weight"].to_numpy(float)
    right = ((parts["turning"] + parts["edge"]).to_numpy() > 1) == folds
    plain = (parts["turning"].to_numpy() > 1) == folds
    rows = []
    for low, high in zip(edges := 10.0 ** np.linspace(-2, 2, 9), edges[1:], strict=False):
        here = (weight >= low) & (weight <= high)
        if here.any():
            rows.append({
                "from": float(low), "to": float(high), "labels": int(here.sum()),
                "T": float(plain[here].mean()), "T + E": float(right[here].mean()),
            })  # fmt: skip
    return rows


def picture(known, parts, folds, importance, enough) -> Figure:
    """Labels over what turns and what weight takes; importance; where Timoshenko is right."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 2.9), layout="constrained")
        rule, bars, line = figure.subplots(1, 3)
        x = (parts["turning"] + parts["edge"]).to_numpy()
        y = (parts["weight"] + parts["sag"]).to_numpy()
        for is_, colour, name in ((True, "#0B3C9C", "folds"), (False, "#B3261E", "does not")):
            at = folds == is_
            rule.plot(x[at], y[at], ".", ms=1.6, color=colour, label=name, rasterized=True)
        need = np.geomspace(1.001, 300, 200)
        rule.plot(need, need - 1, "k", lw=0.9, label="T + E − W − S = 1")
        rule.set(
            xscale="log", yscale="log", xlim=(1e-2, 300), ylim=(1e-3, 300),
            xlabel="T + E: what turns", ylabel="W + S: what weight takes",
        )  # fmt: skip
        rule.legend(fontsize=6, loc="lower left", markerscale=4)
        names = list(importance)[::-1]
        bars.barh([f"${SYMBOLS[k]}$" for k in names], [importance[k] for k in names], color="0.4")
        bars.set(xlabel="accuracy lost when shuffled")
        middle = [np.sqrt(row["from"] * row["to"]) for row in enough]
        for name, style in (("T", "o-"), ("T + E", "s--")):
            line.plot(
                middle, [row[name] for row in enough], style, ms=3, lw=0.9, label=f"{name} > 1"
            )
        line.set(xscale="log", xlabel="Γ = E h² / (ρ g l³)", ylabel="right without weight")
        line.legend(fontsize=6)
    return figure


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
