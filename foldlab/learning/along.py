"""States along a path are labels, too: of the same unit at a smaller contraction.

A path holds every contraction up to its last. Its states come from the coarsest mesh, so a state
counts only where the thresholds lie further away than that mesh is off
(:mod:`foldlab.labels.screening`).
"""

from __future__ import annotations

import json

import pandas as pd

from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels.foldability import Thresholds
from foldlab.labels.screening import coarse_errors


def states_as_labels(table: pd.DataFrame, thresholds: Thresholds | None = None) -> pd.DataFrame:
    """Labels of the states that the paths of a table of labels went through.

    ``table``: as :func:`foldlab.load_dataset` gives it: groups, ``history``, ``growth``, m3 and m4.
    Returns the groups with the state's ``contraction``, ``growth``, ``foldable`` (boolean), ``m1``
    and ``m2`` (rad), ``fold_angle`` (rad), ``normalised_angle`` (rad per unit contraction) and
    ``of``, the row of the label in the table. Left out: flat units, contractions below the space's,
    the last state (it is the label), states that the coarsest mesh leaves open, and paths that lost
    a symmetry, for a history knows m1 and m2 only.

    Raises :class:`InputError` where a column is missing.
    """
    needed = [*FULL.names, "history", "growth", "m3", "m4"]
    if missing := [name for name in needed if name not in table]:
        raise InputError(
            f"the table has no {', '.join(missing)}: states are known of labels of the solver, as "
            "in load_dataset('gravity-5k')"
        )
    thresholds = thresholds or Thresholds()
    least = FULL["contraction"].low
    parallel = (table[["m3", "m4"]].astype(float) - 1).abs().max(axis=1) < thresholds.parallel
    rows = []
    for at, (history, growth, whole) in enumerate(
        zip(table["history"], table["growth"], parallel, strict=True)
    ):
        if not (whole and isinstance(history, str)):
            continue
        for contraction, m1, m2 in json.loads(history)[:-1]:
            if contraction < least:
                continue
            errors = coarse_errors(m1, contraction, thresholds, growth=growth)
            room = m1 - float(thresholds.angle(contraction))
            across = float(thresholds.most_across(contraction)) - m2
            if room < -errors[0] or across < -errors[1]:
                rows.append((at, contraction, m1, m2, False))
            elif room > errors[0] and across > errors[1]:
                rows.append((at, contraction, m1, m2, True))
    states = pd.DataFrame(rows, columns=["at", "contraction", "m1", "m2", "foldable"])
    at, contraction, m1 = states["at"].astype(int), states["contraction"], states["m1"]
    out = table[FULL.names].iloc[at].reset_index(drop=True)
    return out.assign(
        contraction=contraction.astype(float),
        growth=table["growth"].to_numpy()[at],
        foldable=states["foldable"].astype("boolean"),
        m1=m1,
        m2=states["m2"],
        fold_angle=m1,
        normalised_angle=m1 / contraction,
        of=table.index.to_numpy()[at],
    )
