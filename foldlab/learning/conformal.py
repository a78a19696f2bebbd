"""Split conformal prediction: a model that may say "don't know", and is wrong as rarely as stated.

Class by class (label-conditional, Vovk, Gammerman and Shafer, *Algorithmic Learning in a Random
World*, 2005, §4.5): of n calibration designs of a class, that neither trained nor chose the model,
the ⌈(n + 1) c⌉-th in order of their probabilities is the border beyond which the class is no longer
plausible. A fresh design of the same draw lies beyond the border of its own class with a chance of
at most 1 − c, whatever the model. Where both classes are plausible, or none, the answer is "don't
know".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from foldlab.errors import InputError
from foldlab.learning.features import as_labels, probability_of_folding
from foldlab.learning.scoring import CONFIDENCE, upper_bound


@dataclass(frozen=True)
class Borders:
    """Probabilities of folding at which an answer begins.

    ``not_up_to``: highest at which "does not fold" is plausible; ``folds_from``: lowest at which
    "folds" is. ``coverage``: least chance, for designs of either class, of not being told the
    other. ``labels``: what the calibration cost.
    """

    not_up_to: float
    folds_from: float
    coverage: float
    labels: int

    def answers(self, probability) -> pd.arrays.BooleanArray:
        """True, False, or NA for don't know, of probabilities of folding (n,)."""
        p = np.asarray(probability, dtype=float)
        folds, stays = p >= self.folds_from, p <= self.not_up_to
        return pd.arrays.BooleanArray(folds, folds == stays)


def labels_needed(coverage: float) -> int:
    """Fewest calibration designs of a class for this coverage: n with ⌈(n + 1) c⌉ ≤ n."""
    if not 0 < coverage < 1:
        raise InputError(f"coverage = {coverage!r}; expected between 0 and 1, such as 0.99")
    return math.ceil(round(coverage / (1 - coverage), 9))


def borders_of(probability, y, *, coverage: float) -> Borders:
    """Borders from calibration designs: probabilities of folding (n,) and labels ``y`` (n,).

    Raises :class:`InputError` for too few designs of a class (it says how many are needed).
    """
    y, p = as_labels(y), np.asarray(probability, dtype=float)
    if len(y) != len(p):
        raise InputError(f"{len(p)} probabilities and {len(y)} labels; expected one per design")
    check_enough(y, coverage=coverage)
    stays, folds = np.sort(p[~y]), np.sort(p[y])[::-1]
    return Borders(
        not_up_to=float(stays[_rank(len(stays), coverage) - 1]),
        folds_from=float(folds[_rank(len(folds), coverage) - 1]),
        coverage=coverage,
        labels=len(y),
    )


def check_enough(y, *, coverage: float) -> None:
    """That labels ``y`` (n,) hold enough designs of each class for this coverage.

    Raises :class:`InputError` where not, and says how many are needed.
    """
    y, needed = as_labels(y), labels_needed(coverage)
    fewest = int(min(y.sum(), (~y).sum()))
    if fewest < needed:
        total = math.ceil(needed * len(y) / max(fewest, 1))
        raise InputError(
            f"of one class there are {fewest} calibration designs; a coverage of {coverage:g} "
            f"needs at least {needed} of each (here about {total} labels in all): add labels, or "
            "ask for less"
        )


def _rank(n: int, coverage: float) -> int:
    return math.ceil(round((n + 1) * coverage, 9))


def measured(model, borders: Borders, X, y) -> dict[str, float | int | None]:
    """How the answers fare on designs that neither training nor calibration saw.

    Keys: ``n``; ``decided``, the fraction with an answer; ``covered``, the fraction that was not
    told the other class, of the designs that fold (``covered_folding``) and of those that don't
    (``covered_not_folding``) too; ``wrong`` answers and ``wrong_upper``, the one-sided
    Clopper–Pearson bound of their fraction.
    """
    y = as_labels(y)
    answers = borders.answers(probability_of_folding(model, X))
    wrong = (~answers.isna()) & (np.asarray(answers.to_numpy(dtype=bool, na_value=False)) != y)

    def kept(of):
        return float((~wrong[of]).mean()) if of.any() else None

    return {
        "n": len(y),
        "decided": float((~answers.isna()).mean()),
        "covered": float((~wrong).mean()),
        "covered_folding": kept(y),
        "covered_not_folding": kept(~y),
        "wrong": int(wrong.sum()),
        "wrong_upper": upper_bound(int(wrong.sum()), len(y), confidence=CONFIDENCE),
    }
