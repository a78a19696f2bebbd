"""foldlab: which self-folding units fold, why, how sure we are, and what to build instead."""

from importlib import import_module

__version__ = "0.1.0"

# Imported when first asked for: NumPy alone takes longer than the rest of a short command.
_HOMES = {
    "FULL": "foldlab.design",
    "REDUCED": "foldlab.design",
    "DesignSpace": "foldlab.design",
    "InputError": "foldlab.errors",
    "Parameter": "foldlab.design",
    "load_dataset": "foldlab.datasets",
}

__all__ = ["FULL", "REDUCED", "DesignSpace", "InputError", "Parameter", "load_dataset"]


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
