"""Materials by name, with the ranges that their properties lie in.

The shipped table is ``foldlab/data/materials.csv``, whose head explains its columns; a user's own
table joins it, and replaces rows of the same name.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pandas as pd

from foldlab.errors import InputError

# Properties with a low and a high end, and the roles that must have them.
REQUIRED = {"E": ("passive", "active"), "rho": ("passive", "active"), "contraction": ("active",)}
# No prices are shipped.
OPTIONAL = ("strain", "price")


def read_materials(path: str | Path | None = None) -> pd.DataFrame:
    """Shipped materials and those of the user's table ``path``, by name.

    Raises :class:`InputError` for an unreadable file, missing columns, a repeated name, a role that
    is none, or a range that is no interval above 0.
    """
    table = _read(resources.files("foldlab") / "data" / "materials.csv")
    if path is not None:
        own = _read(path)
        table = pd.concat([table.drop(index=own.index, errors="ignore"), own])
    return table


def find_material(table: pd.DataFrame, name: str, role: str | None = None) -> str:
    """The name in the table of a material that may be called by another one, in any case.

    A material's own name wins over other names of materials. ``role``: passive or active. Raises
    :class:`InputError` for a name that is not there, or is of the other role.
    """
    wanted = _key(name)
    others = table["aliases"].tolist() if "aliases" in table else [""] * len(table)
    rows = zip(table.index.tolist(), table["role"].tolist(), others, strict=True)
    fitting = [(str(known), str(also)) for known, its, also in rows if role in (None, its)]
    for known, _ in fitting:
        if wanted == _key(known):
            return known
    for known, also in fitting:
        if wanted and wanted in map(_key, also.split(";")):
            return known
    rows = table if role is None else table[table["role"] == role]
    listed = ", ".join(rows.index)
    raise InputError(
        f"no {role or ''}{' ' * bool(role)}material {name!r}; the table has: {listed} "
        "(`foldlab materials` lists them with their other names; --materials adds your own)"
    )


def _key(name: str) -> str:
    return " ".join(name.lower().replace("-", " ").split())


def _read(path) -> pd.DataFrame:
    try:
        with path.open(encoding="utf-8") if not isinstance(path, str) else open(path) as file:
            table = pd.read_csv(file, comment="#", skipinitialspace=True)
    except (OSError, ValueError) as error:
        raise InputError(f"materials {path}: {error}; give a readable CSV file") from None
    ends = [f"{q}_{end}" for q in REQUIRED for end in ("low", "high")]
    missing = [c for c in ("name", "role", *ends) if c not in table.columns]
    if missing or table.empty:
        raise InputError(
            f"materials {path}: {len(table)} rows, missing: {', '.join(missing) or 'none'}; it has "
            f"the columns {', '.join(map(str, table.columns))}, expected commas between them: "
            "start from the shipped table"
        )
    if table["name"].duplicated().any():
        raise InputError(f"materials {path}: a name occurs twice; give each row its own")
    if (wrong := ~table["role"].isin(["passive", "active"])).any():
        raise InputError(
            f"materials {path}: {table['name'][wrong].iloc[0]} has the role "
            f"{table['role'][wrong].iloc[0]!r}; expected passive or active"
        )
    for quantity in (*REQUIRED, *OPTIONAL):
        if f"{quantity}_low" not in table or f"{quantity}_high" not in table:
            table[[f"{quantity}_low", f"{quantity}_high"]] = float("nan")
        low, high = (
            pd.to_numeric(table[f"{quantity}_{e}"], errors="coerce") for e in ("low", "high")
        )
        given = table[[f"{quantity}_low", f"{quantity}_high"]].notna().any(axis=1)
        must = table["role"].isin(REQUIRED.get(quantity, ())) | given
        bad = must & ~((low > 0) & (low <= high) & (high < float("inf")))
        if bad.any():
            raise InputError(
                f"materials {path}: {table['name'][bad].iloc[0]} has no interval above 0 for "
                f"{quantity}; give {quantity}_low ≤ {quantity}_high"
            )
        table[f"{quantity}_low"], table[f"{quantity}_high"] = low, high
    for column in ("aliases", "stimulus", "note", "basis"):
        table[column] = table[column].fillna("") if column in table else ""
    return table.set_index("name")
