"""Search over the network's architecture and loss bias: accuracy against training seconds.

One Optuna study (TPE) with two objectives, kept in a journal file that several worker processes
share and that a later call resumes. Optuna's pruners know one objective only, so the rule is ours:
a trial stops after its first quarter where it is both slower and less accurate than the median of
the trials before it, that is where it can't be heading for the Pareto front.
"""

from __future__ import annotations

import multiprocessing
import os
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import train_test_split
from threadpoolctl import threadpool_limits

from foldlab.design import DesignSpace
from foldlab.errors import InputError
from foldlab.learning.features import as_labels
from foldlab.learning.models import make_classifier
from foldlab.learning.scoring import score
from foldlab.packaged import needed_for

with needed_for("a search"):
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
    from optuna.trial import TrialState

STUDY = "network"
ENDED = (TrialState.COMPLETE, TrialState.PRUNED)


@dataclass(frozen=True)
class Search:
    """Size and range of a study; intervals are (low, high)."""

    trials: int = 40
    workers: int = 1
    seed: int = 0
    validation: float = 0.25
    epochs: tuple[int, int] = (200, 3000)
    width: tuple[int, int] = (4, 48)
    depth: tuple[int, int] = (1, 3)
    members: tuple[int, int] = (1, 6)
    penalty: tuple[float, float] = (1e-6, 1e-3)
    false_positive_weight: tuple[float, float] = (1.0, 8.0)
    warm_up: int = 8

    def __post_init__(self):
        for name in ("trials", "workers", "warm_up"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}; expected at least 1")
        if not 0 < self.validation < 1:
            raise InputError(
                f"validation = {self.validation:g}; expected a fraction between 0 and 1"
            )
        for name, (low, high) in self._intervals().items():
            if not 0 < low <= high < np.inf:
                raise InputError(f"{name} = {low:g} … {high:g}; expected 0 < low ≤ high < ∞")

    def _intervals(self) -> dict[str, tuple[float, float]]:
        return {k: v for k, v in asdict(self).items() if isinstance(v, tuple)}


def tune(labels: pd.DataFrame, space: DesignSpace, journal: str | Path, search: Search):
    """Run (or resume) the study until it holds ``search.trials`` ended trials.

    Several workers may end it with a few more: each finishes the trial it is at.

    ``labels`` has the groups and ``foldable``; ``search.validation`` of them are held back to
    measure accuracy. Returns a table with one row per trial: the parameters, ``state``
    (complete or pruned), ``accuracy`` and ``false_positive_rate`` on the validation designs,
    ``seconds`` (processor time of the training), and ``on_front``. Which trial comes next depends
    on measured seconds: a seed fixes the first draws, not the whole study.
    """
    known = labels[labels["foldable"].notna()]
    X, y = space.validate(known), as_labels(known["foldable"])
    counts = np.bincount(y, minlength=2)
    if counts.min() < 4:
        raise InputError(
            f"{counts[1]} designs fold and {counts[0]} do not; a study needs at least 4 of each"
        )
    split = train_test_split(
        X, y, test_size=search.validation, random_state=search.seed, stratify=y
    )
    journal = Path(journal)
    if not journal.parent.is_dir():
        raise InputError(f"no folder {journal.parent} for the journal; make it first")
    study = open_study(journal, search.seed)
    ended = len(study.get_trials(states=ENDED))
    if ended < search.trials:
        job = partial(_work, str(journal), split, space, search)
        if search.workers == 1:
            job(0)
        else:
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(search.workers, mp_context=context) as pool:
                list(pool.map(job, range(search.workers)))
    return trials_table(open_study(journal, search.seed))


def open_study(journal: Path, seed: int) -> optuna.Study:
    """The study in a journal file, made if it is not there."""
    # Open-and-create locks work on the network file systems that symbolic links fail on.
    lock = JournalFileOpenLock(str(journal))
    try:
        _drop_cut_line(journal, lock)
        storage = JournalStorage(JournalFileBackend(str(journal), lock_obj=lock))
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        return optuna.create_study(
            study_name=STUDY,
            storage=storage,
            sampler=optuna.samplers.TPESampler(seed=seed),
            directions=["maximize", "minimize"],
            load_if_exists=True,
        )
    except Exception as error:  # whatever a damaged file makes Optuna raise
        raise InputError(
            f"{journal} is no journal of a study ({type(error).__name__}: {error}); move it away "
            "to start afresh"
        ) from None


