"""Symbolic regression: formulas for a scalar target, and a classifier by threshold.

The target is a positive scalar such as κ l_s / g (Eq. 4.25), which spans decades. With
``log_target`` a formula A is judged by

    error = rms of log(A(x) / y),

a relative error, so that designs near the threshold 2π (Eq. 4.26) weigh as much as the largest
angles. A itself stays in plain units. With ``reciprocal`` the engine searches for 1/y (a sum of few
simple terms for a bimetal); the formulas returned are for y all the same, and the constraints hold
for them.

What an engine returns is simplified, its constants are refitted in double precision, and only then
checked against every constraint. :mod:`foldlab.learning.symbolic.formula` says how nodes and levels
are counted, :mod:`foldlab.learning.symbolic.engines` what can be constrained.
"""

from __future__ import annotations

import keyword
import math
import time
from typing import Literal

import numpy as np
import pandas as pd
from scipy.special import expit
from sklearn.base import BaseEstimator, ClassifierMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from foldlab.design import DesignSpace
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.rod import rod_of
from foldlab.labels.timoshenko import FULL_TURN
from foldlab.learning.symbolic import formula as fm
from foldlab.learning.symbolic.engines import ENGINES, Constraints
from foldlab.learning.symbolic.finishing import front_of, guard_points, refit, scale_of
from foldlab.learning.symbolic.formula import Formula, Tree
from foldlab.tables import as_frame

__all__ = ["Constraints", "SymbolicClassifier", "SymbolicRegressor"]

_SEARCH_FRACTION = 0.85  # of the seconds; the rest is for refitting constants
_DESIGNS = {"physics": 20_000, "rod": 4000}  # that take the place of the box's points


