"""Physics as inputs: the groups of a design beside what beam theory, or a rod, says of them."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from foldlab.design import FULL, DesignSpace
from foldlab.errors import InputError
from foldlab.labels import beam
from foldlab.labels.rod import rod_of
from foldlab.learning.features import GroupFeatures, groups_array

Inputs = Literal["groups", "physics", "rod"]
INPUTS = get_args(Inputs)
# How each column enters: where it may be negative, and where it spans decades.
SCALES = {
    "turning": np.log10, "weight": np.log10, "sag": np.log10, "lift_off": np.log10,
    "edge": np.positive, "net": np.arcsinh, "ratio": np.arcsinh,
    "rod": np.arcsinh, "rod_error": np.log10,
}  # fmt: skip


class PhysicsFeatures(TransformerMixin, BaseEstimator):
    """Named groups to features: the groups as :class:`GroupFeatures` gives them, and their physics.

    The columns of :func:`foldlab.labels.beam.formulas` follow, positive ones as log10, signed ones
    plain (``edge``) or as asinh (``net``, ``ratio``); with ``rod`` those of
    :func:`foldlab.labels.rod.rod_of`, half a millisecond a design. Shapes:
    (n, groups) → (n, features), nondimensional. Raises :class:`InputError` for a space without
    weight and hinge, and with ``rod`` for one with strips.
    """

    def __init__(self, space: DesignSpace, *, rod: bool = False):
        self.space = space
        self.rod = rod

    def fit(self, X, y=None):
        inputs = "rod" if self.rod else "physics"
        check_inputs(inputs, self.space)
        self.groups_ = GroupFeatures(self.space).fit(X)
        self.feature_names_in_ = self.groups_.feature_names_in_
        self.n_features_in_ = len(self.space)
        return self

    def transform(self, X) -> np.ndarray:
        check_is_fitted(self, "groups_")
        designs = pd.DataFrame(groups_array(X, self.space), columns=self.space.names)
        parts = beam.formulas(designs)
        if self.rod:
            parts = parts.join(rod_of(designs, self.space))
        scaled = [SCALES[name](parts[name].to_numpy()) for name in parts]
        return np.column_stack([self.groups_.transform(designs), *scaled])

    def get_feature_names_out(self, input_features=None) -> np.ndarray:
        """Names of the features, such as ``log10(weight)``."""
        check_is_fitted(self, "groups_")
        names = [n for n in SCALES if self.rod or not n.startswith("rod")]
        words = [f"{SCALES[n].__name__}({n})" if SCALES[n] is not np.positive else n for n in names]
        return np.array([*self.groups_.get_feature_names_out(), *words], dtype=object)


def features(space: DesignSpace | None, inputs: Inputs | None = None, *, pairs: bool = False):
    """The unfitted transformer for ``inputs``; ``pairs`` goes to the groups' own.

    "groups": logs of the groups; "physics": and the formulas; "rod": and the rod's answer. None
    takes "physics" where the space has what it needs. Raises :class:`InputError` where it has not.
    """
    if default_inputs(space, inputs) == "groups":
        return GroupFeatures(space, pairs=pairs)
    check_inputs(inputs := default_inputs(space, inputs), space)
    return PhysicsFeatures(space, rod=inputs == "rod")


def default_inputs(space: DesignSpace | None, inputs: Inputs | None = None) -> Inputs:
    """``inputs`` itself, or for None the best that costs nothing in this space."""
    if inputs is not None:
        return inputs
    return "groups" if space is None or set(FULL.names) - set(space.names) else "physics"


def check_inputs(inputs: Inputs, space: DesignSpace | None) -> None:
    """Raises :class:`InputError` for unknown inputs and those that a space cannot give."""
    if inputs not in INPUTS:
        raise InputError(f"inputs {inputs!r}; expected {', '.join(INPUTS)}")
    if inputs == "groups":
        return
    missing = FULL.names if space is None else [n for n in FULL.names if n not in space.names]
    if missing:
        raise InputError(
            f"inputs {inputs!r} need {', '.join(missing)}, which "
            f"{'plain numbers' if space is None else f'the {space.name} space'} lacks; "
            "take inputs 'groups'"
        )
    if inputs == "rod" and "strips" in space.names:
        raise InputError("the rod knows solid layers only; take inputs 'physics' with strips")
