"""Classifiers of foldability, and a regressor of the fold angle, as scikit-learn estimators.

A design goes in as named groups; the logs of log-scaled groups are taken inside, so that every
model sees the coordinates in which the designs were sampled. The positive class is "folds"
(True). A false positive promises a fold that does not happen (§4.7.4); its weight in training is
``false_positive_weight`` everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from numbers import Real

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, ClassifierMixin, RegressorMixin
from sklearn.ensemble import (
    HistGradientBoostingClassifier,
    HistGradientBoostingRegressor,
    RandomForestClassifier,
)
from sklearn.ensemble._hist_gradient_boosting.predictor import TreePredictor
from sklearn.pipeline import Pipeline
from sklearn.tree import DecisionTreeClassifier
from sklearn.tree._tree import Tree
from sklearn.utils.validation import check_is_fitted

from foldlab.design import DesignSpace
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.foldability import Thresholds
from foldlab.labels.rod import rod_of
from foldlab.learning.features import as_labels, groups_array, two_classes
from foldlab.learning.physics import Inputs, check_inputs, default_inputs, features


def _class_weight(false_positive_weight: float) -> dict[bool, float] | None:
    number = isinstance(false_positive_weight, Real)
    if not (number and np.isfinite(false_positive_weight) and false_positive_weight > 0):
        raise InputError(
            f"false_positive_weight = {false_positive_weight!r}; give a finite number above 0 "
            "(1 = unbiased, above 1 = fewer false positives)"
        )
    weighted = false_positive_weight != 1
    return {False: float(false_positive_weight), True: 1.0} if weighted else None


def _pipeline(space, inputs, classifier) -> Pipeline:
    groups = features(space, inputs, pairs=space is not None)
    return Pipeline([("groups", groups), ("classifier", classifier)])


def _tree(space, seed, inputs, false_positive_weight=1.0, **options):
    weight = _class_weight(false_positive_weight)
    # In a pure leaf there is nothing to weigh: a biased tree needs leaves that can be mixed.
    leaf = 1 if weight is None else 10
    defaults = {
        "criterion": "entropy",
        "ccp_alpha": 4e-4,
        "min_samples_leaf": leaf,
        "random_state": seed,
    }
    if inputs != "groups":
        # One of the columns all but decides; small leaves would learn single labels beside it.
        defaults |= {"ccp_alpha": 1e-3, "min_samples_leaf": 20}
    tree = DecisionTreeClassifier(class_weight=weight, **(defaults | options))
    return _pipeline(space, inputs, tree)


def _forest(space, seed, inputs, false_positive_weight=1.0, **options):
    defaults = {"n_estimators": 200, "random_state": seed}
    weight = _class_weight(false_positive_weight)
    return _pipeline(
        space, inputs, RandomForestClassifier(class_weight=weight, **(defaults | options))
    )


def _boosted(space, seed, inputs, false_positive_weight=1.0, **options):
    # Without early stopping: it would hold back a tenth of the labels.
    defaults = {
        "max_iter": 300,
        "max_leaf_nodes": 8,
        "early_stopping": False,
        "random_state": seed,
    }
    if inputs != "groups":
        # As accurate as with the default rate, with a third of its calibration error. In five folds
        # of gravity-5k none of these gained more than noise (0.1 %): LightGBM, monotone
        # constraints, weights by the labels' stated errors, Platt's and isotonic calibration.
        defaults |= {"learning_rate": 0.03, "max_features": 0.5}
    weight = _class_weight(false_positive_weight)
    boosted = HistGradientBoostingClassifier(class_weight=weight, **(defaults | options))
    return _pipeline(space, inputs, boosted)


def _distilled(space, seed, inputs, **options):
    return DistilledTree(space, random_state=seed, inputs=inputs, **options)


def _network(space, seed, inputs, **options):
    from foldlab.learning.network import SmoothNetwork  # torch takes seconds to import

    if inputs != "groups":
        # Columns that all but follow from each other need more to hold their weights.
        options = {"penalty": 1e-3} | options
    return SmoothNetwork(space, random_state=seed, inputs=inputs, **options)


def _dissertation(space, seed, inputs, **options):
    from foldlab.learning.network import DissertationNetwork

    return DissertationNetwork(space, random_state=seed, inputs=inputs, **options)


def _symbolic(space, seed, inputs, constraints=None, **options):
    from foldlab.learning.symbolic.engines import Constraints
    from foldlab.learning.symbolic.estimators import (
        SymbolicClassifier,  # sympy and Operon are slow too
    )

    limits = Constraints(seed=seed) if constraints is None else constraints
    if not isinstance(limits, Constraints):
        raise InputError(f"constraints = {limits!r}; give its fields, such as seconds=10")
    given = {f.name: options.pop(f.name) for f in fields(limits) if f.name in options}
    constraints = replace(limits, **given)
    return SymbolicClassifier(space, constraints=constraints, inputs=inputs, **options)


MODELS: dict[str, Callable] = {
    "tree": _tree,
    "distilled": _distilled,
    "forest": _forest,
    "boosted": _boosted,
    "network": _network,
    "dissertation": _dissertation,
    "symbolic": _symbolic,
}


def make_classifier(
    name: str, space: DesignSpace | None, *, seed: int = 0, inputs: Inputs | None = None, **options
):
    """An unfitted classifier by name (:data:`MODELS`), seeded.

    ``inputs``: what it sees of a design, see :func:`foldlab.learning.physics.features`.
    ``options`` go to the model; every model takes ``false_positive_weight`` (1 = unbiased) but
    ``symbolic``, whose ``fit`` takes the scalar target.
    Raises :class:`InputError` for an unknown name or option.
    """
    if name not in MODELS:
        raise InputError(f"no model {name!r}; there are: {', '.join(MODELS)}")
    inputs = default_inputs(space, inputs)
    check_inputs(inputs, space)
    known = _options(name, space) if options else ()
    for option in options:
        if option not in known:
            raise InputError(
                f"model {name!r} has no setting {option!r}; it has: {', '.join(known)}"
            )
    model = MODELS[name](space, seed, inputs, **options)
    if isinstance(model, Pipeline):
        try:
            model[-1]._validate_params()  # else a bad value would come to light in fit only
        except ValueError as error:
            raise InputError(f"model {name!r}: {error}") from None
    return model


def _options(name: str, space: DesignSpace | None) -> list[str]:
    """Names of what :func:`make_classifier` passes on to a model."""
    model = MODELS[name](space, 0, "groups")
    names = {*(model[-1] if isinstance(model, Pipeline) else model).get_params(deep=False)}
    if name == "symbolic":
        names |= {field.name for field in fields(model.constraints)}
    else:
        names |= {"false_positive_weight"}
    return sorted((names | {"inputs"}) - {"space", "seed", "random_state", "class_weight"})


class DistilledTree(ClassifierMixin, BaseEstimator):
    """One decision tree that imitates a better classifier on designs without labels.

    A ``teacher`` (a name in :data:`MODELS`) learns the labels; the tree then learns the labels and
    the teacher's answers on ``n_designs`` further designs of the space. No further label is used,
    and the teacher is not kept. The bias against false positives acts in both. Labels are as
    :func:`foldlab.learning.features.two_classes` takes them.
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
        inputs: Inputs = "groups",
    ):
        self.space = space
        self.teacher = teacher
        self.n_designs = n_designs
        self.ccp_alpha = ccp_alpha
        self.false_positive_weight = false_positive_weight
        self.random_state = random_state
        self.inputs = inputs

    def fit(self, X, y):
        if self.space is None:
            raise InputError("the distilled tree needs a space, to draw designs from it")
        X, (self.classes_, y) = groups_array(X, self.space), two_classes(y)
        seed = 0 if self.random_state is None else self.random_state
        bias = {
            "seed": seed,
            "inputs": self.inputs,
            "false_positive_weight": self.false_positive_weight,
        }
        teacher = make_classifier(self.teacher, self.space, **bias).fit(X, y)
        more = self.space.sample(self.n_designs, seed=seed).to_numpy()
        answers = as_labels(teacher.predict(more))
        self.tree_ = make_classifier("tree", self.space, ccp_alpha=self.ccp_alpha, **bias)
        self.tree_.fit(np.vstack([X, more]), np.concatenate([y, answers]))
        self.n_features_in_ = len(self.space)
        self.feature_names_in_ = np.array(self.space.names, dtype=object)
        self.agreement_ = float(np.mean(self.tree_.predict(more) == answers))
        return self

    def predict_proba(self, X) -> np.ndarray:
        """Fraction of each class in the leaf, shape (n, 2)."""
        check_is_fitted(self, "tree_")
        return self.tree_.predict_proba(groups_array(X, self.space))

    def predict(self, X) -> np.ndarray:
        """Class of each design, shape (n,)."""
        return self.classes_[np.argmax(self.predict_proba(X), axis=1)]