class SymbolicRegressor(RegressorMixin, BaseEstimator):
    """Closed-form regression by genetic programming, with the whole front kept.

    Parameters
    ----------
    space
        Names the inputs: designs are frames with its groups as columns (other columns ignored).
        A formula is then defined in the whole space, and not only where the training rows are.
        Without it, the columns of X (an array's are ``x0``, ``x1``, …).
    engine
        ``'operon'`` or ``'pysr'`` (needs Julia).
    constraints
        :class:`Constraints`; None is the default set.
    log_target
        Minimise relative errors, log(A/y); y must be positive. Otherwise plain squares.
    reciprocal
        Let the engine search for 1/y; needs ``/`` among the operators and y without zeros.

    Attributes
    ----------
    front_
        Frame, one row per formula for y that no other beats in both size and error: ``size``
        (nodes), ``depth`` (levels), ``error`` (rms on the training rows, of log(A/y) or of A − y),
        ``formula`` (:class:`foldlab.learning.symbolic.formula.Formula`).
    formula_
        The smallest one whose error is within 1 % of the least.
    seconds_
        Time of the fit.
    """

    def __init__(
        self,
        space: DesignSpace | None = None,
        engine: str = "operon",
        constraints: Constraints | None = None,
        log_target: bool = True,
        reciprocal: bool = True,
    ):
        self.space = space
        self.engine = engine
        self.constraints = constraints
        self.log_target = log_target
        self.reciprocal = reciprocal

    def fit(self, X, y, guards=None) -> SymbolicRegressor:
        """Search. X: (n, inputs) designs, raw values; y: (n,) scalar target, in its own units.

        ``guards`` (m, inputs): where a formula must be defined; without, in the box of X.

        Raises :class:`InputError` for an unknown engine, bad constraints or targets, and where no
        finite formula within the constraints was found.
        """
        start = time.monotonic()
        limits = Constraints() if self.constraints is None else self.constraints
        if not isinstance(limits, Constraints):
            raise InputError(f"constraints is a {type(limits).__name__}; give a Constraints object")
        if self.engine not in ENGINES:
            raise InputError(f"no engine {self.engine!r}; there are: {', '.join(ENGINES)}")
        X, y = validate_data(self, self._columns(X), y, dtype=np.float64, y_numeric=True)
        y = y.astype(float)
        self.inputs_ = self._names()
        if self.log_target and (y <= 0).any():
            raise InputError(
                f"the target is {y[y <= 0][0]:g} in row {int(np.argmax(y <= 0))}; log_target needs "
                "values above 0: change the target, or set log_target=False"
            )
        if self.reciprocal and ((y == 0).any() or "/" not in limits.operators):
            raise InputError(
                "reciprocal=True needs a target without zeros and '/' among the operators; "
                "set reciprocal=False"
            )
        end = start + limits.seconds
        scale = scale_of(y)
        wanted = scale / y if self.reciprocal else y / scale
        candidates = ENGINES[self.engine](
            X,
            wanted,
            self.inputs_,
            limits,
            self.log_target,
            start + _SEARCH_FRACTION * limits.seconds,
        )
        if guards is None:
            guards = guard_points(*self._box(X), limits.seed)
        guards = np.asarray(guards, dtype=float)
        rows = []
        for tree in candidates:
            if rows and time.monotonic() > end:
                break
            rows += self._finished(tree, X, y, guards, limits, scale)
        if not rows:
            raise InputError(
                f"no finite formula within the constraints after {limits.seconds:g} s and "
                f"{len(candidates)} candidates: allow more seconds, size or depth"
            )
        self.front_ = front_of(rows)
        rounding = 1e-12 * (1 if self.log_target else scale)
        near = self.front_["error"] <= 1.01 * self.front_["error"].min() + rounding
        self.formula_ = self.front_["formula"][near.idxmax()]
        self.seconds_ = time.monotonic() - start
        return self

    def predict(self, X) -> np.ndarray:
        """Target values, shape (n,), by the selected formula in double precision.

        Raises :class:`InputError` at a design where the formula is not defined.
        """
        check_is_fitted(self, "formula_")
        X = validate_data(self, self._columns(X), dtype=np.float64, reset=False)
        values = self.formula_(X)
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise InputError(
                f"the formula {self.formula_} is not defined in row {row}; "
                "stay inside the space and the box of the training designs, or train on more of it"
            )
        return values

    def _columns(self, X):
        X = as_frame(X)
        if self.space is None:
            return X
        if isinstance(X, pd.DataFrame):
            return self.space.validate(X, bounds=False)
        array = np.asarray(X)
        if array.ndim != 2 or array.shape[1] != len(self.space):
            raise InputError(
                f"designs of shape {array.shape}; expected {len(self.space)} columns in the order "
                f"{', '.join(self.space.names)}"
            )
        return self.space.validate(pd.DataFrame(array, columns=self.space.names), bounds=False)

    def _box(self, X) -> tuple[np.ndarray, np.ndarray]:
        low, high = X.min(axis=0), X.max(axis=0)
        if self.space is None:
            return low, high
        return (
            np.minimum(low, [p.low for p in self.space]),
            np.maximum(high, [p.high for p in self.space]),
        )

    def _names(self) -> tuple[str, ...]:
        names = [str(n) for n in getattr(self, "feature_names_in_", [])]
        usable = [n.isidentifier() and not keyword.iskeyword(n) for n in names]
        if names and all(usable) and not set(names) & set(fm.UNARY):
            return tuple(names)
        return tuple(f"x{k}" for k in range(self.n_features_in_))

    def _finished(self, tree: Tree, X, y, guards, limits: Constraints, scale: float) -> list[tuple]:
        """Rows of the front from one candidate for y/scale: simplified, refitted, checked."""
        if not np.isfinite(fm.constants(tree)).all():
            return []
        if self.reciprocal:
            tree = ("/", 1.0, tree)
        # An engine that fits log|A| leaves the sign open.
        values = Formula(tree, self.inputs_)(X)
        if self.log_target and (values < 0).sum() > (values > 0).sum():
            tree = ("*", -1.0, tree)
        # Simplification can introduce an operator that is not allowed (a minus for a negative
        # weight); the unsimplified tree is the second choice.
        for form in (fm.simplified(tree), tree):
            if not limits.allow(form):
                continue
            fitted, error = refit(form, X, y / scale, self.inputs_, self.log_target)
            if scale != 1:
                fitted, error = ("*", scale, fitted), error if self.log_target else scale * error
            shorter = fm.simplified(fitted)  # a weight may have become 0 or 1
            best = next(filter(limits.allow, (shorter, fitted)), None)
            if best is None:
                continue
            f = Formula(best, self.inputs_)
            values = np.concatenate([f(X), f(guards)])
            fine = np.isfinite(values).all() and (not self.log_target or (values > 0).all())
            if fine and np.isfinite(error):
                return [(f.size, f.depth, error, f)]
        return []


