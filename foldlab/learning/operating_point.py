"""Operating points: few false positives at the price of some recall (§4.7.4).

A false positive promises a fold that does not happen. Two ways of having fewer: call a design
foldable only above a higher probability (threshold bias, Eqs. 4.28 and 4.31), or weight false
positives in the loss (loss bias). A threshold is chosen on a calibration split that the model
never saw, and reported on data that neither saw.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.model_selection import FixedThresholdClassifier

from foldlab.errors import InputError
from foldlab.learning.features import as_labels, probability_of_folding
from foldlab.learning.scoring import CONFIDENCE, clopper_pearson, score, upper_bound


@dataclass(frozen=True)
class OperatingPoint:
    """A threshold on the probability of folding, and the calibration that chose it.

    ``upper`` bounds the false-positive rate from above with the stated ``confidence`` (one-sided
    Clopper–Pearson on ``negatives`` calibration designs that do not fold, ``false_positives`` of
    which pass). ``labels`` is what the calibration cost.
    """

    threshold: float
    rate: float
    confidence: float
    upper: float
    false_positives: int
    negatives: int
    recall: float | None
    labels: int


def negatives_needed(rate: float, *, confidence: float = CONFIDENCE) -> int:
    """Fewest non-folding calibration designs that can show a false-positive rate ≤ ``rate``.

    With no false positive among n, the upper bound is 1 − (1 − confidence)^(1/n).
    """
    _check_rate(rate, confidence)
    return math.ceil(math.log1p(-confidence) / math.log1p(-rate))


def check_calibration(y, *, rate: float, confidence: float = CONFIDENCE) -> None:
    """That labels ``y`` (n,) hold enough designs that do not fold to show a rate ≤ ``rate``.

    Raises :class:`InputError` where not, and says how many are needed.
    """
    needed = negatives_needed(rate, confidence=confidence)
    negatives = int(np.sum(~as_labels(y)))
    if negatives < needed:
        total = math.ceil(needed * len(y) / max(negatives, 1))
        raise InputError(
            f"{negatives} calibration designs do not fold; a false-positive rate ≤ {rate:g} "
            f"with {confidence:.0%} confidence needs at least {needed} of them (here about "
            f"{total} labels in all): add labels, or allow a higher rate"
        )


def choose_threshold(model, X, y, *, rate: float, confidence: float = CONFIDENCE) -> OperatingPoint:
    """The lowest threshold whose false-positive rate is ≤ ``rate`` with the stated confidence.

    ``X`` (n, groups) and ``y`` (n,) are a calibration split that ``model`` was not trained on. The
    threshold lies just above the (k+1)-th highest probability among the non-folding designs, k
    being the most false positives whose upper bound still is ≤ ``rate``. For such an order
    statistic the bound holds exactly although the same data chose it: the true rate above it is at
    most Beta(k+1, n−k) distributed, whose quantile the Clopper–Pearson bound is.

    Raises :class:`InputError` for too few non-folding designs (it says how many are needed), for
    unknown labels, and where the model is certain of so many wrong designs that no threshold helps.
    """
    y = as_labels(y)
    return threshold_of(_probability(model, X, y), y, rate=rate, confidence=confidence)


def threshold_of(probability, y, *, rate: float, confidence: float = CONFIDENCE) -> OperatingPoint:
    """:func:`choose_threshold` from probabilities of folding (n,) and labels (n,)."""
    _check_rate(rate, confidence)
    y, probability = as_labels(y), np.asarray(probability, dtype=float)
    check_calibration(y, rate=rate, confidence=confidence)
    negatives = np.sort(probability[~y])[::-1]
    allowed = _most_false_positives(len(negatives), rate, confidence)
    threshold = float(np.nextafter(negatives[allowed], np.inf))
    if threshold > 1:
        certain = int(np.sum(negatives == negatives[0]))
        raise InputError(
            f"the model gives {certain} of {len(negatives)} non-folding designs probability 1, "
            f"{allowed} are allowed: no threshold reaches a rate ≤ {rate:g}; "
            "take another model or train it with a higher false_positive_weight"
        )
    false_positives = int(np.sum(negatives >= threshold))
    return OperatingPoint(
        threshold=threshold,
        rate=rate,
        confidence=confidence,
        upper=upper_bound(false_positives, len(negatives), confidence=confidence),
        false_positives=false_positives,
        negatives=len(negatives),
        recall=float(np.mean(probability[y] >= threshold)) if y.any() else None,
        labels=len(y),
    )


def with_threshold(model, threshold: float) -> FixedThresholdClassifier:
    """The fitted ``model`` that answers "folds" where its probability is ≥ ``threshold``."""
    number = isinstance(threshold, int | float) and not isinstance(threshold, bool)
    if not (number and 0 <= threshold <= 1):
        raise InputError(f"threshold = {threshold!r}; expected a probability from 0 to 1")
    return FixedThresholdClassifier(
        model, threshold=float(threshold), response_method="predict_proba"
    )


def at_rate(model, X, y, *, rate: float, confidence: float = CONFIDENCE):
    """``(model with the threshold, OperatingPoint)``: :func:`choose_threshold`, applied."""
    point = choose_threshold(model, X, y, rate=rate, confidence=confidence)
    return with_threshold(model, point.threshold), point


def threshold_curve(model, X, y, *, points: int = 200) -> pd.DataFrame:
    """Trade-off under threshold bias on data untouched by training and calibration.

    One row per threshold, ascending; columns ``threshold``, ``false_positive_rate`` with ``_low``
    and ``_high`` (two-sided Clopper–Pearson), ``recall``, ``precision`` (NaN where nothing is
    called foldable) and ``accuracy``. Thresholds are 0.5 and quantiles of the probabilities, dense
    where errors are.
    """
    y = as_labels(y)
    probability = _probability(model, X, y)
    if y.all() or not y.any():
        raise InputError("the labels hold one class only; a trade-off needs designs of both")
    # Errors sit in the upper tail of the negatives and the lower tail of the positives.
    tail = np.geomspace(1 / len(y), 1, max(points // 2, 2))
    levels = np.concatenate(
        [np.quantile(probability[~y], 1 - tail), np.quantile(probability[y], tail), [0.5]]
    )
    thresholds = np.unique(np.clip(levels, 0, 1))
    negatives, positives = np.sort(probability[~y]), np.sort(probability[y])
    rows = []
    for threshold in thresholds:
        fp = len(negatives) - int(np.searchsorted(negatives, threshold))
        tp = len(positives) - int(np.searchsorted(positives, threshold))
        low, high = clopper_pearson(fp, len(negatives))
        rows.append(
            {
                "threshold": threshold,
                "false_positive_rate": fp / len(negatives),
                "false_positive_rate_low": low,
                "false_positive_rate_high": high,
                "recall": tp / len(positives),
                "precision": tp / (tp + fp) if tp + fp else np.nan,
                "accuracy": (tp + len(negatives) - fp) / len(y),
            }
        )
    return pd.DataFrame(rows)


def loss_weight_curve(
    make: Callable, X_train, y_train, X, y, *, weights: Iterable[float] = (1, 3, 10, 30, 100)
) -> pd.DataFrame:
    """Trade-off under loss bias: one model trained per weight on false positives.

    ``make(false_positive_weight=w)`` gives an unfitted classifier; ``X``, ``y`` are untouched data.
    Columns ``weight`` and those of :func:`threshold_curve` but for the threshold, which stays 0.5.
    """
    rows = []
    for weight in weights:
        scored = score(make(false_positive_weight=weight).fit(X_train, y_train), X, y)
        low, high = scored["false_positive_rate_interval"] or (np.nan, np.nan)
        rows.append(
            {
                "weight": float(weight),
                "false_positive_rate": scored["false_positive_rate"],
                "false_positive_rate_low": low,
                "false_positive_rate_high": high,
                "recall": scored["recall"],
                "precision": scored["precision"],
                "accuracy": scored["accuracy"],
            }
        )
    if not rows:
        raise InputError("no weights; give at least one, such as weights=(1, 10)")
    return pd.DataFrame(rows).astype(float)


def _probability(model, X, y) -> np.ndarray:
    if len(X) != len(y) or len(y) == 0:
        raise InputError(f"{len(X)} designs and {len(y)} labels; expected one label per design")
    return probability_of_folding(model, X)


def _most_false_positives(n: int, rate: float, confidence: float) -> int:
    low, high = 0, n  # upper_bound(low) ≤ rate < upper_bound(high); it grows with the count
    while high - low > 1:
        middle = (low + high) // 2
        if upper_bound(middle, n, confidence=confidence) <= rate:
            low = middle
        else:
            high = middle
    return low


def _check_rate(rate: float, confidence: float) -> None:
    if not (0 < rate < 1 and 0 < confidence < 1):
        raise InputError(
            f"rate {rate:g} at confidence {confidence:g}; expected both between 0 and 1"
        )
