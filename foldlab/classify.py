"""Classifiers of foldability as scikit-learn estimators, and how they are scored.

A design goes in as named groups; the logs of log-scaled groups are taken inside, so that every
model sees the coordinates in which the designs were sampled. The positive class is "folds"
(True). A false positive promises a fold that does not happen (§4.7.4); its weight in training is
``false_positive_weight`` everywhere.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.stats import beta
from sklearn.base import BaseEstimator, ClassifierMixin, TransformerMixin
from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.pipeline import Pipeline
from sklearn.tree import DecisionTreeClassifier
from sklearn.utils.validation import check_is_fitted, validate_data

from foldlab.design import DesignSpace
from foldlab.errors import InputError

CONFIDENCE = 0.95
TIMED_ROWS = 20_000  # fewer rows would time the call, not the model


def groups_array(X, space: DesignSpace) -> np.ndarray:
    """Designs as floats, shape (n, number of groups), columns in the space's order.

    ``X`` is a frame with the groups among its columns or an array (n, number of groups) in the
    space's order. Bounds are not checked here: a classifier may be asked about any design whose
    groups are finite and, on a log scale, positive. Raises :class:`InputError` otherwise.
    """
    if not isinstance(X, pd.DataFrame):
        X = np.asarray(X)
        if X.ndim != 2 or X.shape[1] != len(space):
            raise InputError(
                f"designs came with shape {X.shape}; expected (n, {len(space)}) with columns "
                f"{', '.join(space.names)}, or a frame with these columns"
            )
        X = pd.DataFrame(X, columns=space.names)
    return space.validate(X, bounds=False).to_numpy()


def as_labels(y) -> np.ndarray:
    """Labels as a boolean array (n,), True = folds; from booleans, 0/1 or a nullable column.

    Raises :class:`InputError` for unknown (missing) labels and anything else but yes or no.
    """
    labels = pd.array(np.asarray(y, dtype=object).ravel())
    missing = np.asarray(pd.isna(labels))
    if missing.any():
        raise InputError(
            f"{int(missing.sum())} of {len(labels)} labels are unknown; "
            "leave out the designs whose label is unknown"
        )
    bad = [value for value in pd.unique(labels) if value not in (0, 1)]
    if bad:
        raise InputError(f"labels contain {bad[0]}; expected true or false for every design")
    return np.asarray(labels).astype(bool)


class GroupFeatures(TransformerMixin, BaseEstimator):
    """Named groups to features; logs are taken inside.

    With a ``space``, each log-scaled group becomes its log10 and the others pass; with ``pairs``
    the log10 of every pairwise product and ratio is added. With ``space=None`` plain numbers pass
    through. Shapes: (n, groups) → (n, features), nondimensional.
    """

    def __init__(self, space: DesignSpace | None = None, *, pairs: bool = False):
        self.space = space
        self.pairs = pairs

    def fit(self, X, y=None):
        if self.space is None:
            if self.pairs:
                raise InputError("pairs=True without a space; give the space of the groups")
            validate_data(self, X, dtype=np.float64)
            return self
        groups_array(X, self.space)
        if self.pairs and (unfit := [p.name for p in self.space if p.low <= 0]):
            raise InputError(
                f"{unfit[0]} may be 0 or below, and so has no log; use pairs=False here"
            )
        self.feature_names_in_ = np.array(self.space.names, dtype=object)
        self.n_features_in_ = len(self.space)
        return self

    def transform(self, X) -> np.ndarray:
        check_is_fitted(self, "n_features_in_")
        if self.space is None:
            return validate_data(self, X, dtype=np.float64, reset=False)
        groups = groups_array(X, self.space)
        columns = [
            np.log10(groups[:, k]) if p.scale == "log" else groups[:, k]
            for k, p in enumerate(self.space)
        ]
        if self.pairs:
            logs = np.log10(groups)
            for i, j in itertools.combinations(range(len(self.space)), 2):
                columns += [logs[:, i] + logs[:, j], logs[:, i] - logs[:, j]]
        return np.column_stack(columns)

    def get_feature_names_out(self, input_features=None) -> np.ndarray:
        """Names of the features, such as ``log10(E_ratio/h_ratio)``."""
        check_is_fitted(self, "n_features_in_")
        if self.space is None:
            given = getattr(self, "feature_names_in_", input_features)
            if given is None:
                given = [f"x{k}" for k in range(self.n_features_in_)]
            return np.asarray(given, dtype=object)
        names = [f"log10({p.name})" if p.scale == "log" else p.name for p in self.space]
        if self.pairs:
            for a, b in itertools.combinations(self.space.names, 2):
                names += [f"log10({a}*{b})", f"log10({a}/{b})"]
        return np.array(names, dtype=object)


def _class_weight(false_positive_weight: float) -> dict[bool, float] | None:
    if not (np.isfinite(false_positive_weight) and false_positive_weight > 0):
        raise InputError(
            f"false_positive_weight = {false_positive_weight}; give a finite number above 0 "
            "(1 = unbiased, above 1 = fewer false positives)"
        )
    weighted = false_positive_weight != 1
    return {False: float(false_positive_weight), True: 1.0} if weighted else None


def _pipeline(space, classifier) -> Pipeline:
    return Pipeline(
        [("groups", GroupFeatures(space, pairs=space is not None)), ("classifier", classifier)]
    )


def _tree(space, seed, false_positive_weight=1.0, **options):
    weight = _class_weight(false_positive_weight)
    # In a pure leaf there is nothing to weigh: a biased tree needs leaves that can be mixed.
    leaf = 1 if weight is None else 10
    defaults = {
        "criterion": "entropy",
        "ccp_alpha": 4e-4,
        "min_samples_leaf": leaf,
        "random_state": seed,
    }
    return _pipeline(space, DecisionTreeClassifier(class_weight=weight, **(defaults | options)))


def _forest(space, seed, false_positive_weight=1.0, **options):
    defaults = {"n_estimators": 200, "random_state": seed}
    weight = _class_weight(false_positive_weight)
    return _pipeline(space, RandomForestClassifier(class_weight=weight, **(defaults | options)))


def _boosted(space, seed, false_positive_weight=1.0, **options):
    # Without early stopping: it would hold back a tenth of the labels.
    defaults = {
        "max_iter": 300,
        "max_leaf_nodes": 8,
        "early_stopping": False,
        "random_state": seed,
    }
    weight = _class_weight(false_positive_weight)
    return _pipeline(
        space, HistGradientBoostingClassifier(class_weight=weight, **(defaults | options))
    )


def _distilled(space, seed, false_positive_weight=1.0, **options):
    return DistilledTree(
        space, random_state=seed, false_positive_weight=false_positive_weight, **options
    )


def _network(space, seed, **options):
    from foldlab.network import SmoothNetwork  # torch takes seconds to import

    return SmoothNetwork(space, random_state=seed, **options)


def _dissertation(space, seed, **options):
    from foldlab.network import DissertationNetwork

    return DissertationNetwork(space, random_state=seed, **options)


def _symbolic(space, seed, constraints=None, **options):
    from foldlab.symbolic import Constraints, SymbolicClassifier  # sympy and Operon are slow too

    limits = Constraints(seed=seed) if constraints is None else constraints
    fields = {k: options.pop(k) for k in list(options) if hasattr(limits, k)}
    return SymbolicClassifier(space, constraints=replace(limits, **fields), **options)


MODELS: dict[str, Callable] = {
    "tree": _tree,
    "distilled": _distilled,
    "forest": _forest,
    "boosted": _boosted,
    "network": _network,
    "dissertation": _dissertation,
    "symbolic": _symbolic,
}


def make_classifier(name: str, space: DesignSpace | None, *, seed: int = 0, **options):
    """An unfitted classifier by name (:data:`MODELS`), seeded.

    ``options`` go to the model; every model takes ``false_positive_weight`` (1 = unbiased) but
    ``symbolic``, whose ``fit`` takes the scalar target.
    Raises :class:`InputError` for an unknown name or option.
    """
    if name not in MODELS:
        raise InputError(f"no model {name!r}; there are: {', '.join(MODELS)}")
    try:
        model = MODELS[name](space, seed, **options)
    except TypeError as error:
        raise InputError(
            f"model {name!r} does not take these options ({', '.join(options)}): {error}"
        ) from None
    if isinstance(model, Pipeline):
        try:
            model[-1]._validate_params()  # else a bad value would come to light in fit only
        except ValueError as error:
            raise InputError(f"model {name!r}: {error}") from None
    return model


class DistilledTree(ClassifierMixin, BaseEstimator):
    """One decision tree that imitates a better classifier on designs without labels.

    A ``teacher`` (a name in :data:`MODELS`) learns the labels; the tree then learns the labels and
    the teacher's answers on ``n_designs`` further designs of the space. No further label is used,
    and the teacher is not kept. The bias against false positives acts in both.
    """

    def __init__(
        self,
        space: DesignSpace | None = None,
        *,
        teacher: str = "network",
        n_designs: int = 60_000,
        ccp_alpha: float = 5e-5,
        false_positive_weight: float = 1.0,
        random_state: int | None = 0,
    ):
        self.space = space
        self.teacher = teacher
        self.n_designs = n_designs
        self.ccp_alpha = ccp_alpha
        self.false_positive_weight = false_positive_weight
        self.random_state = random_state

    def fit(self, X, y):
        if self.space is None:
            raise InputError("the distilled tree needs a space, to draw designs from it")
        X, y = groups_array(X, self.space), as_labels(y)
        seed = 0 if self.random_state is None else self.random_state
        bias = {"seed": seed, "false_positive_weight": self.false_positive_weight}
        teacher = make_classifier(self.teacher, self.space, **bias).fit(X, y)
        more = self.space.sample(self.n_designs, seed=seed).to_numpy()
        answers = as_labels(teacher.predict(more))
        self.tree_ = make_classifier("tree", self.space, ccp_alpha=self.ccp_alpha, **bias)
        self.tree_.fit(np.vstack([X, more]), np.concatenate([y, answers]))
        self.classes_ = self.tree_.classes_
        self.n_features_in_ = len(self.space)
        self.feature_names_in_ = np.array(self.space.names, dtype=object)
        self.agreement_ = float(np.mean(self.tree_.predict(more) == answers))
        return self

    def predict_proba(self, X) -> np.ndarray:
        """Share of each class in the leaf, shape (n, 2)."""
        check_is_fitted(self, "tree_")
        return self.tree_.predict_proba(groups_array(X, self.space))

    def predict(self, X) -> np.ndarray:
        """Class of each design, shape (n,)."""
        return self.classes_[np.argmax(self.predict_proba(X), axis=1)]


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


def seconds_per_million(model, X) -> float:
    """Wall seconds for a million predictions, from one call on at least 20 000 rows."""
    rows = np.arange(max(len(X), TIMED_ROWS)) % len(X)
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
