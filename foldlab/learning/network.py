"""Neural classifiers of foldability as scikit-learn estimators.

Both minimise the binary cross-entropy with a weight w on false positives (§4.7.4),

    L = − Σ [t log p + w (1 − t) log(1 − p)] / Σ [t + w (1 − t)],

with t = 1 for designs that fold. :class:`DissertationNetwork` is §4.7.3; :class:`SmoothNetwork` is
a small ensemble of smooth networks, trained to convergence on all labels at once.
Input: groups (n, d), logs inside where a space is given, with the columns of
:class:`foldlab.learning.physics.PhysicsFeatures` where ``inputs`` says so.
Output: probabilities (n, 2).
The two differ in little but their training, and stay beside what they have in common.
"""

from __future__ import annotations

import itertools
import warnings
from contextlib import contextmanager
from numbers import Integral, Real

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import expit
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_random_state
from sklearn.utils.multiclass import check_classification_targets, type_of_target
from sklearn.utils.validation import (
    _check_sample_weight,
    check_array,
    check_is_fitted,
    column_or_1d,
    validate_data,
)

from foldlab.design import DesignSpace
from foldlab.errors import InputError
from foldlab.learning.features import as_labels, groups_array
from foldlab.learning.physics import Inputs, features
from foldlab.packaged import needed_for
from foldlab.tables import as_frame

with needed_for("a network"):
    import torch
    from torch import nn

CHUNK = 50_000  # designs per forward pass; bounds the memory


