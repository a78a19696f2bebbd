"""Equilibrium paths: points, steppers, continuation, stability."""

from importlib import import_module

# Imported when first asked for: PyTorch, VTK and the solver take seconds.
_HOMES = {
    "ArcLength": "solver.paths.steppers",
    "LoadSteps": "solver.paths.steppers",
    "StableSteps": "solver.paths.stable",
    "follow": "solver.paths.continuation",
    "load": "solver.paths.continuation",
    "trace": "solver.paths.continuation",
}

__all__ = ["ArcLength", "LoadSteps", "StableSteps", "follow", "load", "trace"]


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
