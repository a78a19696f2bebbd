"""foldlab: which self-folding units fold, why, how sure we are, and what to build instead."""

from importlib import import_module

__version__ = "0.1.0"

# Imported when first asked for: NumPy alone takes longer than the rest of a short command.
_HOMES = {
    "FULL": "foldlab.design",
    "PATTERNED": "foldlab.design",
    "REDUCED": "foldlab.design",
    "Answer": "foldlab.inverse.answer",
    "DesignSpace": "foldlab.design",
    "InputError": "foldlab.errors",
    "Label": "foldlab.labels.label",
    "LabelSource": "foldlab.labels.label",
    "LabelStore": "foldlab.labels.store",
    "LadderSource": "foldlab.labels.sources",
    "Parameter": "foldlab.design",
    "RegimeMap": "foldlab.maps.regimes",
    "RodSource": "foldlab.labels.rod",
    "SolverSource": "foldlab.labels.solver",
    "TimoshenkoSource": "foldlab.labels.timoshenko",
    "Wish": "foldlab.inverse.wish",
    "fit": "foldlab.learning.train",
    "load_dataset": "foldlab.datasets",
    "load_model": "foldlab.learning.saving",
    "make_classifier": "foldlab.learning.models",
    "make_source": "foldlab.labels.sources",
    "propose": "foldlab.inverse.propose",
    "regime_map": "foldlab.maps.regimes",
    "run_campaign": "foldlab.campaign.campaign",
    "save_model": "foldlab.learning.saving",
    "score": "foldlab.learning.scoring",
    "space_of": "foldlab.design",
    "to_groups": "foldlab.design",
    "to_physical": "foldlab.design",
}

__all__ = [
    "FULL",
    "PATTERNED",
    "REDUCED",
    "Answer",
    "DesignSpace",
    "InputError",
    "Label",
    "LabelSource",
    "LabelStore",
    "LadderSource",
    "Parameter",
    "RegimeMap",
    "RodSource",
    "SolverSource",
    "TimoshenkoSource",
    "Wish",
    "fit",
    "load_dataset",
    "load_model",
    "make_classifier",
    "make_source",
    "propose",
    "regime_map",
    "run_campaign",
    "save_model",
    "score",
    "space_of",
    "to_groups",
    "to_physical",
]


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
