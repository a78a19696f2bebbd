"""From a table of labels to a fitted, scored model with its operating point."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

import pandas as pd
from sklearn.model_selection import train_test_split

from foldlab.design import DesignSpace, space_of
from foldlab.errors import InputError
from foldlab.learning.conformal import borders_of, check_enough, measured
from foldlab.learning.features import as_labels, probability_of_folding
from foldlab.learning.models import AngleRegressor, make_classifier
from foldlab.learning.operating_point import at_rate, check_calibration
from foldlab.learning.physics import default_inputs
from foldlab.learning.scoring import angle_errors, calibration_error, model_size, score

DEFAULT_LABELS = 6000
ANGLE = "angle"
HOLDOUT = 0.2
PARTS = ("train", "validation", "test")


def known_labels(table: pd.DataFrame, space: DesignSpace) -> tuple[pd.DataFrame, int]:
    """The groups (checked) and ``foldable`` of the designs whose label is known; and how many not.

    Raises :class:`InputError` if the column ``foldable`` is missing, no label is known, or the
    table mixes what the groups don't tell apart: kinds of growth, solid layers and ones cut in
    strips.
    """
    kinds = table["growth"].value_counts() if "growth" in table else ()
    if len(kinds) > 1:
        told = " and ".join(f"{n} labels of {growth} growth" for growth, n in kinds.items())
        raise InputError(
            f"the table mixes {told}, and the groups of a design don't tell them apart; take one, "
            "as in load_dataset(name, growth='uniaxial')"
        )
    solid = "strips" not in space.names
    if "strips" in table and (other := (table["strips"] > 0) == solid).any():
        raise InputError(
            f"the active layers of {int(other.sum())} of {len(table)} designs are "
            f"{'cut in strips' if solid else 'solid'}, which the {space.name} space doesn't know; "
            "take one kind, as in load_dataset(name, space='full')"
        )
    if "foldable" not in table:
        raise InputError(
            f"the table has no column foldable; it has {', '.join(map(str, table.columns))}; "
            "label the designs first with `foldlab label` and `foldlab export`"
        )
    known = table[table["foldable"].notna()]
    if len(known) == 0:
        raise InputError("no design in the table has a known label; label more designs")
    out = space.validate(known)
    out["foldable"] = as_labels(known["foldable"])
    return out, len(table) - len(known)


def train_on(
    table: pd.DataFrame,
    name: str,
    *,
    seed: int,
    holdout: float | None = None,
    rate: float | None = None,
    coverage: float | None = None,
    options: dict[str, Any] | None = None,
) -> tuple[Any, dict[str, Any]]:
    """Train the model ``name`` on a table of labels; returns it with what was measured.

    The model "angle" learns fold angles (:func:`fit_angle`), all others whether a design folds.

    The fraction ``holdout`` of the labels, a fifth where nothing is said, is kept out of the
    training to score the model. With ``rate`` half of it chooses the threshold for this
    false-positive rate and the other half scores the result, so that no design is used twice. With
    ``coverage`` that half also chooses between which probabilities the model doesn't know
    (:mod:`foldlab.learning.conformal`); ``borders`` says it. Where the table knows the parts
    "train", "validation" and "test" and no holdout is given, these are what trains, chooses and
    scores; ``split`` says which it was.

    Raises :class:`InputError` for a bad table, an unknown model or option, or, before it trains,
    too few labels for the holdout, the rate or the coverage.
    """
    if holdout is not None and not 0 < holdout < 1:
        raise InputError(f"holdout = {holdout:g}; expected a fraction between 0 and 1")
    space = space_of(table)
    if name == ANGLE:
        if rate is not None or coverage is not None:
            raise InputError(
                "the model angle says an angle and no probability: it takes neither a "
                "false-positive rate nor a coverage; take another model for these"
            )
        return _train_on_angles(table, space, seed, holdout, options or {})
    known, unknown = known_labels(table, space)
    for column in ("normalised_angle", "threshold"):
        if column in table:
            known[column] = table[column]
    counts = known["foldable"].value_counts()
    if len(counts) < 2 or counts.min() < 5:
        raise InputError(
            f"{int(known['foldable'].sum())} of {len(known)} designs fold; training needs at least "
            "5 of each kind: label more designs"
        )
    chooses = rate is not None or coverage is not None
    training, calibration, held, split = _divided(known, table, holdout, seed, chooses)
    if rate is not None:
        check_calibration(calibration["foldable"], rate=rate)
    if coverage is not None:
        check_enough(calibration["foldable"], coverage=coverage)
    start = time.perf_counter()
    model = fit(name, space, training, seed=seed, **(options or {}))
    seconds = time.perf_counter() - start
    point, borders, answers = None, None, {}
    if coverage is not None:
        probability = probability_of_folding(model, calibration[space.names])
        borders = borders_of(probability, calibration["foldable"], coverage=coverage)
        answers = measured(model, borders, held[space.names], held["foldable"])
    if rate is not None:
        model, point = at_rate(model, calibration[space.names], calibration["foldable"], rate=rate)
    size, unit = model_size(model)
    X, y = held[space.names], held["foldable"]
    return model, {
        "model": name,
        "space": space.name,
        "inputs": default_inputs(space, (options or {}).get("inputs")),
        "seed": seed,
        "split": split,
        "labels": len(training),
        "calibration_labels": len(calibration) if point or borders else 0,
        "threshold": point.threshold if point else None,
        "unknown": unknown,
        "train_seconds": seconds,
        "size": size,
        "size_unit": unit,
        "borders": asdict(borders) if borders else None,
        "bounds": bounds_of(training, space),
        **{f"holdout_{k}": v for k, v in answers.items()},
        "holdout_calibration_error": calibration_error(probability_of_folding(model, X), y),
        **{f"holdout_{k}": v for k, v in score(model, X, y).items()},
    }


def _train_on_angles(table, space, seed, holdout, options) -> tuple[Any, dict[str, Any]]:
    known, missing = known_angles(table, space)
    if holdout is None and (parts := _parts(known, table)):
        training, _, held, split = *parts, "parts"
    else:
        holdout, split = HOLDOUT if holdout is None else holdout, "random"
        n = round(holdout * len(known))
        if n < 2 or len(known) - n < 20:
            raise InputError(
                f"{len(known)} designs have a fold angle; a holdout of {holdout:g} and a training "
                "of 20 need more: label more designs"
            )
        training, held = train_test_split(known, test_size=n, random_state=seed)
    start = time.perf_counter()
    model = fit_angle(space, training, seed=seed, **options)
    seconds = time.perf_counter() - start
    size, unit = model_size(model)
    errors = angle_errors(model, held[space.names], held["fold_angle"])
    return model, {
        "model": ANGLE,
        "space": space.name,
        "inputs": default_inputs(space, options.get("inputs")),
        "seed": seed,
        "split": split,
        "labels": len(training),
        "without_angle": missing,
        "task": ANGLE,
        "bounds": bounds_of(training, space),
        "train_seconds": seconds,
        "size": size,
        "size_unit": unit,
        **{f"holdout_{k}": v for k, v in errors.items()},
    }


def bounds_of(table: pd.DataFrame, space: DesignSpace) -> dict[str, list[float]]:
    """Least and largest value of each group in a table."""
    return {name: [float(table[name].min()), float(table[name].max())] for name in space.names}


def known_angles(table: pd.DataFrame, space: DesignSpace) -> tuple[pd.DataFrame, int]:
    """The groups (checked) and ``fold_angle`` (rad) of the designs of known label, and how many of
    the others there are.

    Raises :class:`InputError` if there are none at all.
    """
    if "fold_angle" not in table:
        raise InputError(
            f"the table has no column fold_angle; it has {', '.join(map(str, table.columns))}; "
            "label with a source that states it, in the full space"
        )
    has = table["fold_angle"].notna()
    if "foldable" in table:
        known_labels(table, space)  # for what it refuses
        # A path that did not end has an angle on its way.
        has &= table["foldable"].notna()
    known = table[has]
    if len(known) == 0:
        raise InputError("no design in the table has a fold angle; label more designs")
    return space.validate(known).assign(fold_angle=known["fold_angle"].astype(float)), int(
        (~has).sum()
    )


def fit_angle(space: DesignSpace, labels: pd.DataFrame, *, seed: int, **options) -> AngleRegressor:
    """An :class:`foldlab.learning.models.AngleRegressor`, fitted to the column ``fold_angle``.

    Raises :class:`InputError` for an unknown option.
    """
    model = AngleRegressor(space, random_state=seed)
    known = sorted(set(model.get_params(deep=False)) - {"space", "random_state"})
    for option in options:
        if option not in known:
            raise InputError(
                f"model {ANGLE!r} has no setting {option!r}; it has: {', '.join(known)}"
            )
    return model.set_params(**options).fit(labels[space.names], labels["fold_angle"])


def _parts(known: pd.DataFrame, table: pd.DataFrame) -> list[pd.DataFrame] | None:
    """Training, validation and test as the table names them; None where it doesn't."""
    if "part" not in table or not set(PARTS) <= set(table.loc[known.index, "part"]):
        return None
    return [known[table.loc[known.index, "part"] == part] for part in PARTS]