@contextmanager
def _one_thread():
    """One torch thread and a private random state; both are restored afterwards.

    These networks are too small to gain from threads, and one thread sums in one order.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        torch.set_num_threads(threads)


class GroupsToLogit(nn.Module):
    """Raw groups (n, d) to the log-odds of folding (n,), float64.

    The logs, the standardisation and the mean over the ensemble's members are inside, so that the
    exported program needs nothing but the groups.
    """

    def __init__(self, members: list[nn.Module], logs: list[bool]):
        super().__init__()
        self.members = nn.ModuleList(members)
        self.register_buffer("logs", torch.tensor(logs))
        self.register_buffer("centre", torch.zeros(len(logs), dtype=torch.float64))
        self.register_buffer("scale", torch.ones(len(logs), dtype=torch.float64))

    def coordinates(self, groups: torch.Tensor) -> torch.Tensor:
        # The inner choice keeps log10 away from groups on a linear scale, which may be negative.
        logs = torch.log10(torch.where(self.logs, groups, 1.0))
        return torch.where(self.logs, logs, groups)

    def standardise(self, coordinates: torch.Tensor) -> torch.Tensor:
        return ((coordinates - self.centre) / self.scale).to(next(self.members.parameters()).dtype)

    def forward(self, groups: torch.Tensor) -> torch.Tensor:
        inputs = self.standardise(self.coordinates(groups))
        logits = torch.stack([member(inputs)[:, 0] for member in self.members])
        return logits.mean(0).to(torch.float64)


class NetworkClassifier(ClassifierMixin, BaseEstimator):
    """What the networks share: reading designs, the biased loss, continued training, answers.

    Fitted attributes: ``classes_``, ``module_`` (:class:`GroupsToLogit`), ``loss_curve_`` (one
    value per epoch), ``n_epochs_``, ``n_labels_`` (of the latest training), ``size_``.
    """

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.classifier_tags.multi_class = False
        return tags

    def fit(self, X, y, sample_weight=None):
        """Train from scratch on designs ``X`` (n, d) and binary labels ``y`` (n,).

        ``sample_weight`` (n,), not negative: a design of weight 2 counts as two alike.
        Raises :class:`InputError` for bad settings, designs or labels; warns with
        ``ConvergenceWarning`` where training ended before it converged.
        """
        self._check_settings()
        if y is None:
            raise InputError("fit requires y to be passed, but the target y is None")
        groups, y = self._read(X, y, reset=True)
        groups, y, weight = _weighed(groups, y, sample_weight)
        check_classification_targets(y)
        if (kind := type_of_target(y)) != "binary":
            raise InputError(
                f"Only binary classification is supported. The type of the target is {kind}"
            )
        self.classes_ = np.unique(y)
        if len(self.classes_) != 2:
            raise InputError(
                f"the labels hold one class only, {self.classes_[0]}; "
                "a classifier needs designs of both: add labels"
            )
        seed = check_random_state(self.random_state).randint(2**31)
        with _one_thread():
            torch.manual_seed(seed)
            self.module_ = self.build(groups.shape[1])
            coordinates = self.module_.coordinates(torch.from_numpy(groups))
            counts = torch.from_numpy(weight / weight.mean())[:, None]
            self.module_.centre.copy_((counts * coordinates).mean(0))
            spread = (counts * (coordinates - self.module_.centre) ** 2).mean(0).sqrt()
            self.module_.scale.copy_(torch.where(spread > 0, spread, 1.0))
            self.rng_state_ = torch.get_rng_state()
        self.optimizer_ = None
        self.loss_curve_ = []
        return self._train(groups, y, weight, self.epochs)

    def continue_fit(self, X, y, epochs: int | None = None, sample_weight=None):
        """Train the fitted network for ``epochs`` more on ``X``, ``y`` (for Algorithm 5).

        Weights, optimiser state, random state and input scaling carry on; ``X``, ``y`` replace the
        earlier labels, so give old and new together. One class alone is allowed here.
        """
        check_is_fitted(self, "module_")
        self._check_settings()
        groups, y = self._read(X, y, reset=False)
        groups, y, weight = _weighed(groups, y, sample_weight)
        unknown = np.setdiff1d(np.unique(y), self.classes_)
        if len(unknown):
            raise InputError(
                f"class {unknown[0]} is new; the network knows {self.classes_.tolist()}: "
                "give labels of these, or fit again"
            )
        epochs = self.epochs if epochs is None else epochs
        if not (isinstance(epochs, Integral) and epochs > 0):
            raise InputError(f"epochs = {epochs!r}; give a whole number above 0")
        return self._train(groups, y, weight, epochs)

    def decision_function(self, X) -> np.ndarray:
        """Log-odds of ``classes_[1]``, shape (n,)."""
        groups = self.seen(X)
        self.module_.eval()
        with _one_thread(), torch.no_grad():
            parts = [self.module_(part) for part in torch.from_numpy(groups).split(CHUNK)]
            return torch.cat(parts).numpy()

    def predict_proba(self, X) -> np.ndarray:
        """Probability of each class in the order of ``classes_``, shape (n, 2)."""
        z = self.decision_function(X)
        return np.column_stack([expit(-z), expit(z)])

    def predict(self, X) -> np.ndarray:
        """Class of each design, shape (n,)."""
        z = self.decision_function(X)
        return self.classes_[(z > 0).astype(int)]

    def seen(self, X) -> np.ndarray:
        """What ``module_`` is given of designs: groups, or the columns that ``inputs`` adds."""
        check_is_fitted(self, "module_")
        return self._read(X, None, reset=False)

    @property
    def size_(self) -> tuple[int, str]:
        return sum(p.numel() for p in self.module_.parameters()), "weights"

    def _read(self, X, y, *, reset: bool):
        if isinstance(getattr(y, "dtype", None), pd.BooleanDtype):
            y = as_labels(y)
        if self.space is None:
            X = as_frame(X)
            # Copies: torch cannot wrap read-only memory.
            if y is None:
                return validate_data(self, X, dtype=np.float64, reset=reset).copy()
            groups, y = validate_data(self, X, y, dtype=np.float64, reset=reset)
            return groups.copy(), y
        groups = np.array(groups_array(X, self.space), order="C")
        if reset:
            self.feature_names_in_ = np.array(self.space.names, dtype=object)
            self.n_features_in_ = len(self.space)
        if self.inputs != "groups":
            groups = features(self.space, self.inputs).fit(groups).transform(groups)
        if y is None:
            return groups
        y = column_or_1d(check_array(y, ensure_2d=False, dtype=None), warn=True)
        if len(y) != len(groups):
            raise InputError(f"{len(groups)} designs and {len(y)} labels; expected equal numbers")
        return groups, y

    def _logs(self, n_features: int) -> list[bool]:
        if self.space is None or self.inputs != "groups":
            return [False] * n_features
        return [p.scale == "log" for p in self.space]

    def _check_settings(self):
        for name in self._whole + self._positive:
            value, whole = getattr(self, name), name in self._whole
            if not (isinstance(value, Integral if whole else Real) and 0 < value < np.inf):
                what = "a whole" if whole else "a finite"
                raise InputError(f"{name} = {value!r}; give {what} number above 0")

    def _train(self, groups, y, sample_weight, epochs):
        target = torch.from_numpy((y == self.classes_[1]).astype(np.float64))
        weight = torch.where(target > 0, 1.0, float(self.false_positive_weight))
        weight = weight * torch.from_numpy(sample_weight)
        with _one_thread():
            torch.set_rng_state(self.rng_state_)
            self.module_.train()
            inputs = self.module_.coordinates(torch.from_numpy(groups))
            inputs = self.module_.standardise(inputs)
            losses = self._optimise(
                inputs, target.to(inputs.dtype), (weight / weight.mean()).to(inputs.dtype), epochs
            )
            self.module_.eval()
            self.rng_state_ = torch.get_rng_state()
        if not np.isfinite(losses).all():
            raise InputError(
                f"the loss left the finite numbers in epoch {int(np.argmin(np.isfinite(losses)))};"
                " lower the learning rate or the false-positive weight"
            )
        self.loss_curve_ = [*self.loss_curve_, *losses]
        self.n_epochs_ = len(self.loss_curve_)
        self.n_labels_ = len(y)
        return self


def _weighed(groups, y, sample_weight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Designs, labels and weights without those of no weight; checked."""
    if sample_weight is None:
        return groups, y, np.ones(len(y))
    weight = _check_sample_weight(sample_weight, groups, dtype=np.float64, ensure_non_negative=True)
    kept = weight > 0
    return groups[kept], y[kept], weight[kept]


