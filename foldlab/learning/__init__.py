"""Classifiers of designs: features, models, training, scores, decisions."""

from importlib import import_module

# Imported when first asked for: PyTorch, VTK and the solver take seconds.
_HOMES = {
    "fit": "foldlab.learning.train",
    "load_model": "foldlab.learning.saving",
    "make_classifier": "foldlab.learning.models",
    "save_model": "foldlab.learning.saving",
    "score": "foldlab.learning.scoring",
}

__all__ = ["fit", "load_model", "make_classifier", "save_model", "score"]


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
