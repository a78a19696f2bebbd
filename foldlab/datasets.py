"""Datasets that come with foldlab: labels that took hours, ready to train on.

A dataset is a Parquet table, or a folder of them that has been growing piece by piece; how each was
made (command, commit, seconds, versions) stands in its schema and in the table's
``attrs["foldlab"]``.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.design import FULL, PATTERNED
from foldlab.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

FOLDER = Path(__file__).parent / "data"


def datasets() -> list[str]:
    """Names of the datasets that are there."""
    return sorted({_name(path) for path in FOLDER.rglob("*.parquet")})


def load_dataset(
    name: str, *, growth: str | None = None, part: str | None = None, space: str | None = None
) -> pd.DataFrame:
    """A dataset by name: one row per label.

    ``gravity``: labels of the current solver, see :func:`card`. ``growth``: only those of
    "uniaxial" or "isotropic" contraction. ``part``: only those of "train", "validation" or "test",
    which were split once; the latter two are Latin hypercubes. ``space``: only designs of "full",
    whose active layer is solid, without the columns of strips; or of "patterned", cut in strips.

    ``gravity-5k``: the first version, which knows neither parts nor strips. Both have the groups
    of the full space, ``growth``, ``foldable`` (nullable boolean), ``outcome``, ``reason``,
    ``fold_angle`` (rad), measures m1 … m4 and tags F1 … F4, ``error_estimate``
    (relative), ``events`` and ``history`` (JSON), ``core_seconds`` and more.

    Raises :class:`InputError` for a name, growth, part or space that is not there.
    """
    import pandas as pd

    from foldlab.tables import read_table

    files = [path for path in sorted(FOLDER.rglob("*.parquet")) if _name(path) == name]
    if not files:
        raise InputError(f"no dataset {name!r}; there are: {', '.join(datasets()) or 'none'}")
    tables = [read_table(path) for path in files]
    made = [table.attrs.get("foldlab", {}) for table in tables]
    table = tables[0]
    if len(tables) > 1:
        for one in tables:
            one.attrs = {}
        table = pd.concat(tables, ignore_index=True)
    for column, wanted in (("growth", growth), ("part", part)):
        if wanted is None:
            continue
        there = sorted(table[column].unique()) if column in table else []
        if wanted not in there:
            raise InputError(
                f"{column} {wanted!r} is not in the dataset {name}; it has: "
                f"{', '.join(there) or 'none'}"
            )
        table = table[table[column] == wanted].reset_index(drop=True)
    if space is not None:
        table = of_space(table, name, space)
    table.attrs["foldlab"] = made[0] if len(made) == 1 else _together(made)
    return table


def of_space(table: pd.DataFrame, name: str, space: str) -> pd.DataFrame:
    """The rows of a table of labels whose active layers are solid ("full", without the columns of
    strips) or cut in strips ("patterned"). Raises :class:`InputError` where there are none."""
    strips = [column for column in PATTERNED.names if column not in FULL.names]
    cut = table["strips"] > 0 if "strips" in table else np.zeros(len(table), bool)
    there = [s.name for s, rows in ((FULL, ~cut), (PATTERNED, cut)) if rows.any()]
    if space not in there:
        raise InputError(
            f"space {space!r} is not in the dataset {name}; it has: {', '.join(there)}"
        )
    solid = space == FULL.name
    table = table[~cut if solid else cut].reset_index(drop=True)
    return table.drop(columns=strips, errors="ignore") if solid else table


def card(name: str) -> str:
    """What a dataset is, in Markdown: how it was made, what it cost, its errors, what is missing,
    licence and how to cite; counted from the table as it is. Raises :class:`InputError` for a name
    that is not there."""
    table = load_dataset(name)
    made = table.attrs["foldlab"]
    lines = [f"# Dataset {name}", ""]
    for growth, rows in table.groupby("growth"):
        known = rows["foldable"].notna()
        folds = rows["foldable"] == True  # noqa: E712
        errors = rows["error_estimate"].astype(float)[known]
        missing = Counter(rows["outcome"][~known].astype(str))
        lines += [
            f"## {growth}: {len(rows)} labels",
            f"- folds: {int(folds.sum())}, does not: {int((known & ~folds).sum())}, unknown: "
            f"{int((~known).sum())} ({100 * (~known).mean():.1f} %)"
            + "".join(f"; {why}: {n}" for why, n in missing.most_common()),
            f"- core-seconds per label: median {rows['core_seconds'].median():.2f}, mean "
            f"{rows['core_seconds'].mean():.2f}",
            f"- stated error, relative: median {errors.median():.2g}, 90 % below "
            f"{errors.quantile(0.9):.2g}",
        ]
        for column, what in (("drawn", "drawn from"), ("part", "parts"), ("version", "source")):
            if column in rows:
                counts = Counter(rows[column])
                lines.append(f"- {what}: " + ", ".join(f"{k} {n}" for k, n in counts.items()))
        lines.append("")
    lines += ["## Made by"]
    lines += [f"- {key}: {value}" for key, value in made.items() if key != "pieces"]
    lines += [
        "",
        "Unknown labels are not missing at random: they are designs whose paths snap, roll up or "
        "are so thin that no path came to its end in time. A stated error covers 95 % of designs "
        "(`python -m experiments.accuracy_calibration`).",
        "",
        "Licence: MIT, as foldlab. Cite: foldlab, dataset "
        f"{name}, version {made.get('version') or made.get('commit', '')}, {len(table)} labels.",
    ]
    return "\n".join(lines) + "\n"


def _name(path: Path) -> str:
    return path.stem if path.parent == FOLDER else path.parent.name


PIECE = re.compile(r"(first=)(\d+)")


def _runs(told: list[str]) -> list[str]:
    """Each once; commands that differ in the number of their piece only as one, with its ends."""
    runs: dict[str, list[int]] = {}
    for text in told:
        number = PIECE.search(text)
        runs.setdefault(PIECE.sub(r"\1*", text), []).extend([int(number[2])] if number else [])
    return [
        text.replace("first=*", f"first={min(k)}…{max(k)}" if len(set(k)) > 1 else f"first={k[0]}")
        if k else text
        for text, k in runs.items()
    ]  # fmt: skip


def _together(made: list[dict[str, Any]]) -> dict[str, Any]:
    """How the pieces of a dataset were made, as one."""
    alike = {
        key: ", ".join(_runs([str(one.get(key)) for one in made]))
        for key in ("command", "commit", "machine", "python", "versions", "version")
    }
    sums = {key: sum(one.get(key, 0) for one in made) for key in ("labels", "core_seconds")}
    return {**alike, **sums, "pieces": made}