def _cross_entropy(logits, target, weight):
    loss = nn.functional.binary_cross_entropy_with_logits(logits, target, reduction="none")
    return (weight * loss).mean()


class DissertationNetwork(NetworkClassifier):
    """The dissertation's network (§4.7.3, Fig. 4.27).

    d – 128 ReLU – dropout – 128 PReLU – 1 sigmoid; Adam; cross-entropy. The text leaves batch size
    and epochs of the comparison open: both are choices here. Training is a fixed budget and claims
    no convergence; it warns where the loss stays above that of the constant answer.
    """

    _whole = ("hidden", "epochs", "batch_size")
    _positive = ("learning_rate", "false_positive_weight")

    def __init__(
        self,
        space: DesignSpace | None = None,
        *,
        hidden: int = 128,
        dropout: float = 0.2,
        epochs: int = 100,
        batch_size: int = 64,
        learning_rate: float = 1e-3,
        false_positive_weight: float = 1.0,
        random_state: int | None = 0,
        inputs: Inputs = "groups",
    ):
        self.space = space
        self.hidden = hidden
        self.dropout = dropout
        self.epochs = epochs
        self.batch_size = batch_size
        self.learning_rate = learning_rate
        self.false_positive_weight = false_positive_weight
        self.random_state = random_state
        self.inputs = inputs

    def build(self, n_features: int) -> GroupsToLogit:
        """The untrained module for ``n_features`` groups."""
        n = self.hidden
        first = [nn.Linear(n_features, n), nn.ReLU(), nn.Dropout(self.dropout)]
        second = [nn.Linear(n, n), nn.PReLU(), nn.Linear(n, 1)]
        return GroupsToLogit([nn.Sequential(*first, *second)], self._logs(n_features))

    def _check_settings(self):
        super()._check_settings()
        if not (isinstance(self.dropout, Real) and 0 <= self.dropout < 1):
            raise InputError(f"dropout = {self.dropout}; give a fraction from 0 to below 1")

    def _optimise(self, inputs, target, weight, epochs):
        member = self.module_.members[0]
        if self.optimizer_ is None:
            self.optimizer_ = torch.optim.Adam(member.parameters(), lr=self.learning_rate)
        losses = []
        for _ in range(epochs):
            total = 0.0
            for batch in torch.randperm(len(inputs)).split(self.batch_size):
                self.optimizer_.zero_grad()
                loss = _cross_entropy(member(inputs[batch])[:, 0], target[batch], weight[batch])
                loss.backward()
                self.optimizer_.step()
                total += loss.item() * len(batch)
            losses.append(total / len(inputs))
        positive = float((weight * target).mean())  # weights have mean 1
        constant = np.inf
        if positive % 1:
            constant = -positive * np.log(positive) - (1 - positive) * np.log1p(-positive)
        if losses[-1] >= constant:
            warnings.warn(
                f"the loss after {epochs} epochs, {losses[-1]:.3g}, is no better than a constant "
                f"answer's, {constant:.3g}; train longer or lower the learning rate",
                ConvergenceWarning,
                stacklevel=4,
            )
        return losses


