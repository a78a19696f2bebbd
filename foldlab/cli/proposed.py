"""Proposals of the verb ``design`` in a maker's words and units, and their files."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.cli.outputs import make
from foldlab.design import FULL, PATTERNED, STRIPS
from foldlab.errors import InputError
from foldlab.terminal import note
from foldlab.unit.told import afterwards, beforehand, readable

if TYPE_CHECKING:
    from foldlab.inverse.answer import Answer, Proposal
    from foldlab.inverse.wish import Wish
    from foldlab.unit.sized import Sized

# Evidence that is a curve: in a proposal's own files, not in an answer of several.
CURVES = ("curves", "history")


def need_sizes(wish: Wish) -> None:
    """Raises :class:`InputError` for a wish that leaves sizes or materials of its designs open, or
    their scale to the search, which knows of none that is too large to make."""
    import numpy as np

    from foldlab.inverse.wish import limits_of, quantities_of, scales_of
    from foldlab.materials import read_materials
    from foldlab.unit.sized import missing

    table = read_materials(wish.materials) if wish.passive or wish.active else None
    for pair in wish.pairs:
        names = sorted({name for limit in limits_of(wish, pair, table) for name in limit.powers})
        known = quantities_of(np.zeros((1, len(names))), names)
        if absent := missing(dict.fromkeys(known.columns, 1.0)):
            raise InputError(
                f"--files needs the size and the materials of a unit, and the wish leaves "
                f"{', '.join(absent)} open; add --set {absent[0]}=… or --range, or materials "
                "(--passive, --active)"
            )
    for name, known in scales_of(wish).items():
        if not known:
            raise InputError(
                f"--files needs a scale, and nothing in the wish limits {name}; add --set {name}=… "
                "or " + ("--max-length" if name == "l_s" else "materials (--passive, --active)")
            )


def make_each(folder: Path, answer: Answer) -> list[dict[str, Any]]:
    """Solves each proposal as the verb check does, and writes its files into a folder of its
    number; what the solver said of each, and its files."""
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.check import by_rod
    from foldlab.unit.record import draw, write_path

    space = PATTERNED if answer.wish.patterned else FULL
    source, out = as_asked(answer.wish, SolverSource(space=space)), []
    for number, proposal in enumerate(answer.proposals, start=1):
        unit = unit_of(answer.wish, proposal)
        run, label = source.follow(unit.groups)
        said = beforehand(unit, source, by_rod(unit, source))
        said |= afterwards(unit, source, run, label)
        note(f"{number} of {len(answer.proposals)}, by the solver under its weight: {label.reason}")
        own = folder / str(number)
        own.mkdir()
        with tempfile.TemporaryDirectory() as pictures:
            if run.shapes:
                write_path(Path(pictures), run)
                draw(Path(pictures), label, run, source, animate=False, measured=False)
            told = readable(said | {"files": []}, unit)
            del told["to change"]  # nothing was tried
            made = make(own, unit, source, said, told, run, Path(pictures) / "shapes.png")
        kept = ("foldable", "fold_angle", "reason", "topples", "core_seconds")
        out.append({"folder": str(number), **{k: said[k] for k in kept}, **made})
    return out


def as_asked(wish: Wish, source):
    """The source, for which folding means a wished angle within its tolerance, and whose panels
    touch where the wish asks about it."""
    from foldlab.labels.foldability import Thresholds

    if wish.touching is not None and hasattr(source, "conditions"):
        acting = replace(source.conditions, effects="gravity,ground,contact")
        source = replace(source, conditions=acting)
    if isinstance(wish.want, str):
        return source
    need = max(wish.want.value - wish.want.tolerance, 1e-3)
    return replace(source, thresholds=Thresholds(need=need))


def unit_of(wish: Wish, proposal) -> Sized:
    """A proposal in SI units; of its materials the ranges that the wish left open."""
    from foldlab.materials import read_materials
    from foldlab.unit.sized import OF_MATERIAL, sized

    table = read_materials(wish.materials)
    cut = {name: proposal.groups[name] for name in STRIPS if name in proposal.groups}
    unit = sized({**proposal.physical, **cut}, table, *proposal.materials)
    # A stimulus is chosen with the design; E and rho are what the material turns out to have.
    left = {
        quantity
        for role, name in zip(OF_MATERIAL, proposal.materials, strict=True)
        for quantity in OF_MATERIAL[role]
        if name is not None and quantity not in (*wish.fixed, "contraction")
    }
    given = cut | {k: v for k, v in proposal.physical.items() if k not in left}
    return replace(unit, ranges=sized(given, table, *proposal.materials).ranges)


SHOWN_AS = "sizes in mm, l length, b width, h thickness, s sheet, i active layer"
SIZES = ("l_s", "b_s", "h_s", "l_i", "b_i", "h_i")


def made_of(answer: Answer, source) -> dict[str, Any]:
    """An answer under weight as plain values, and what its materials say; without curves."""
    import pandas as pd

    from foldlab.inverse.wish import masses_of
    from foldlab.labels.solver import SolverSource
    from foldlab.unit.check import strained, uncertainty

    out = answer.as_dict()
    touch = answer.wish.touching is not None
    panels = "stop at each other" if touch else "may pass through each other"
    out["conditions"] = f"uniaxial contraction, gravity, ground; panels {panels}"
    for row, proposal in zip(out["proposals"], answer.proposals, strict=True):
        evidence = {k: v for k, v in row.pop("evidence", {}).items() if k not in CURVES}
        row |= {"fold_angle": proposal.angle, "evidence": evidence}
        row["confirmed_by"] = answer.source if proposal.confirmed else None
        row["topples"] = evidence.get("topples")
        row["strain"] = row["over_materials"] = row["material_cost"] = None
        if "h_s" not in proposal.physical:
            continue
        unit = unit_of(answer.wish, proposal)
        row["strain"] = strained(unit, evidence)
        if proposal.mass is not None:
            quantities = pd.DataFrame([{**proposal.groups, **proposal.physical}])
            masses = {layer: mass[0] for layer, mass in masses_of(quantities).items()}
            row["material_cost"] = unit.cost(masses)
        if isinstance(source, SolverSource):
            row["over_materials"] = uncertainty(unit, source)
    return out


def told(answer: Answer, result: Mapping[str, Any]) -> tuple[list[dict], dict[str, Any]]:
    """Rows of a table, and what is said below it."""
    from foldlab.unit.told import DEGREES, over, strained_by, yes

    rows, words = [], {}
    for number, (p, row) in enumerate(
        zip(answer.proposals, result["proposals"], strict=True), start=1
    ):
        known = {name: 1e3 * p.physical[name] for name in SIZES if name in p.physical}
        if len(answer.wish.pairs) > 1:
            known = {"materials": " + ".join(filter(None, p.materials)), **known}
        turned = None if p.angle is None else p.angle * DEGREES
        rows.append(
            {"": str(number)}
            | (known if "h_s" in known else {k: p.groups[k] for k in FULL.names[:-1]})
            | {"contraction, %": 100 * p.groups["contraction"], "angle, °": turned}
            | ({} if p.mass is None else {"mass, g": 1e3 * p.mass})
        )
        if p.label is None:
            text = "by the rod, unconfirmed"
        else:
            held = f"{p.box_held} of {p.box_checked}"
            text = f"confirmed by the {answer.source}, and {held} of its box's worst corners"
        if row["topples"] is not None:
            text += f"; tips over: {yes(row['topples'])}"
        if p.label is not None and "full turn" in p.label.reason:
            text += "; it turns fully, as if panels could pass through each other"
        if answer.wish.touching is not None and p.label is not None:
            text += f"; panels {'touch' if answer.wish.touching else 'stay apart'}"
        words[str(number)] = text
        if "strips" in p.groups:
            words[f"{number} strips"] = _strips(p)
        words[f"{number} holds for"] = _box(p)
        if row["strain"]:
            words[f"{number} strain"] = strained_by(row["strain"])
        if row["material_cost"]:
            low, high = row["material_cost"]
            cost = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
            words[f"{number} material cost"] = f"{cost}, by your prices per kg"
        if row["over_materials"]:
            words[f"{number} over the materials"] = over(row["over_materials"])
    words["reason"] = answer.reason
    if answer.largest is not None:
        sizes = answer.largest["physical"]
        words["largest"] = ", ".join(f"{name} {1e3 * sizes[name]:.3g} mm" for name in SIZES) + (
            f", contraction {100 * sizes['contraction']:.3g} %: "
            f"{answer.largest['fold_angle'] * DEGREES:.3g}°"
        )
    words["confirmed by"] = f"{answer.source or 'nobody; the rod says so'} ({result['conditions']})"
    words["core_seconds"] = answer.core_seconds
    return rows, words


def _strips(p: Proposal) -> str:
    count, cover = int(p.groups["strips"]), p.groups["strip_share"]
    text = f"{count}, which cover {100 * cover:.3g} % of the hinge"
    if "b_i" not in p.physical:
        return text
    pitch = 1e3 * p.physical["b_i"] / count
    return f"{text}: {cover * pitch:.4g} mm wide, gaps of {(1 - cover) * pitch:.4g} mm"


def _box(p: Proposal) -> str:
    from foldlab.design import PHYSICAL
    from foldlab.unit.told import SHOWN

    parts = []
    for name, (low, high) in p.box.items():
        at = p.physical[name] if name in p.physical else p.groups[name]
        unit, factor = ("%", 100.0) if name == "contraction" else SHOWN[PHYSICAL.get(name, "1")]
        off = [f"{100 * abs(end / at - 1):.2g}" for end in (low, high)]
        told = f"±{off[0]}" if off[0] == off[1] else f"−{off[0]} +{off[1]}"
        ends = f"{name} {' to '.join(_apart(low * factor, high * factor))} {unit}".rstrip()
        parts.append(f"{ends} ({told} %)")
    return ", ".join(parts) or "nothing else"


def _apart(low: float, high: float) -> tuple[str, str]:
    """Both with three digits, or with as many as tell them apart by more than the last one."""
    for digits in range(3, 8):
        told = tuple(f"{float(f'{value:.{digits}g}'):.10g}" for value in (low, high))
        step = 10.0 ** (np.floor(np.log10(abs(high))) + 1 - digits)
        if high - low >= 2 * step or low == high:
            break
    return told