class AngleRegressor(RegressorMixin, BaseEstimator):
    """Net turning m1 of designs (n, groups) in rad, signed, shape (n,), by boosted trees.

    What they learn is what a first answer m₀ has wrong: asinh(m1/α) − asinh(m₀/α), with α = π|g|,
    what "folds" asks for. That is the ratio where the sheet turns far, and the difference where it
    hardly does. m₀ is the rod's with ``inputs`` "rod"; with "physics" that of beams
    (:func:`foldlab.labels.beam.formulas`, ``net``), not below 0, for panels lie on the ground, nor
    above a full turn, at which a path is closed; with "groups" none. ``inputs=None`` is as in
    :func:`foldlab.learning.physics.features`. The loss is the absolute error: labels at which a
    path jumps are outliers.
    """

    def __init__(
        self,
        space: DesignSpace,
        *,
        inputs: Inputs | None = None,
        max_iter: int = 400,
        max_leaf_nodes: int = 16,
        random_state: int | None = 0,
    ):
        self.space = space
        self.inputs = inputs
        self.max_iter = max_iter
        self.max_leaf_nodes = max_leaf_nodes
        self.random_state = random_state

    def fit(self, X, y, sample_weight=None) -> AngleRegressor:
        """``y`` (n,): net turnings in rad; ``sample_weight`` (n,).

        Raises :class:`InputError` where a turning is no number, and for a space without a hinge.
        """
        y = np.asarray(y, dtype=float)
        if not np.isfinite(y).all():
            raise InputError(
                f"{int((~np.isfinite(y)).sum())} of {len(y)} fold angles are no numbers; leave out "
                "the designs without"
            )
        if "contraction" not in self.space.names:
            raise InputError(
                f"designs of the {self.space.name} space have no contraction and so no fold angle; "
                "label in the full space"
            )
        inputs = default_inputs(self.space, self.inputs)
        self.features_ = features(self.space, inputs, pairs=True).fit(X)
        first, need = self._first(X)
        self.regressor_ = HistGradientBoostingRegressor(
            loss="absolute_error",
            max_iter=self.max_iter,
            max_leaf_nodes=self.max_leaf_nodes,
            early_stopping=False,
            random_state=self.random_state,
        )
        try:
            self.regressor_._validate_params()
        except ValueError as error:
            raise InputError(f"model 'angle': {error}") from None
        target = np.arcsinh(y / need) - np.arcsinh(first)
        self.regressor_.fit(self.features_.transform(X), target, sample_weight)
        self.n_features_in_ = len(self.space)
        self.feature_names_in_ = np.array(self.space.names, dtype=object)
        return self

    def predict(self, X) -> np.ndarray:
        check_is_fitted(self, "regressor_")
        first, need = self._first(X)
        learnt = self.regressor_.predict(self.features_.transform(X))
        return np.sinh(learnt + np.arcsinh(first)) * need

    @property
    def size_(self) -> tuple[int, str]:
        """Nodes of all trees."""
        return sum(len(p.nodes) for stage in self.regressor_._predictors for p in stage), "nodes"

    def _first(self, X) -> tuple[np.ndarray, np.ndarray]:
        """m₀/α and α."""
        designs = pd.DataFrame(groups_array(X, self.space), columns=self.space.names)
        thresholds = Thresholds()
        need = thresholds.angle(designs["contraction"].to_numpy())
        match default_inputs(self.space, self.inputs):
            case "rod":
                return rod_of(designs, self.space)["rod"].to_numpy(), need
            case "physics":
                net = beam.formulas(designs)["net"].to_numpy()
                return np.clip(net, 0.0, thresholds.full_turn / need), need
        return np.zeros(len(designs)), need


