"""How good a classifier is: accuracy, false positives, exact intervals, seconds and size."""

from __future__ import annotations

import time

import numpy as np
import pandas as pd
from scipy.stats import beta
from sklearn.pipeline import Pipeline

from foldlab.errors import InputError
from foldlab.labels.foldability import Thresholds
from foldlab.learning.features import as_labels
from foldlab.tables import as_frame

CONFIDENCE = 0.95


TIMED_ROWS = 20_000  # fewer rows would time the call, not the model


def clopper_pearson(k: int, n: int, *, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Exact two-sided interval of a rate from ``k`` hits in ``n`` trials.

    It covers the true rate with at least the given confidence. Raises :class:`InputError` unless
    0 ≤ k ≤ n, n ≥ 1 and 0 < confidence < 1.
    """
    _check_counts(k, n, confidence)
    tail = (1 - confidence) / 2
    low = 0.0 if k == 0 else float(beta.ppf(tail, k, n - k + 1))
    high = 1.0 if k == n else float(beta.isf(tail, k + 1, n - k))
    return low, high


def upper_bound(k: int, n: int, *, confidence: float = CONFIDENCE) -> float:
    """Exact one-sided upper bound of a rate from ``k`` hits in ``n`` trials."""
    _check_counts(k, n, confidence)
    return 1.0 if k == n else float(beta.isf(1 - confidence, k + 1, n - k))


def _check_counts(k, n, confidence):
    if not (n >= 1 and 0 <= k <= n and 0 < confidence < 1):
        raise InputError(
            f"{k} hits in {n} trials at confidence {confidence}; expected 0 ≤ hits ≤ trials, "
            "at least one trial, and a confidence between 0 and 1"
        )


def score(model, X, y, *, confidence: float = CONFIDENCE) -> dict:
    """Compare a fitted classifier with known labels.

    Keys: ``n``; counts ``tp tn fp fn``; ``accuracy``, ``false_positive_rate`` (false positives
    over designs that do not fold), ``recall``, ``precision``, the first three with ``…_interval``
    (two-sided Clopper–Pearson) and the second with ``…_upper`` (one-sided); and
    ``seconds_per_million`` predictions. A rate without trials is None. Raises
    :class:`InputError` for unknown labels or tables of unequal length.
    """
    y = as_labels(y)
    if len(X) != len(y) or len(y) == 0:
        raise InputError(f"{len(X)} designs and {len(y)} labels; expected one label per design")
    folds = as_labels(model.predict(X))
    tp, fp = int(np.sum(folds & y)), int(np.sum(folds & ~y))
    fn, tn = int(np.sum(~folds & y)), int(np.sum(~folds & ~y))
    out = {"n": len(y), "tp": tp, "tn": tn, "fp": fp, "fn": fn}
    for name, hits, trials in (
        ("accuracy", tp + tn, len(y)),
        ("false_positive_rate", fp, fp + tn),
        ("recall", tp, tp + fn),
    ):
        out[name] = hits / trials if trials else None
        interval = clopper_pearson(hits, trials, confidence=confidence) if trials else None
        out[f"{name}_interval"] = interval
    negatives = fp + tn
    out["false_positive_rate_upper"] = (
        upper_bound(fp, negatives, confidence=confidence) if negatives else None
    )
    out["precision"] = tp / (tp + fp) if tp + fp else None
    out["seconds_per_million"] = seconds_per_million(model, X)
    return out


def reliability(probability, y, *, bins: int = 10) -> pd.DataFrame:
    """How often designs fold that a model gives such a probability, in bins of equal width.

    ``probability`` of folding (n,), labels ``y`` (n,). One row per bin that holds designs: ``n``,
    mean ``probability``, ``fraction`` that folds with ``low`` and ``high`` (two-sided
    Clopper–Pearson). Raises :class:`InputError` for tables of unequal length, and for what is no
    probability.
    """
    y, probability = as_labels(y), np.asarray(probability, dtype=float)
    if len(y) != len(probability) or len(y) == 0:
        raise InputError(
            f"{len(probability)} probabilities and {len(y)} labels; expected one per design"
        )
    if not ((probability >= 0) & (probability <= 1)).all():
        raise InputError("probabilities outside of 0 to 1; give the probability of folding")
    at = np.minimum((probability * bins).astype(int), bins - 1)
    rows = []
    for k in np.unique(at):
        here = at == k
        n, folds = int(here.sum()), int(y[here].sum())
        low, high = clopper_pearson(folds, n)
        mean = float(probability[here].mean())
        rows.append({"n": n, "probability": mean, "fraction": folds / n, "low": low, "high": high})
    return pd.DataFrame(rows)


def calibration_error(probability, y, *, bins: int = 10) -> float:
    """Expected calibration error: Σ n_b/n |fraction that folds − mean probability|.

    Over the bins of :func:`reliability` (Naeini, Cooper and Hauskrecht, AAAI 2015). It is above 0
    for a perfect model too, by the noise of n labels.
    """
    table = reliability(probability, y, bins=bins)
    off = (table["fraction"] - table["probability"]).abs()
    return float((table["n"] * off).sum() / table["n"].sum())


def angle_errors(model, X: pd.DataFrame, y) -> dict[str, float | int | None]:
    """How far predicted angles are from known ones ``y`` (n,) in rad.

    Keys: ``n``; ``error_median`` and ``error_90`` (90 % are below), relative to the angle or to
    what counts as folded, whichever is larger, as labels state theirs; ``folding_median`` and
    ``folding_90``, relative to the angle, of the designs that fold; ``accuracy`` of the verdict
    that the angle alone gives.
    """
    y, told = np.asarray(y, dtype=float), np.asarray(model.predict(X), dtype=float)
    thresholds, c = Thresholds(), X["contraction"].to_numpy(float)
    off, need = np.abs(told - y), thresholds.angle(c)
    folds = y > need
    relative = off / thresholds.scale(y, c)
    of_folds = off[folds] / y[folds] if folds.any() else None
    return {
        "n": len(y),
        "error_median": float(np.median(relative)),
        "error_90": float(np.quantile(relative, 0.9)),
        "folding_median": None if of_folds is None else float(np.median(of_folds)),
        "folding_90": None if of_folds is None else float(np.quantile(of_folds, 0.9)),
        "accuracy": float(np.mean((told > need) == folds)),
    }


def seconds_per_million(model, X) -> float:
    """Wall seconds for a million predictions, from one call on at least 20 000 rows."""
    rows = np.arange(max(len(X), TIMED_ROWS)) % len(X)
    X = as_frame(X)
    X = X.iloc[rows] if isinstance(X, pd.DataFrame) else np.asarray(X)[rows]
    start = time.perf_counter()
    model.predict(X)
    return (time.perf_counter() - start) / len(rows) * 1e6


def model_size(model) -> tuple[int, str]:
    """Size of a fitted model and its unit: ``(219, "nodes")`` or ``(1234, "weights")``.

    A model of another kind states its own size as a property ``size_``. Raises
    :class:`InputError` for a model without one.
    """
    if isinstance(model, Pipeline):
        model = model[-1]
    if hasattr(model, "size_"):
        return model.size_
    if hasattr(model, "_predictors"):  # boosting has no public count of its nodes
        return sum(len(p.nodes) for stage in model._predictors for p in stage), "nodes"
    if hasattr(model, "estimators_"):
        return sum(t.tree_.node_count for t in model.estimators_), "nodes"
    if hasattr(model, "tree_"):
        inner = model.tree_
        return (inner.node_count, "nodes") if hasattr(inner, "node_count") else model_size(inner)
    inner = getattr(model, "estimator_", getattr(model, "estimator", None))
    if inner is None:
        raise InputError(f"{type(model).__name__} does not state its size; give it a size_")
    return model_size(inner)