def _divided(known, table, holdout: float | None, seed: int, chooses: bool):
    """What trains, what chooses (None unless it is asked for) and what scores, and by what."""
    if holdout is None and (parts := _parts(known, table)):
        poor = [n for n, part in zip(PARTS, parts, strict=True) if part["foldable"].nunique() < 2]
        if poor:
            raise InputError(
                f"all labels of the part {poor[0]} say the same; label more designs, or let a "
                "fraction be held out instead (holdout)"
            )
        return parts[0], parts[1] if chooses else None, parts[2], "parts"
    holdout = HOLDOUT if holdout is None else holdout
    training, held = _split(known, holdout, seed, f"training and a holdout of {holdout:g}")
    calibration = None
    if chooses:
        calibration, held = _split(held, 0.5, seed, "choosing the threshold and scoring it")
    return training, calibration, held, "random"


def _split(table, fraction: float, seed: int, uses: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The table in two parts, both of which hold both kinds."""
    folds = table["foldable"]
    n, parts = round(fraction * len(table)), ()
    if 2 <= n <= len(table) - 2 and 2 <= folds.sum() <= len(table) - 2:
        parts = train_test_split(table, test_size=n, random_state=seed, stratify=folds)
    if not parts or any(part["foldable"].nunique() < 2 for part in parts):
        raise InputError(
            f"{int(folds.sum())} of {len(table)} labels fold: too few of a kind for {uses}, each "
            "of which needs both; label more designs or change the holdout"
        )
    return parts


def default_classifier(source, *, seed: int, labels: int = DEFAULT_LABELS):
    """A network trained on fresh labels of a source that is a formula.

    Raises :class:`InputError` for a slow source, whose labels should not be spent unasked.
    """
    if not hasattr(source, "evaluate"):
        raise InputError(
            f"the source {source.name!r} is no formula: label designs with it, train a model with "
            "`foldlab train` and give its folder as --model"
        )
    table = source.evaluate(source.space.sample(labels, seed=seed))
    return fit("network", source.space, table, seed=seed)


def fit(name: str, space: DesignSpace, labels: pd.DataFrame, *, seed: int, **options):
    """A fitted model of this name on a table of labels; designs of unknown label are left out.

    Raises :class:`InputError` if no label is known, or if the symbolic model finds no column
    ``normalised_angle``.
    """
    known = labels[labels["foldable"].notna()]
    if len(known) == 0:
        raise InputError("no design in the table has a known label; label more designs")
    model = make_classifier(name, space, seed=seed, **options)
    target = as_labels(known["foldable"])
    if name == "symbolic":
        if "normalised_angle" not in known:
            raise InputError(
                "the symbolic model learns the angle per unit strain, and the table has no column "
                "normalised_angle; label with a source that states it, or take another model"
            )
        # A label may say that a design does not fold and state no angle.
        known = known[known["normalised_angle"].notna()]
        angle = known["normalised_angle"].to_numpy(float)
        if "threshold" in known:
            model.set_params(threshold=float(known["threshold"].iloc[0]))
        # A sheet that sags turns the other way, and an angle below 0 has no log.
        model.set_params(margin=bool((angle <= 0).any()))
        return model.fit(known[space.names], angle)
    return model.fit(known[space.names], target)


def symbolic_options(seconds: float, seed: int) -> dict[str, dict[str, Any]]:
    """Settings of the symbolic model for a time budget."""
    from foldlab.learning.symbolic.engines import Constraints

    return {"symbolic": {"constraints": Constraints(seconds=seconds, seed=seed)}}