def check_trees(thing, columns: int = 0) -> None:
    """Raises :class:`InputError` for a tree, anywhere in a fitted model, that leads out of itself.

    scikit-learn follows the numbers of nodes and columns unchecked, outside of its own memory.
    ``columns``: what the model around a tree was fitted on.
    """
    if isinstance(thing, Tree):
        # The arrays are as long as the capacity.
        sound = 0 < thing.node_count <= thing.capacity and thing.n_features == columns
        nodes = thing.__getstate__()["nodes"] if sound else None
        if not (sound and _leads_on(nodes["left_child"], nodes["right_child"], nodes["feature"],
                                    nodes["left_child"] == -1, columns)):  # fmt: skip
            raise InputError("a tree of the model is damaged")
    elif isinstance(thing, TreePredictor):
        nodes = thing.nodes
        if (
            not len(nodes)
            or nodes["is_categorical"].any()
            or not _leads_on(
                nodes["left"], nodes["right"], nodes["feature_idx"], nodes["is_leaf"] == 1, columns
            )
        ):
            raise InputError("a tree of the model is damaged")
    elif isinstance(thing, dict):
        check_trees(list(thing.values()), columns)
    elif isinstance(thing, list | tuple) or (
        isinstance(thing, np.ndarray) and thing.dtype == object
    ):
        for part in thing:
            check_trees(part, columns)
    elif isinstance(thing, BaseEstimator):
        inside = vars(thing)
        columns = inside.get("n_features_in_", 0)
        grown = inside.get("estimators_", ())
        if any(getattr(tree, "n_features_in_", 0) != columns for tree in grown):
            raise InputError("the trees of the model were not fitted on the same columns")
        check_trees(inside, columns)


def _leads_on(left, right, feature, leaf, columns: int) -> bool:
    """Whether every inner node leads to two later ones by a column that there is."""
    own, n = np.arange(len(left)), len(left)
    left, right, feature = (np.asarray(a).astype(np.int64) for a in (left, right, feature))
    good = (own < left) & (left < n) & (own < right) & (right < n)
    good &= (feature >= 0) & (feature < columns)
    return bool((good | leaf).all())
