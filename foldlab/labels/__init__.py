"""Labels and where they come from: the analytic oracle, the solver, the store."""

from importlib import import_module

from foldlab.packaged import check_solver

check_solver()

# Imported when first asked for: PyTorch, VTK and the solver take seconds.
_HOMES = {
    "Label": "foldlab.labels.label",
    "LabelStore": "foldlab.labels.store",
    "LadderSource": "foldlab.labels.sources",
    "RodSource": "foldlab.labels.rod",
    "SolverSource": "foldlab.labels.solver",
    "TimoshenkoSource": "foldlab.labels.timoshenko",
    "make_source": "foldlab.labels.sources",
}

__all__ = [
    "Label", "LabelStore", "LadderSource", "RodSource", "SolverSource", "TimoshenkoSource",
    "make_source",
]  # fmt: skip


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