class SymbolicClassifier(ClassifierMixin, BaseEstimator):
    """Label ``y ≥ threshold`` by a formula for y.

    ``fit`` takes the scalar target, not the label: a formula learns nothing about the distance to
    the threshold from booleans. (That is why scikit-learn's generic checks, which fit on class
    names, do not apply.) The default threshold is 2π for κ l_s / g (Eq. 4.26). ``predict`` gives
    booleans, ``score`` compares with booleans.

    ``predict_proba``, columns in the order of ``classes_`` = [False, True], is logistic in the log
    margin: P(True) = expit(log(A/threshold)/s). s is the scale of a logistic distribution with the
    standard deviation of log(A/y) on the training rows, s = √3 σ/π, so the probability says how
    sure the formula may be given its own residuals; it assumes that these are alike everywhere.

    With ``margin`` the formula is for tanh(y/threshold − 1) instead, by plain squares: the target
    may have any sign, and what lies far from the threshold weighs no more. A > 0 folds, and A takes
    the place of the log margin.

    ``inputs``: "groups" of the space; "physics", the columns of
    :func:`foldlab.labels.beam.formulas` in their place; "rod", those of
    :func:`foldlab.labels.rod.rod_of` too.
    """

    def __init__(
        self,
        space: DesignSpace | None = None,
        engine: str = "operon",
        constraints: Constraints | None = None,
        reciprocal: bool = True,
        threshold: float = FULL_TURN,
        margin: bool = False,
        inputs: Literal["groups", "physics", "rod"] = "groups",
    ):
        self.space = space
        self.engine = engine
        self.constraints = constraints
        self.reciprocal = reciprocal
        self.threshold = threshold
        self.margin = margin
        self.inputs = inputs

    def fit(self, X, y) -> SymbolicClassifier:
        """X: (n, groups) designs; y: (n,) scalar target, in the threshold's units.

        It must be positive unless ``margin`` is set.
        """
        if not (np.isfinite(self.threshold) and self.threshold > 0):
            raise InputError(f"threshold = {self.threshold!r}; expected a finite number above 0")
        if np.asarray(y).dtype == bool or pd.api.types.is_bool_dtype(y):
            raise InputError(
                "y holds booleans; give the scalar target (such as κ l_s/g), which is compared "
                "with the threshold"
            )
        y = np.asarray(y, dtype=float)
        X = self._seen(X)
        self.regressor_ = self._regressor()
        guards = None
        if self.inputs != "groups":
            # Of the box around these columns most is no design.
            guards = self._seen(self.space.sample(_DESIGNS[self.inputs], seed=0))
        self.regressor_.fit(X, np.tanh(y / self.threshold - 1) if self.margin else y, guards)
        self.classes_ = np.array([False, True])
        self.n_features_in_ = self.regressor_.n_features_in_
        if self.space is not None:
            self.n_features_in_ = len(self.space)
        values = self.regressor_.predict(X)
        wrong = values - np.tanh(y / self.threshold - 1) if self.margin else np.log(values / y)
        self.scale_ = max(math.sqrt(3) / math.pi * float(np.std(wrong)), 1e-12)
        return self

    def _regressor(self) -> SymbolicRegressor:
        space = self.space if self.inputs == "groups" else None
        logs = not self.margin
        return SymbolicRegressor(
            space, self.engine, self.constraints, logs, self.reciprocal and logs
        )

    def _seen(self, X):
        """The table that the formula's inputs are columns of."""
        if self.inputs == "groups":
            return X
        X = as_frame(X)
        if not isinstance(X, pd.DataFrame):
            X = pd.DataFrame(np.asarray(X), columns=self.space.names)
        designs = self.space.validate(X, bounds=False)
        table = beam.formulas(designs)
        return table.join(rod_of(designs, self.space)) if self.inputs == "rod" else table

    def restore(self, front, chosen: int, scale: float) -> SymbolicClassifier:
        """Fill an unfitted classifier with formulas that were fitted before (a saved model).

        ``front``: rows (error, :class:`Formula`), ``chosen``: which of them answers, ``scale``: of
        the probabilities.
        """
        rows = [(f.size, f.depth, error, f) for error, f in front]
        regressor = self._regressor()
        regressor.front_ = pd.DataFrame(rows, columns=["size", "depth", "error", "formula"])
        regressor.formula_ = front[chosen][1]
        regressor.inputs_ = regressor.formula_.inputs
        regressor.n_features_in_ = len(regressor.inputs_)
        regressor.feature_names_in_ = np.array(regressor.inputs_, dtype=object)
        self.regressor_, self.scale_ = regressor, scale
        self.classes_ = np.array([False, True])
        self.n_features_in_ = len(self.space or regressor.inputs_)
        return self

    @property
    def size_(self) -> tuple[int, str]:
        """Size of the selected formula and its unit."""
        return self.formula_.size, "nodes"

    @property
    def front_(self) -> pd.DataFrame:
        """The regressor's front."""
        return self.regressor_.front_

    @property
    def formula_(self) -> Formula:
        """The selected formula for the scalar target."""
        return self.regressor_.formula_

    def decision_function(self, X) -> np.ndarray:
        """Log margin log(A/threshold), shape (n,); −inf where the formula is not positive.

        With ``margin`` the formula's own value.
        """
        check_is_fitted(self, "regressor_")
        values = self.regressor_.predict(self._seen(X))
        if self.margin:
            return values
        with np.errstate(divide="ignore"):
            return np.log(np.maximum(values, 0.0) / self.threshold)

    def predict(self, X) -> np.ndarray:
        """Booleans, shape (n,)."""
        return self.decision_function(X) >= 0

    def predict_proba(self, X) -> np.ndarray:
        """Shape (n, 2), columns in the order of ``classes_``; see the class for what it means."""
        yes = expit(self.decision_function(X) / self.scale_)
        return np.column_stack([1 - yes, yes])
