"""What an installation holds: our own package ``solver``, the experiments, and which extras.

In the sources ``experiments/`` and ``solver/`` stand beside ``foldlab/``. A wheel has the first as
``foldlab._experiments`` (see setup.py) and the second under its own name, which others use too:
:func:`check_solver` says so where Python finds another one first.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from foldlab.errors import InputError

HERE = Path(__file__).resolve().parent
# What stands beside the experiments and is none; parts of one have names that begin with _.
SHARED = "common"
# The extra of pyproject.toml that has a library which a bare installation lacks.
EXTRAS = {
    "torch": "learn",
    "optuna": "learn",
    "pyoperon": "learn",
    "sympy": "learn",
    "mlflow": "track",
    "pyvista": "view",
    "vtkmodules": "view",
    "pypardiso": "fast",
    "pyamg": "fast",
    "pysr": "pysr",
    "gmsh": "gmsh",
    "ezdxf": "make",
    "shapely": "structure",
    "ipctk": "structure",
    "svgelements": "structure",
    "plotly": "explore",
    "distributed": "cluster",
}


def installed(library: str) -> bool:
    """Whether a library of :data:`EXTRAS` is there; it is not imported."""
    return find_spec(library) is not None


def missing(error: ImportError, what: str = "this") -> InputError | None:
    """Which extra to install for ``what``, where a library of one was not found; else None."""
    library = (error.name or "").partition(".")[0]
    if not isinstance(error, ModuleNotFoundError) or library not in EXTRAS:
        return None
    return InputError(
        f'{what} needs {library}, which is not installed: pip install "foldlab[{EXTRAS[library]}]"'
    )


@contextmanager
def needed_for(what: str) -> Iterator[None]:
    """Imports inside: raises :class:`InputError` naming the extra where a library of one lacks."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise missing(error, what) or error from None


def check_solver() -> None:
    """Raises :class:`InputError` where ``import solver`` would find a package that is not ours."""
    where = _found("solver")
    if where != HERE.parent / "solver":
        raise InputError(
            f"Python finds {where or 'no package'} as 'solver', and foldlab needs its own, "
            f"{HERE.parent / 'solver'}: rename the other one, or start in another folder"
        )


def _found(name: str) -> Path | None:
    """The folder of a top-level package, or the file of a module, that Python would import."""
    try:
        spec = find_spec(name)
    except ValueError:  # one that was made by hand, and says nothing of where it is
        return None
    if spec is None:
        return None
    if spec.origin is None:  # a folder without __init__.py
        return Path(*list(spec.submodule_search_locations or ())[:1]).resolve()
    path = Path(spec.origin).resolve()
    return path.parent if path.name == "__init__.py" else path


def experiments() -> dict[str, str]:
    """Names of the experiments and the question of each, without importing them."""
    import ast

    found = {}
    for path in sorted(_experiments()[1].glob("*.py")):
        if path.stem != SHARED and not path.stem.startswith("_"):
            said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            found[path.stem] = said.partition("\n\n")[0].replace("\n", " ")
    return found


def experiment(name: str) -> tuple[ModuleType, ModuleType]:
    """The module of an experiment, and the one that all share.

    Raises :class:`InputError` for a name that is none.
    """
    if name not in (known := experiments()):
        raise InputError(f"no experiment {name!r}; there are: {', '.join(known)}")
    package, folder = _experiments()
    if (where := _found(package)) != folder:
        raise InputError(
            f"Python finds {where or 'no package'} as '{package}', and not {folder}: "
            "rename the other one, or start in another folder"
        )
    return import_module(f"{package}.{name}"), import_module(f"{package}.common")


def _experiments() -> tuple[str, Path]:
    """The package of the experiments and its folder: in a wheel below foldlab, else beside it."""
    inside = HERE / "_experiments"
    if inside.is_dir():
        return "foldlab._experiments", inside
    return "experiments", HERE.parent / "experiments"
