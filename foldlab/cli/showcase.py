"""What the quickstart shows under weight: a unit that folds, designs for a wish, a map.

All are of one sheet, 40 × 10 mm of polyester film, 50 µm thick, with a shape-memory polymer.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.cli.maps import CONTOURS, cells, verification
from foldlab.cli.outputs import new_folder
from foldlab.cli.proposed import as_asked, made_of, make_each, told
from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.labels.asked import Conditions, Effort, Plan
from foldlab.labels.solver import SolverSource
from foldlab.unit.told import afterwards

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from foldlab.inverse.answer import Answer
    from foldlab.labels.label import Label
    from foldlab.maps.regimes import RegimeMap
    from foldlab.unit.sized import Sized

MATERIALS = ("PET", "SMP")
SHEET = {"l_s": 0.04, "b_s": 0.01, "h_s": 5e-5}  # m
# A unit of it whose panels meet, and whose materials surely bear that.
UNIT = SHEET | {"h_i": 3e-4, "l_i": 0.01, "contraction": 0.18}
ANGLE, TOLERANCE = np.pi / 2, 0.05
STRAIN_MARGIN = 0.2
CONTRACTION = 0.3  # of the map
TIMEOUT = 30.0  # core-seconds for each of its designs
TURN = 0.15  # rad from state to state, so that they make a film


class Film(Effort):
    """As well known as any other label, in smaller steps."""

    @property
    def plan(self) -> Plan:
        return replace(super().plan, turn=TURN)


@dataclass(frozen=True)
class Folding:
    """A unit on the solver's path: ``answer``: as of the verb check; ``states``: how many;
    ``files``: names in its folder."""

    unit: Sized
    label: Label
    answer: Mapping[str, Any]
    states: int
    files: list[str]


@dataclass(frozen=True)
class Designed:
    """Designs for a wish: ``rows`` and ``words`` as the verb design tells them, by number;
    ``made``: the solver's answer and the files of each."""

    answer: Answer
    rows: list[dict[str, Any]]
    words: dict[str, Any]
    made: list[dict[str, Any]]


@dataclass(frozen=True)
class Mapped:
    """A map of the shipped model ``model``; ``checked``: how it did where the solver was asked;
    ``sure``: on how many the solver agrees, and of how many, where the model is sure."""

    regime: RegimeMap
    model: str
    checked: Mapping[str, Any]
    sure: tuple[int, int]
    figure: Figure


def fold(folder: Path) -> Folding:
    """Follows the unit with contact of its panels; pictures and path go into ``folder``."""
    from foldlab.materials import read_materials
    from foldlab.unit.record import clear, draw, write_json, write_path
    from foldlab.unit.sized import sized

    folder.mkdir(exist_ok=True)
    unit = sized(UNIT, read_materials(), *MATERIALS)
    source = SolverSource(Conditions("gravity,ground,contact"), Film(whole=True))
    run, label = source.follow(unit.groups)
    answer = {"physical": dict(unit.physical), "design": dict(unit.groups)}
    answer |= afterwards(unit, source, run, label)
    clear(folder)
    write_json(folder / "result.json", answer)
    files = ["result.json"]
    if run.shapes:
        files += write_path(folder, run) + draw(folder, label, run, source, animate=True)
    return Folding(unit, label, answer, len(run.history), files)


def check_designs(folder: Path) -> None:
    """Raises :class:`InputError` where ``folder`` holds anything but designs made before."""
    if not folder.exists():
        return
    if not folder.is_dir() or not all((path / "unit.json").is_file() for path in folder.iterdir()):
        raise InputError(f"{folder} holds other things than designs; move it away")


def designs(
    folder: Path, n: int, *, seed: int, workers: int, say: Callable[[str], None]
) -> Designed:
    """``n`` hinges that fold the sheet by 90°, confirmed by the solver; the files of each go into
    ``folder``/1, 2, …, which is made anew."""
    from foldlab.campaign.worker import pool
    from foldlab.inverse.weighted import weighted
    from foldlab.inverse.wish import Angle, Wish

    passive, active = MATERIALS
    wish = Wish(
        FULL, want=Angle(ANGLE, TOLERANCE), fixed=SHEET, passive=(passive,), active=(active,),
        strain_margin=STRAIN_MARGIN,
    )  # fmt: skip
    source = as_asked(wish, SolverSource())
    with pool(workers) if workers > 1 else nullcontext() as executor:
        answer = weighted(wish, n, seed=seed, source=source, executor=executor, tell=say)
    rows, words = told(answer, made_of(answer, source))
    check_designs(folder)
    shutil.rmtree(folder, ignore_errors=True)
    with new_folder(folder) as draft:
        made = make_each(draft, answer)
    return Designed(answer, rows, words, made)


def heavy_map(points: int, verify: int, *, seed: int, workers: int) -> Mapped:
    """The shipped model's map over stiffness and thickness, from heavy to stiff, with ``verify``
    designs that the solver checked."""
    from foldlab.labels.timoshenko import TimoshenkoSource
    from foldlab.learning.features import probability_of_folding
    from foldlab.learning.saving import load_model, shipped_for
    from foldlab.maps.plots import plot_regimes
    from foldlab.maps.regimes import held_in_the_middle, regime_map

    model = shipped_for(FULL.name)
    fitted, _ = load_model(model)
    used = ("E_ratio", "h_ratio", "stiffness_to_weight")
    regime = regime_map(
        fitted,
        space=FULL,
        axes=used[:2],
        slice_by=used[2],
        slices=FULL[used[2]].from_unit(cells(9)),
        fixed=held_in_the_middle(FULL, used, {"contraction": CONTRACTION}),
        points=points,
        beside=("boundary without weight", TimoshenkoSource(space=FULL)),
    )
    table, checked, sure = None, {}, (0, 0)
    if verify:
        table, checked = verification(regime, verify, seed, TIMEOUT, workers, quiet=True)
        low, high = CONTOURS
        p = probability_of_folding(fitted, table)
        known = table[((p < low) | (p > high)) & table["foldable"].notna()]
        sure = int((known["predicted"] == known["foldable"].astype(bool)).sum()), len(known)
    figure = plot_regimes(regime, points=table, contours=CONTOURS)
    return Mapped(regime, model, checked, sure, figure)
