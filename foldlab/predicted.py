"""What trained models say of designs: probability, verdict, "don't know", angle, nearest label."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from foldlab.datasets import load_dataset
from foldlab.design import DesignSpace, space_named
from foldlab.errors import InputError
from foldlab.learning.conformal import Borders
from foldlab.learning.features import as_labels, probability_of_folding
from foldlab.learning.saving import load_model, shipped_for
from foldlab.learning.train import known_labels

# Designs from which on it is told what angles will take, and seconds of a rod.
MANY, ROD = 20_000, 6e-4


@dataclass(frozen=True)
class Predictor:
    """A model of folding with its card, and the shipped model of fold angles for its space.

    ``labels``: a table to find the nearest label in; by default what the card says that the model
    learned from. Tables of groups are frames with the names of the space.
    """

    model: Any
    card: dict[str, Any]
    labels: pd.DataFrame | None = field(default=None, repr=False)

    @classmethod
    def of(cls, model: str | Path, labels: pd.DataFrame | None = None) -> Predictor:
        """The model in a folder, or a shipped one; :class:`InputError` where there is none."""
        return cls(*load_model(model), labels)

    @property
    def space(self) -> DesignSpace:
        """The space whose groups the model reads."""
        return space_named(self.card["space"])

    @property
    def borders(self) -> Borders | None:
        """Where the model's answers begin; None for one that always answers."""
        kept = self.card["metadata"].get("borders")
        return Borders(**kept) if kept else None

    def answers(self, groups: pd.DataFrame) -> dict[str, Any]:
        """Per design ``probability`` of folding, ``foldable`` (NA: don't know), who gave it
        (``by``), and where the card tells the bounds of training whether it is ``inside``."""
        p = probability_of_folding(self.model, groups)
        if self.borders is not None:
            foldable: Any = self.borders.answers(p)
        else:
            foldable = pd.array(as_labels(self.model.predict(groups)), dtype="boolean")
        answers = {"probability": p, "foldable": foldable, "by": "model"}
        if bounds := self.card["metadata"].get("bounds"):
            inside = [groups[name].between(*ends) for name, ends in bounds.items()]
            answers["inside"] = sum(~part for part in inside) == 0
        return answers

    def angles(
        self, groups: pd.DataFrame, tell: Callable[[str], None] = lambda text: None
    ) -> tuple[np.ndarray | None, float | None]:
        """Fold angles in rad (n,) from the shipped model for this space, and what nine of ten
        labels of its card are off by at most, over the angle or what counts as folded; None without
        such a model. ``tell`` hears beforehand what many designs will take."""
        if self._angle is None:
            return None, None
        model, card = self._angle
        if card["metadata"]["inputs"] == "rod" and len(groups) > MANY:
            tell(f"fold angles take a rod each: about {len(groups) * ROD:.0f} s")
        return model.predict(groups), card["metadata"].get("holdout_error_90")

    def nearest(self, groups: pd.DataFrame) -> pd.DataFrame:
        """The nearest labelled design: its row, its verdict, and how far off it is, as a root mean
        square over the groups of the fraction of their bounds. No columns without labels."""
        if self._known is None:
            return pd.DataFrame(index=groups.index)
        known, tree = self._known
        off, near = tree.query(self.space.to_unit(groups[self.space.names]))
        return pd.DataFrame(
            {
                "nearest": known.index.to_numpy()[near],
                "nearest_foldable": known["foldable"].to_numpy()[near],
                "nearest_distance": off / np.sqrt(len(self.space)),
            },
            index=groups.index,
        )

    @cached_property
    def _angle(self) -> tuple[Any, dict[str, Any]] | None:
        try:
            name = shipped_for(self.space.name, task="angle")
        except InputError:
            return None
        return load_model(name)

    @cached_property
    def _known(self):
        from scipy.spatial import cKDTree

        made, table = self.card["metadata"], self.labels
        if table is None and "dataset" in made:
            space = self.card["space"]
            table = load_dataset(made["dataset"], growth=made["growth"], space=space)
        if table is None:
            return None
        known, _ = known_labels(table, self.space)
        return known, cKDTree(self.space.to_unit(known[self.space.names]))
