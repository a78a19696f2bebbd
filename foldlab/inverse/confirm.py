"""Proposals confirmed by a label source: each design, and points of its box."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd

from foldlab.inverse.answer import Answer
from foldlab.inverse.wish import Angle, Wish, box_parameters
from foldlab.labels.label import Label, ask


def confirm(
    answer: Answer, source, *, corners: int = 8, inside: int = 8, seed: int = 0, executor=None
) -> Answer:
    """The answer with every proposal, and points of its box, labelled by a source.

    At most ``corners`` corners of each box (all where it has no more) and ``inside`` random points
    within; 0 and 0 label the designs alone. ``executor`` serves sources that label one at a time.
    """
    wish, rng = answer.wish, np.random.default_rng(seed)
    if not answer.proposals:
        return replace(answer, source=source.name)
    parameters = box_parameters(wish)
    rows = []
    for p in answer.proposals:
        ends = np.array([[q.to_unit(e) for e in p.box[q.name]] for q in parameters])
        corner = np.array(list(product((0.0, 1.0), repeat=len(parameters))))
        if len(corner) > corners:
            corner = corner[rng.choice(len(corner), corners, replace=False)]
        at = np.vstack([corner, rng.random((inside, len(parameters)))])
        points = ends[:, 0] + at * (ends[:, 1] - ends[:, 0])
        rows.append(pd.DataFrame([{q.name: p.groups[q.name] for q in parameters}]))
        rows.append(
            pd.DataFrame({q.name: q.from_unit(points[:, k]) for k, q in enumerate(parameters)})
        )
    designs = pd.concat(rows, ignore_index=True)
    labels = ask(source, designs[wish.space.names], executor=executor)
    verdicts = [
        as_wished(wish, label, row)
        for label, row in zip(labels, designs.to_dict("records"), strict=True)
    ]
    each = len(rows[1]) + 1
    out = []
    for i, p in enumerate(answer.proposals):
        box = verdicts[i * each + 1 : (i + 1) * each]
        out.append(
            replace(
                p,
                label=labels[i * each],
                confirmed=verdicts[i * each],
                box_checked=len(box),
                box_held=sum(v is True for v in box),
                box_unknown=sum(v is None for v in box),
            )
        )
    return replace(answer, proposals=tuple(out), source=source.name)


def as_wished(wish: Wish, label: Label, groups: Mapping[str, float]) -> bool | None:
    if not isinstance(wish.want, Angle):
        return None if label.foldable is None else label.foldable == (wish.want == "foldable")
    angle = label.evidence.get("fold_angle")
    if angle is None and label.evidence.get("normalised_angle") is not None:
        angle = label.evidence["normalised_angle"] * groups["hinge_length"] * groups["contraction"]
    return None if angle is None else bool(abs(angle - wish.want.value) <= wish.want.tolerance)