class SmoothNetwork(NetworkClassifier):
    """A few small smooth networks, each trained to convergence; their log-odds are averaged.

    d – softplus layers – 1, float64. The boundary of Eq. 4.26 is smooth in the logs of the groups,
    and noise-free: smooth units, a small weight penalty (``penalty`` Σ w², weights only) and a
    quasi-Newton method on all labels find it where stochastic steps hover around it. An epoch is
    one L-BFGS iteration; a member is converged once an iteration lowers its loss by less than
    ``rtol``, of a loss above 1 by that fraction, otherwise ``ConvergenceWarning`` says so.
    """

    _whole = ("members", "epochs")
    _positive = ("rtol", "penalty", "false_positive_weight")

    def __init__(
        self,
        space: DesignSpace | None = None,
        *,
        hidden: tuple[int, ...] = (16, 16),
        members: int = 4,
        penalty: float = 3e-5,
        epochs: int = 3000,
        rtol: float = 1e-6,
        false_positive_weight: float = 1.0,
        random_state: int | None = 0,
        inputs: Inputs = "groups",
    ):
        self.space = space
        self.hidden = hidden
        self.members = members
        self.penalty = penalty
        self.epochs = epochs
        self.rtol = rtol
        self.false_positive_weight = false_positive_weight
        self.random_state = random_state
        self.inputs = inputs

    def build(self, n_features: int) -> GroupsToLogit:
        """The untrained module for ``n_features`` groups."""
        members = [self._member(n_features) for _ in range(self.members)]
        return GroupsToLogit(members, self._logs(n_features))

    def _check_settings(self):
        super()._check_settings()
        if not (
            isinstance(self.hidden, list | tuple)
            and self.hidden
            and all(isinstance(n, Integral) and n > 0 for n in self.hidden)
        ):
            raise InputError(f"hidden = {self.hidden!r}; give layer widths such as (16, 16)")

    def _member(self, n_features):
        sizes, layers = [n_features, *self.hidden, 1], []
        for fan_in, fan_out in itertools.pairwise(sizes):
            layer = nn.Linear(fan_in, fan_out, dtype=torch.float64)
            nn.init.normal_(layer.weight, std=fan_in**-0.5)
            nn.init.normal_(layer.bias, std=0.5)
            layers += [layer, nn.Softplus()]
        return nn.Sequential(*layers[:-1])

    def _optimise(self, inputs, target, weight, epochs):
        curves, self.converged_ = [], True
        for member in self.module_.members:
            curve, converged = self._optimise_member(member, inputs, target, weight, epochs)
            curves.append(curve)
            self.converged_ &= converged
        if not self.converged_:
            warnings.warn(
                f"not converged after {epochs} epochs (rtol {self.rtol:g}); the network is usable "
                "as it stands; for more, raise epochs or call continue_fit",
                ConvergenceWarning,
                stacklevel=4,
            )
        length = max(map(len, curves))
        return list(np.mean([np.pad(c, (0, length - len(c)), mode="edge") for c in curves], axis=0))

    def _optimise_member(self, member, inputs, target, weight, epochs):
        parameters = list(member.parameters())
        curve = []

        def loss_and_gradient(vector):
            nn.utils.vector_to_parameters(torch.from_numpy(vector), parameters)
            size = sum((p**2).sum() for p in parameters if p.ndim > 1)
            loss = _cross_entropy(member(inputs)[:, 0], target, weight) + self.penalty * size
            gradient = torch.autograd.grad(loss, parameters)
            return loss.item(), torch.cat([g.ravel() for g in gradient]).numpy()

        def note(intermediate_result):  # SciPy knows it by the argument's name
            curve.append(float(intermediate_result.fun))

        start = nn.utils.parameters_to_vector(parameters).detach().numpy()
        options = {"maxiter": epochs, "maxfun": 4 * epochs + 20, "maxcor": 30}
        options |= {"ftol": self.rtol, "gtol": 1e-10}
        result = minimize(
            loss_and_gradient, start, jac=True, method="L-BFGS-B", callback=note, options=options
        )
        nn.utils.vector_to_parameters(torch.from_numpy(result.x), parameters)
        for parameter in parameters:  # they are views of one vector, which cannot be exported
            parameter.data = parameter.data.clone()
        return curve or [float(result.fun)], bool(result.success)
