"""What classifiers see: design groups as arrays and logs, labels as classes, probabilities."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from foldlab.design import DesignSpace
from foldlab.errors import InputError
from foldlab.labels.label import _as_bool
from foldlab.tables import as_frame

WORDS = {"yes": True, "no": False, "true": True, "false": False, "1": True, "0": False}


def groups_array(X, space: DesignSpace) -> np.ndarray:
    """Designs as floats, shape (n, number of groups), columns in the space's order.

    ``X`` is a table with the groups among its columns (see :func:`foldlab.tables.as_frame`) or an
    array (n, number of groups) in the space's order. Bounds are not checked here: a classifier may
    be asked about any design whose groups are finite and, on a log scale, positive. Raises
    :class:`InputError` otherwise.
    """
    X = as_frame(X)
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
    """Labels as a boolean array (n,), True = folds; from booleans, 0/1, words or a nullable column.

    Words are yes and no, true and false, in any case. Raises :class:`InputError` for unknown
    (missing) labels and anything else.
    """
    labels = pd.array([_from_word(label) for label in np.asarray(y, dtype=object).ravel()])
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


def _from_word(label):
    return WORDS.get(label.strip().lower(), label) if isinstance(label, str) else label


def two_classes(y) -> tuple[np.ndarray, np.ndarray]:
    """``(classes, folds)``: the two classes in order, and whether each label (n,) is the second.

    Strings keep their names, of which the later in the alphabet stands for "folds"; all else is as
    in :func:`as_labels`. Raises :class:`InputError` for unknown labels and other numbers of
    classes.
    """
    labels = np.asarray(y, dtype=object).ravel()
    if not any(isinstance(label, str) for label in labels) or pd.isna(labels).any():
        return np.array([False, True]), as_labels(y)
    classes, which = np.unique(labels.astype(str), return_inverse=True)
    if len(classes) != 2:
        raise InputError(
            f"the labels hold {len(classes)} classes, {', '.join(classes[:5])}; expected two"
        )
    return classes, which == 1


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
            validate_data(self, as_frame(X), dtype=np.float64)
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
            return validate_data(self, as_frame(X), dtype=np.float64, reset=False)
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


def probability_of_folding(classifier, designs: pd.DataFrame) -> np.ndarray:
    """P(foldable) of each design, shape (n,), from a classifier with ``predict_proba``.

    The classes may be booleans or 0 and 1; a classifier that knows its ``feature_names_in_`` is
    given those columns. Raises :class:`InputError` for other classes, absent columns, or
    probabilities that are not numbers.
    """
    if not hasattr(classifier, "predict_proba"):
        raise InputError(
            f"{type(classifier).__name__} has no predict_proba; give a classifier that has"
        )
    classes = [_as_bool(c) for c in getattr(classifier, "classes_", (False, True))]
    designs = _columns_for(classifier, designs)
    table = np.asarray(classifier.predict_proba(designs), dtype=float)
    if table.shape != (len(designs), len(classes)):
        raise InputError(
            f"predict_proba gave shape {table.shape}; expected {(len(designs), len(classes))}: "
            "one column per class"
        )
    if not np.isfinite(table).all():
        raise InputError(
            f"predict_proba gave {int((~np.isfinite(table).all(axis=1)).sum())} rows that are not "
            f"numbers, of {len(table)}; was the classifier trained on a table with gaps?"
        )
    return table[:, classes.index(True)] if True in classes else np.zeros(len(designs))


def _columns_for(classifier, designs: pd.DataFrame) -> pd.DataFrame:
    names = getattr(classifier, "feature_names_in_", None)
    if names is None:
        return designs
    missing = [name for name in names if name not in designs.columns]
    if missing:
        raise InputError(
            f"the classifier was trained on {', '.join(map(str, missing))} too, the designs have "
            f"{', '.join(map(str, designs.columns))}: use the space it was trained in"
        )
    return designs[list(names)]
