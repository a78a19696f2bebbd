"""Models on disk: a directory with ``model.json`` and the fitted numbers, without pickle.

scikit-learn models go through skops, restricted to the types listed here. Networks are written
twice: ``network.pt2`` (torch.export, any number of designs) runs without foldlab, on the groups or
on the columns that :class:`foldlab.learning.physics.PhysicsFeatures` makes of them, and
``weights.npz`` is what :func:`load_model` reads, because loading a ``.pt2`` from a stranger may run
the stranger's code. A directory appears whole or not at all.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import skops.io
from sklearn.base import BaseEstimator
from sklearn.model_selection import FixedThresholdClassifier

import foldlab
from foldlab.design import DesignSpace, Parameter
from foldlab.errors import InputError
from foldlab.learning.models import check_trees
from foldlab.learning.operating_point import with_threshold
from foldlab.packaged import missing

# Format 1 named classes by modules that are gone.
FORMAT = 2
CARD = "model.json"
# What a model's files may unpack to; the largest of README's has 10 MB.
MOST_BYTES = 1_000_000_000
SHIPPED = Path(__file__).parents[1] / "data" / "models"
TRUSTED = frozenset(
    {
        "foldlab.learning.models.AngleRegressor",
        "foldlab.learning.models.DistilledTree",
        "foldlab.learning.features.GroupFeatures",
        "foldlab.learning.physics.PhysicsFeatures",
        "foldlab.design.DesignSpace",
        "foldlab.design.Parameter",
        # Arrays of nodes; skops leaves it to the caller to trust them.
        "sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",
        "sklearn.tree._tree.Tree",
    }
)


@dataclass(frozen=True)
class Kind:
    """How one kind of model is written and read.

    ``matches(model)``; ``save(model, directory)`` returns the JSON that ``load(directory, state)``
    gets as its state.
    """

    matches: Callable[[Any], bool]
    save: Callable[[Any, Path], dict]
    load: Callable[[Path, dict], Any]


def save_model(
    model, directory: str | Path, metadata: Mapping[str, Any] | None = None, *, overwrite=False
) -> Path:
    """Write a fitted classifier to ``directory``; returns its path.

    ``metadata`` (plain JSON values: labels used, training seconds, metrics, …; NaN becomes null) is
    kept under ``metadata`` in ``model.json``. A model with a threshold
    (:func:`foldlab.learning.operating_point.with_threshold`) keeps it. The directory is written
    beside its place and then renamed into it. Raises :class:`InputError` where the directory exists
    (with ``overwrite``: where it holds anything but a model), cannot be written, or the model is
    not fitted or of an unknown kind.
    """
    target = Path(directory)
    check_target(target, overwrite)
    inner, threshold = model, None
    if isinstance(model, FixedThresholdClassifier):
        inner = getattr(model, "estimator_", model.estimator)
        threshold = 0.5 if model.threshold == "auto" else float(model.threshold)
    if not (hasattr(inner, "classes_") or hasattr(inner, "regressor_")):
        raise InputError(f"{type(inner).__name__} is not fitted; call fit before saving it")
    name = next((name for name, kind in KINDS.items() if kind.matches(inner)), None)
    if name is None:
        raise InputError(
            f"no way to save a {type(inner).__name__}; known kinds: {', '.join(KINDS)}"
        )
    space = space_of_model(inner)
    card = {
        "format": FORMAT,
        "kind": name,
        "model": type(inner).__name__,
        "foldlab": foldlab.__version__,
        "space": space.name if space else None,
        "columns": [str(c) for c in getattr(inner, "feature_names_in_", [])],
        "classes": _plain(getattr(inner, "classes_", None)),
        "threshold": threshold,
        "metadata": _plain(dict(metadata or {})),
    }
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise InputError(
            f"cannot write a model to {target} ({error}); choose another place"
        ) from None
    try:
        card["state"] = _plain(KINDS[name].save(inner, fresh))
        card["files"] = {p.name: _digest(p) for p in sorted(fresh.iterdir())}
        text = json.dumps(card, indent=1, ensure_ascii=False, allow_nan=False)
        (fresh / CARD).write_text(text + "\n", encoding="utf-8")
        fresh.chmod(0o755)  # temporary directories are private; a model is not
        _put(fresh, target)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    return target


def shipped() -> dict[str, Path]:
    """Names and folders of the models that come with foldlab."""
    return {path.parent.name: path.parent for path in sorted(SHIPPED.glob(f"*/{CARD}"))}


def shipped_for(space: str, task: str = "folds") -> str:
    """The name of the shipped model that answers ``task`` in a space; :class:`InputError` where
    there is none."""
    for name, folder in shipped().items():
        made = read_card(folder)
        if made["space"] == space and made["metadata"].get("task", "folds") == task:
            return name
    raise InputError(
        f"no model for the {space} space is shipped; train one with `foldlab train` and give its "
        "folder"
    )


def load_model(directory: str | Path) -> tuple[Any, dict]:
    """``(model, card)`` as saved; the model answers as it did before saving.

    ``directory``: a folder, or the name of a shipped model. ``card`` is the content of
    ``model.json``. Raises :class:`InputError` where the directory is
    missing, no model, damaged, of another format, or holds types that are not trusted.
    """
    directory = Path(directory)
    if not directory.exists():
        directory = shipped().get(str(directory), directory)
    card = read_card(directory)
    _check_size(directory, card)
    for name, digest in card["files"].items():
        if Path(name).name != name or not (directory / name).is_file():
            raise InputError(f"{directory} lacks its file {name}; save the model again")
        if _digest(directory / name) != digest:
            raise InputError(
                f"{directory / name} is damaged (its checksum differs); save the model again"
            )
    try:
        model = KINDS[card["kind"]].load(directory, card["state"])
        if card["threshold"] is not None:
            model = with_threshold(model, card["threshold"])
    except InputError:
        raise
    except Exception as error:  # whatever a damaged file makes the reader raise
        if isinstance(error, ImportError) and (lacking := missing(error, f"the model {directory}")):
            raise lacking from None
        raise InputError(
            f"cannot read the model in {directory} ({type(error).__name__}: {error}); "
            "save it again with this version of foldlab"
        ) from error
    return model, card


def _check_size(directory: Path, card: dict) -> None:
    """Raises :class:`InputError` for files that would unpack to more than :data:`MOST_BYTES`."""
    size = 0
    for name in card["files"]:
        path = directory / Path(name).name
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                size += sum(member.file_size for member in archive.infolist())
        elif path.is_file():
            size += path.stat().st_size
    if size > MOST_BYTES:
        raise InputError(
            f"the model in {directory} holds {size / 1e9:.3g} GB; at most {MOST_BYTES / 1e9:g} "
            "are read"
        )


def read_card(directory: str | Path) -> dict:
    """The content of ``model.json``, checked; does not read the model itself."""
    path = Path(directory) / CARD
    if path.is_file() and path.stat().st_size > MOST_BYTES // 10:
        raise InputError(f"{path} is larger than {MOST_BYTES / 1e10:g} GB")
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(
            f"no model in {directory} (no {CARD}); give a directory written by save_model"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path} ({error}); save the model again") from None
    if not isinstance(card, dict) or not (
        {"format", "kind", "threshold"} <= set(card)
        and isinstance(card.get("space"), str | None)
        and all(isinstance(card.get(name), dict) for name in ("state", "files", "metadata"))
    ):
        raise InputError(f"{path} does not describe a model; save the model again")
    if card["format"] != FORMAT or card["kind"] not in list(KINDS):
        raise InputError(
            f"{path} has format {card['format']!r}, kind {card['kind']!r}; this version reads "
            f"format {FORMAT} with kinds {', '.join(KINDS)}"
        )
    return card


def space_of_model(model) -> DesignSpace | None:
    """The space whose groups a classifier reads; None where it takes plain numbers."""
    if isinstance(model, FixedThresholdClassifier):
        model = getattr(model, "estimator_", model.estimator)
    if hasattr(model, "steps"):
        model = model[0]
    return getattr(model, "space", None)


def space_to_json(space: DesignSpace | None) -> dict | None:
    """A design space, bounds included, as plain JSON; :func:`space_from_json` reads it."""
    return None if space is None else {"name": space.name, "parameters": _parameters(space)}


def space_from_json(state: dict | None) -> DesignSpace | None:
    if state is None:
        return None
    return DesignSpace(state["name"], tuple(Parameter(**p) for p in state["parameters"]))


def _parameters(space):
    return [asdict(p) for p in space]


def _save_sklearn(model, directory: Path) -> dict:
    path = directory / "model.skops"
    try:
        skops.io.dump(model, path, compression=zipfile.ZIP_DEFLATED)
    except TypeError as error:
        raise InputError(
            f"skops cannot write this {type(model).__name__} ({error}); "
            "keep to the models of foldlab.learning.models"
        ) from None
    strangers = set(skops.io.get_untrusted_types(file=path)) - TRUSTED
    if strangers:
        raise InputError(
            "the model holds types that would not be loaded again: "
            f"{', '.join(sorted(strangers))}; keep to the models of foldlab.learning.models"
        )
    return {}


def _load_sklearn(directory: Path, state: dict):
    path = directory / "model.skops"
    strangers = set(skops.io.get_untrusted_types(file=path)) - TRUSTED
    if strangers:
        raise InputError(
            f"{path} holds types that are not trusted: {', '.join(sorted(strangers))}; "
            "load only models that foldlab saved"
        )
    model = skops.io.load(path, trusted=sorted(TRUSTED))
    check_trees(model)
    return model


def _is_network(model) -> bool:
    # By name, so that trees are saved without importing torch.
    return any(base.__name__ == "NetworkClassifier" for base in type(model).__mro__)


def _save_network(model, directory: Path) -> dict:
    import torch

    module = model.module_.eval()
    columns = len(module.centre)
    example = torch.ones(2, columns, dtype=torch.float64)
    designs = torch.export.Dim("designs")
    program = torch.export.export(module, (example,), dynamic_shapes=({0: designs},))
    # By way of memory: torch's own writer ends the process where the disk is full.
    archive = io.BytesIO()
    torch.export.save(program, archive)
    (directory / "network.pt2").write_bytes(archive.getbuffer())
    weights = {name: value.numpy() for name, value in module.state_dict().items()}
    np.savez(directory / "weights.npz", **weights)
    parameters = {k: v for k, v in model.get_params(deep=False).items() if k != "space"}
    return {
        "class": type(model).__name__,
        "parameters": parameters,
        "space": space_to_json(model.space),
        "n_features": model.n_features_in_,
        "inputs": columns,
        "columns": getattr(model, "feature_names_in_", None),
        "classes": model.classes_,
        "classes_dtype": model.classes_.dtype.str,
        "loss_curve": model.loss_curve_,
        "n_labels": model.n_labels_,
        "random_state": model.rng_state_.numpy().tobytes().hex(),
    }


def _load_network(directory: Path, state: dict):
    import torch

    from foldlab.learning import network

    known = {c.__name__: c for c in (network.SmoothNetwork, network.DissertationNetwork)}
    if state["class"] not in known:
        raise InputError(f"no network {state['class']!r}; there are: {', '.join(known)}")
    parameters = {k: tuple(v) if isinstance(v, list) else v for k, v in state["parameters"].items()}
    model = known[state["class"]](space_from_json(state["space"]), **parameters)
    with np.load(directory / "weights.npz", allow_pickle=False) as archive:
        weights = {name: torch.from_numpy(archive[name].copy()) for name in archive.files}
    layers = (state["n_features"], *np.atleast_1d(parameters["hidden"]))
    if max(*layers, parameters.get("members", 1)) > sum(w.numel() for w in weights.values()):
        raise InputError(f"the network of {directory} is larger than its weights are many")
    with torch.random.fork_rng(devices=[]):  # building draws start values that are overwritten
        module = model.build(state.get("inputs", state["n_features"]))
    module.load_state_dict(weights)
    model.module_ = module.eval()
    model.n_features_in_ = state["n_features"]
    if state["columns"] is not None:
        model.feature_names_in_ = np.array(state["columns"], dtype=object)
    model.classes_ = np.array(state["classes"], dtype=np.dtype(state["classes_dtype"]))
    model.loss_curve_ = state["loss_curve"]
    model.n_epochs_ = len(model.loss_curve_)
    model.n_labels_ = state["n_labels"]
    model.optimizer_ = None  # the moments of Adam start anew after loading
    random_state = np.frombuffer(bytes.fromhex(state["random_state"]), dtype=np.uint8)
    model.rng_state_ = torch.from_numpy(random_state.copy())
    return model


def _is_formula(model) -> bool:
    return type(model).__name__ == "SymbolicClassifier"


def _save_formula(model, directory: Path) -> dict:
    chosen = model.formula_
    (directory / "formula.py").write_text(chosen.python(), encoding="utf-8")
    formulas = list(model.front_["formula"])
    return {
        "formula": str(chosen),
        "latex": chosen.latex(),
        "inputs": list(chosen.inputs),
        "seen": model.inputs,
        "margin": model.margin,
        "front": [
            {"error": float(error), "tree": f.tree}
            for error, f in zip(model.front_["error"], formulas, strict=True)
        ],
        "chosen": formulas.index(chosen),
        "space": space_to_json(model.space),
        "threshold": model.threshold,
        "scale": model.scale_,
    }


def _load_formula(directory: Path, state: dict):
    from foldlab.learning.symbolic.estimators import SymbolicClassifier
    from foldlab.learning.symbolic.formula import Formula

    def tree(node):
        return tuple(tree(part) for part in node) if isinstance(node, list) else node

    inputs = tuple(state["inputs"])
    front = [(row["error"], Formula(tree(row["tree"]), inputs)) for row in state["front"]]
    # Formulas of older versions see groups and are for the angle itself.
    told = {"margin": state.get("margin", False), "inputs": state.get("seen", "groups")}
    space = space_from_json(state["space"])
    model = SymbolicClassifier(space, threshold=state["threshold"], **told)
    return model.restore(front, state["chosen"], state["scale"])


# The first that matches is taken.
KINDS: dict[str, Kind] = {
    "formula": Kind(_is_formula, _save_formula, _load_formula),
    "network": Kind(_is_network, _save_network, _load_network),
    "sklearn": Kind(lambda m: isinstance(m, BaseEstimator), _save_sklearn, _load_sklearn),
}


def check_target(target: Path, overwrite: bool) -> None:
    """That a model may go to ``target``; raises :class:`InputError` as :func:`save_model` does."""
    if not target.exists() and not target.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{target} exists; choose another folder, or overwrite it (--overwrite)")
    if not (target.is_dir() and (target / CARD).is_file()):
        raise InputError(f"{target} exists and holds no model; it is left alone: move it away")


def _put(fresh: Path, target: Path) -> None:
    if not target.exists():
        os.rename(fresh, target)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}-old-", dir=target.parent))
    os.rename(target, old / "model")
    try:
        os.rename(fresh, target)
    except OSError:
        os.rename(old / "model", target)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _plain(value):
    """JSON values only: numpy scalars and arrays unpacked, NaN and infinities as null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int | bool):
        return value
    raise InputError(f"{type(value).__name__} in the metadata; expected plain JSON values")