def _drop_cut_line(journal: Path, lock: JournalFileOpenLock) -> None:
    """Takes away a last line that a full disk or a killed process left unfinished."""
    if not journal.is_file():
        return
    lock.acquire()
    try:
        text = journal.read_bytes()
        if text and not text.startswith(b'{"op_code":'):
            raise ValueError("it does not begin as one")  # Optuna would append to it
        if not text.endswith(b"\n"):
            os.truncate(journal, text.rfind(b"\n") + 1)
    finally:
        lock.release()


def _work(journal: str, split, space: DesignSpace, search: Search, worker: int) -> None:
    study = open_study(Path(journal), search.seed + worker)
    enough = optuna.study.MaxTrialsCallback(search.trials, states=ENDED)
    with threadpool_limits(1), warnings.catch_warnings():
        # A budget of epochs is a parameter of the search; short ones do not converge.
        warnings.simplefilter("ignore", ConvergenceWarning)
        study.optimize(lambda trial: _objective(trial, split, space, search), callbacks=[enough])


def _objective(trial: optuna.Trial, split, space, search: Search) -> tuple[float, float]:
    X, X_validation, y, y_validation = split
    suggest: dict[str, Callable] = {
        "epochs": partial(trial.suggest_int, log=True),
        "width": partial(trial.suggest_int, log=True),
        "depth": trial.suggest_int,
        "members": trial.suggest_int,
        "penalty": partial(trial.suggest_float, log=True),
        "false_positive_weight": partial(trial.suggest_float, log=True),
    }
    p = {name: call(name, *getattr(search, name)) for name, call in suggest.items()}
    quarter = max(1, p["epochs"] // 4)
    model = make_classifier(
        "network",
        space,
        hidden=(p["width"],) * p["depth"],
        members=p["members"],
        penalty=p["penalty"],
        epochs=quarter,
        false_positive_weight=p["false_positive_weight"],
        seed=search.seed,
    )
    start = time.process_time()
    model.fit(X, y)
    seconds = time.process_time() - start
    early = float(np.mean(model.predict(X_validation) == y_validation))
    before = [t.user_attrs for t in trial.study.get_trials(deepcopy=False, states=ENDED)]
    trial.set_user_attr("early_accuracy", early)
    trial.set_user_attr("early_seconds", seconds)
    if can_not_reach_the_front(early, seconds, before, search.warm_up):
        raise optuna.TrialPruned
    start = time.process_time()
    if p["epochs"] > quarter:
        model.continue_fit(X, y, epochs=p["epochs"] - quarter)
    seconds += time.process_time() - start
    result = score(model, X_validation, y_validation)
    trial.set_user_attr("false_positive_rate", result["false_positive_rate"])
    return result["accuracy"], seconds


def can_not_reach_the_front(
    accuracy: float, seconds: float, before: list[dict], warm_up: int
) -> bool:
    """The pruning rule: slower and less accurate than the median after the first quarter."""
    seen = [t for t in before if "early_accuracy" in t]
    if len(seen) < warm_up:
        return False
    return accuracy < np.median([t["early_accuracy"] for t in seen]) and seconds > np.median(
        [t["early_seconds"] for t in seen]
    )


def trials_table(study: optuna.Study) -> pd.DataFrame:
    """One row per ended trial; see :func:`tune`."""
    front = {trial.number for trial in study.best_trials}
    rows = []
    for trial in study.get_trials(states=ENDED):
        complete = trial.state is TrialState.COMPLETE
        accuracy, seconds = trial.values if complete else (np.nan, np.nan)
        rows.append(
            {
                "trial": trial.number,
                "state": trial.state.name.lower(),
                **trial.params,
                "accuracy": accuracy,
                "false_positive_rate": trial.user_attrs.get("false_positive_rate", np.nan),
                "seconds": seconds,
                "on_front": trial.number in front,
            }
        )
    return pd.DataFrame(rows)
