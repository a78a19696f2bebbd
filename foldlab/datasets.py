"""Datasets that come with foldlab: labels that took hours, ready to train on.

A dataset is one Parquet table; how it was made (command, commit, seconds, versions) stands in its
``attrs["foldlab"]`` and in its schema.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from foldlab.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

FOLDER = Path(__file__).parent / "data"


def datasets() -> list[str]:
    """Names of the datasets that are there."""
    return sorted(path.stem for path in FOLDER.glob("*.parquet"))


def load_dataset(name: str) -> pd.DataFrame:
    """A dataset by name, such as ``gravity-5k``: one row per label.

    ``gravity-5k``: the nine groups of the full space, ``growth`` (uniaxial or isotropic),
    ``foldable`` (nullable boolean), ``outcome``, ``reason``, ``fold_angle`` (rad), measures m1 … m4
    and tags F1 … F4, ``error_estimate`` (relative), ``events`` (JSON), ``core_seconds`` and more.
    Raises :class:`InputError` for a name that is not there.
    """
    from foldlab.tables import read_table

    if name not in datasets():
        raise InputError(f"no dataset {name!r}; there are: {', '.join(datasets()) or 'none'}")
    return read_table(FOLDER / f"{name}.parquet")
