"""What each effect of a scene contributed, what the answer is without it, and what to choose.

``contributions`` looks at the last state of a path, ``ablate`` labels the design again without an
effect, and ``advise`` says which choices were superfluous, and which were missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.labels.timoshenko import fold_angle, lift_off_stiffness, weight_turning

if TYPE_CHECKING:
    from foldlab.labels.label import Label
    from foldlab.labels.run import Run
    from foldlab.labels.solver import SolverSource

# What goes together: a weight needs a ground.
GROUPS = {"gravity": ("gravity", "ground"), "contact": ("contact",)}


def contributions(
    run: Run, clock: Mapping[str, Sequence[float]], seconds: float
) -> list[dict[str, Any]]:
    """Per effect its fractions of energy, forces and time, at the last state of the path.

    ``energy``: |E − E at rest| over the sum of all, E at rest that of the flat unit. ``force``: sum
    of the nodes' |f| over that of all terms; in equilibrium none is more than a half. ``time``: of
    the core-``seconds`` that the label took; the rest, mostly linear algebra, is "solving".
    """
    folding = run.folding
    model, e = folding.model, folding.last.e
    u = model.scene.displacement(folding.x, e)
    flat = np.zeros_like(u)
    rows = []
    clock = {name: tuple(spent) for name, spent in clock.items()}
    for term in model.terms:
        if term.name not in clock:
            continue
        at, before = term.evaluate(u, e, 1), term.evaluate(flat, 0.0, 0)
        energy = None if at.energy is None else abs(at.energy - before.energy)
        force = float(np.linalg.norm(at.force, axis=1).sum())
        rows.append({"effect": term.name, "energy": energy, "force": force})
    totals = {k: sum(r[k] or 0.0 for r in rows) for k in ("energy", "force")}
    for row in rows:
        for k, total in totals.items():
            row[k] = None if row[k] is None else row[k] / total if total > 0 else 0.0
        spent = clock[row["effect"]]
        row |= {"time": spent[1] / seconds, "evaluations": int(spent[0])}
    rest = 1.0 - sum(row["time"] for row in rows)
    return [*rows, {"effect": "solving", "energy": None, "force": None, "time": rest}]


def ablate(label: Label, source: SolverSource) -> list[dict[str, Any]]:
    """The label without each effect that may be left out: angle, change of it and verdict."""
    rows = []
    for name, together in GROUPS.items():
        if name not in source.conditions.terms:
            continue
        kept = [t for t in source.conditions.terms if t not in together]
        # Without a ground there is nothing to rub on.
        friction = source.conditions.friction if "ground" in kept else 0.0
        conditions = replace(source.conditions, effects=",".join(kept) or "none", friction=friction)
        # Without the effect the error of the coarsest mesh is not known.
        effort = replace(source.effort, refine="always")
        other = replace(source, conditions=conditions, effort=effort)
        again = other.label(label.design)
        angle = again.evidence.get("m1")
        have = label.evidence.get("m1")
        known = angle is not None and have is not None
        rows.append(
            {
                "without": ",".join(together),
                "fold_angle": angle,
                "change": angle - have if known else None,
                "foldable": again.foldable,
                "outcome": again.evidence["outcome"],
                "seconds": again.evidence["seconds"],
            }
        )
    return rows


def advise(
    label: Label, run: Run, source: SolverSource, without: Sequence[Mapping[str, Any]] = ()
) -> list[str]:
    """One sentence per choice that the answer calls for, most consequential first."""
    if not run.history:
        return []
    d, e, last = label.design, label.evidence, run.history[-1]
    scale = source.thresholds.scale(e["m1"], last["contraction"])
    acting, accuracy = source.conditions, source.effort.accuracy
    says = []
    least = lift_off_stiffness(d)
    measured = {row["without"].split(",")[0]: row["change"] for row in without}
    if acting.heavy:
        change = weight_turning(d) / d["stiffness_to_weight"] / scale
        how = "at most, of level panels"
        if measured.get("gravity") is not None:
            change, how = abs(measured["gravity"]) / scale, "measured without it"
        if change < accuracy:
            says.append(
                f"gravity is superfluous: it changes the angle by {100 * change:.2g} % ({how}), "
                f"less than the {100 * accuracy:g} % asked for; --effects none is cheaper"
            )
    else:
        gamma = weight_turning(d) / scale / accuracy
        says.append(
            f"weight was left out: it may change the angle by more than "
            f"{100 * accuracy:g} % where Γ < {gamma:.2g}, and keeps rigid panels down "
            f"where Γ < {least:.2g}; there add --effects gravity,ground"
        )
    ends = run.folding.last.curves[0][[0, -1]]
    if "contact" not in acting.terms and "y" in run.folding.model.mirrors:
        crossed = [h for h, s in zip(run.history, run.shapes, strict=False) if _crossed(s)]
        if crossed or ends[1, 1] < 0:
            at = (crossed[0] if crossed else last)["contraction"]
            says.append(
                f"the panels passed through each other by {100 * at:.3g} % contraction; add "
                "contact to the effects to stop them there"
            )
    if "contact" in acting.terms and not any(x["kind"] == "contact" for x in e["events"]):
        says.append("contact never acted: the panels did not touch; leave it out")
    if source.question == "from_flat" and acting.growth == "isotropic" and e["outcome"] == "curled":
        says.append(
            "it curls from flat; a folded state may exist all the same: ask with --question exists"
        )
    groups = ("E_ratio", "h_ratio", "slenderness", "hinge_length", "contraction")
    simple = float(fold_angle(*(d[name] for name in groups)))
    if abs(e["m1"] - simple) < accuracy * scale and label.foldable is not None:
        says.append(
            f"Timoshenko's formula gives {simple:.3g} rad, within the error asked for: for designs "
            "like this one the source timoshenko would do"
        )
    turn = max(max(abs(h["m1"]), abs(h["hinge"]), h["m2"]) for h in run.history)
    if turn**2 / 6 < accuracy:
        # sin θ against θ is what a linear theory leaves out.
        says.append(
            f"nothing turns by more than {turn:.2g} rad: small strain and small rotations would do "
            f"(off by about {100 * turn**2 / 6:.1g} %)"
        )
    kinds = ("sideways", "rocking", "twisting", "bifurcation")
    lost = [x for x in e["events"] if x["kind"] in kinds]
    whole = {0: "the whole unit", 1: "half of it"}
    if lost:
        says.append(
            f"the symmetric state is lost at {100 * lost[0]['contraction']:.3g} % contraction "
            f"({lost[0]['kind']}), so the path went on with "
            f"{whole.get(len(run.folding.model.mirrors), 'a quarter')}: that was needed"
        )
    else:
        says.append(
            "the unit stayed symmetric and stable in all four classes: a quarter was enough"
        )
    if acting.upright and e.get("topples"):
        says.append("it is held upright, and would topple if let go; --free shows where it lands")
    return says


def _crossed(shape) -> bool:
    """Whether a panel's end lies beyond the plane between the panels."""
    return bool(shape.state.curves[0][-1, 1] < 0)
