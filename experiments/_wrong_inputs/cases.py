"""Wrong inputs by number: one for each seed and number, over every verb and every kind of file.

Each starts from a line that is right (:data:`LINES`) and has one thing wrong.
"""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foldlab.design import FULL, REDUCED

from . import damage
from .damage import pick

GROUPS = {
    "E_ratio": 0.1, "h_ratio": 5, "hinge_length": 0.25, "aspect": 0.2, "slenderness": 4e-3,
    "contraction": 0.3, "stiffness_to_weight": 1,
}  # fmt: skip
UNIT = " ".join(f"--set {name}={value}" for name, value in GROUPS.items())
SIZES = {
    "l_s": "40mm", "b_s": "10mm", "h_s": "0.1mm", "h_i": "0.2mm", "l_i": "10mm",
    "contraction": "20%",
}  # fmt: skip
MADE = " ".join(f"--set {name}={value}" for name, value in SIZES.items())
QUICK = (
    "--set n_train=300 --set n_test=60 --set n_fresh=90 --set map_points=90 --set unit=false "
    "--set proposals=0 --set verify=0"
)
# What is called, and what it reads.
LINES = {
    "sample": ("sample -n 9 -o o.csv", ()),
    "label": ("label d.csv -o o.db", ("d.csv",)),
    "label parquet": ("label d.parquet -o o.db", ("d.parquet",)),
    "label into": ("label d.csv -o s.db", ("d.csv", "s.db")),
    "label solver": ("label f.csv -o o.db --source solver", ("f.csv",)),
    "export": ("export s.db -o o.csv", ("s.db",)),
    "train": ("train l.csv --model tree -o o", ("l.csv",)),
    "train parquet": ("train l.parquet --model tree -o o", ("l.parquet",)),
    "train network": (
        "train l.csv -o o --config c.toml --set members=1 --set hidden=[3]", ("l.csv", "c.toml"),
    ),
    "score": ("score m l.csv", ("m", "l.csv")),
    "predict": ("predict d.csv -o o.csv --model m", ("d.csv", "m")),
    "score network": ("score n l.parquet", ("n", "l.parquet")),
    "map": ("map m -o o.png --points 90", ("m",)),
    "augment": (
        "augment -o o --seeds 1 --set initial=60 --set per_cycle=9 --set cycles=1 "
        "--set epochs=9 --set candidates=99", (),
    ),
    "tune": (
        "tune l.csv -o . --trials 2 --set epochs=[4,8] --set width=[2,4] --set depth=[1,1] "
        "--set members=[1,1]", ("l.csv", "study.journal"),
    ),
    "design": ("design -n 2 --model m --passive paper", ("m",)),
    "design from": (
        "design -n 2 --model m --materials materials.csv --passive paper", ("m", "materials.csv"),
    ),
    "quickstart": (f"quickstart -o o {QUICK}", ()),
    "quickstart tracked": (f"quickstart -o o {QUICK}", ("mlruns",)),
    "simulate": (f"simulate -o o --no-pictures {UNIT}", ()),
    "check": (f"check --quick --passive PET --active SMP {MADE}", ()),
    "check from": (
        f"check --quick --passive PET --active SMP --materials materials.csv {MADE}",
        ("materials.csv",),
    ),
    "materials": ("materials --materials materials.csv", ("materials.csv",)),
    "experiment": ("experiment", ()),
    "experiment tracked": ("experiment", ("mlruns",)),
    "pattern": ("pattern b.csv", ("b.csv",)),
    "pattern ascii": ("pattern ascii.vtu", ("ascii.vtu",)),
    "pattern binary": ("pattern binary.vtu", ("binary.vtu",)),
    "pattern appended": ("pattern appended.vtu", ("appended.vtu",)),
    "mesh": ("mesh unit.msh", ("unit.msh",)),
}  # fmt: skip

NO_INT = ("much", "1.5", "1e3", "nan", "0x10", "2 3", "1,000", "--")
NO_COUNT = (*NO_INT, "0", "-1", "-7", "-99999999999999999999")
NO_FLOAT = ("much", "1,5", "1.2.3", "nan", "two", "-")
NOT_ABOVE_0 = (*NO_FLOAT, "0", "-1", "-1e-9", "-inf")
NO_NAME = ("nosuch", "Reduced_", "", " ", "solver;timoshenko", "..", "ß", "None", "-1", "0")
NO_FOLDER = ("d.csv", "d.csv/x", "/proc/x/y", "x" * 300)
NO_TABLE = ("none/o.csv", "o.txt", "o", "folder.csv", "/proc/o.csv", "x" * 300 + ".csv", "")
NO_PICTURE = ("none/o.png", "o.txt", "o", "folder.png", "/proc/o.png", "o.png.exe", "")
NO_SPACE = tuple(name for name in NO_NAME)
HUGE = ("100000000000", "999999999999999999")
OPTIONS = {
    "sample": {
        "-n": (*NO_COUNT, *HUGE), "-o": NO_TABLE, "--space": NO_SPACE, "--seed": (*NO_INT, "-1"),
        "--optimize": NO_NAME,
    },
    "label": {
        "--source": NO_NAME, "--workers": NO_COUNT, "-o": ("none/o.db", "folder.csv", "d.csv", ""),
        "--dask": ("nowhere", "", "tcp://", "http://[::1"),
    },
    "export": {"-o": NO_TABLE, "--source": NO_NAME},
    "train": {
        "-o": NO_FOLDER, "--model": NO_NAME, "--seed": (*NO_INT, "-1"),
        "--holdout": (*NOT_ABOVE_0, "1", "1.5", "inf"),
        "--false-positive-rate": (*NOT_ABOVE_0, "1", "1.5", "inf", "1e-9"),
        "--coverage": (*NOT_ABOVE_0, "1", "1.5", "inf", "0.9999999"),
    },
    "score": {},
    "predict": {
        "-o": NO_TABLE, "--model": ("none", "d.csv", ".", ""), "--workers": NO_COUNT,
        "--defer": NO_NAME, "--timeout": (*NO_FLOAT[:2], "two"), "--labels": ("none", "d.csv"),
    },
    "map": {
        "--space": (*NO_SPACE, "full"), "--panels": NO_COUNT, "--verify": (*NO_INT, "-1", "3"),
        "-o": NO_PICTURE, "--against": NO_NAME, "--x": (*NO_NAME, "h_ratio", "slenderness"),
        "--y": (*NO_NAME, "E_ratio", "slenderness"), "--slice": (*NO_NAME, "E_ratio", "h_ratio"),
        "--points": (*NO_COUNT, *HUGE),
    },
    "augment": {
        "-o": NO_FOLDER, "--space": NO_SPACE, "--source": NO_NAME, "--seeds": NO_COUNT,
        "--target": (*NOT_ABOVE_0, "1.5", "inf"), "--seed": (*NO_INT, "-1"),
        "--test": ("none.csv", "folder.csv", "d.csv"), "--workers": NO_COUNT,
    },
    "tune": {
        "-o": NO_FOLDER, "--trials": NO_COUNT, "--workers": NO_COUNT, "--seed": (*NO_INT, "-1"),
    },
    "design": {
        "-n": NO_COUNT, "--want": (*NO_NAME, "angle"), "--angle": (*NOT_ABOVE_0, "1"),
        "--tolerance": NOT_ABOVE_0, "--space": (*NO_SPACE, "full"), "--source": NO_NAME,
        "--passive": NO_NAME, "--active": NO_NAME, "--max-mass": NOT_ABOVE_0,
        "--max-length": NOT_ABOVE_0, "--max-width": NOT_ABOVE_0, "--max-thickness": NOT_ABOVE_0,
        "--margin": (*NO_FLOAT, "-1", "0.5", "inf"), "--model": ("none", "d.csv", "."),
        "--materials": ("none.csv", "folder.csv", "l.csv"), "--seed": (*NO_INT, "-1"),
        "--range": (
            "E_ratio", "E_ratio=1", "E_ratio=5:1", "E_ratio=a:b", "nothing=1:2", "=1:2",
            "E_ratio=nan:1", "E_ratio=1:1e9", "E_ratio=1:2:3", "E_ratio=-1:2", "l_s=0:1", "",
        ),
    },
    "quickstart": {"-o": NO_FOLDER, "--seed": (*NO_INT, "-1"), "--workers": NO_COUNT},
    "simulate": {
        "-o": NO_FOLDER, "--growth": NO_NAME, "--question": (*NO_NAME, "exist"),
        "--effects": (*NO_NAME[:2], "ground", "gravity;ground", "gravity,gravel", "none,gravity"),
        "--accuracy": (*NOT_ABOVE_0, "2", "inf"), "--timeout": NOT_ABOVE_0, "--barrier": NO_NAME,
        "--strips": (*NO_INT, "-1", "999999"),
    },
}  # fmt: skip
OPTIONS["check"] = {
    "--passive": (*NO_NAME, "SMP"), "--active": (*NO_NAME, "PET"), "--growth": NO_NAME,
    "--need": (*NOT_ABOVE_0, "90mm", "90 kg", "deg"), "--accuracy": (*NOT_ABOVE_0, "inf"),
    "--timeout": NOT_ABOVE_0, "--materials": ("none.csv", "folder.csv", "l.csv"),
}  # fmt: skip
COUNT = ("much", "1.5", "[1]", "{a=1}", '""', "0", "-1", "-1e9", "nan", "inf", "1979-05-27")
RATIO = ("much", "[1]", "{a=1}", '""', "-1", "nan", "inf", "-inf", "-0.1")
PAIR = ("much", "3", "[1]", "[1,2,3]", "[3,1]", "[-1,3]", '["a","b"]', "[nan,1]", "[1,inf]", "[]")
SETTINGS = {
    "label": {},
    "label solver": {
        "accuracy": (*RATIO, "0", "3"), "timeout": (*RATIO, "0"), "growth": ("3", "up", "[1]", ""),
        "question": ("3", "why", "[1]"), "upright": ("3", "perhaps", "[1]"),
        "strips": ("much", "-1", "1.5", "[1]", "nan"), "refine": ("3", "allways", "[1]"),
        "effects": ("3", "gravel", "[1]", "ground"), "barrier": ("3", "wall"), "space": ("full",),
    },
    "train": {
        "max_depth": COUNT, "min_samples_leaf": COUNT, "ccp_alpha": RATIO,
        "criterion": ("3", "x"), "false_positive_weight": (*RATIO, "0"), "max_features": RATIO,
    },
    "train network": {
        "epochs": COUNT, "members": COUNT, "penalty": RATIO, "rtol": RATIO,
        "hidden": ("much", "[]", "[0]", "[-3]", "[1.5]", '["a"]', "nan", "0"),
        "false_positive_weight": (*RATIO, "0"),
    },
    "map": {
        name: ("much", "[1]", "true", "nan", "inf", "-1", "0", "1e99", '""')
        for name in ("aspect", *REDUCED.names)
    },
    "augment": {
        **{name: COUNT for name in ("initial", "per_cycle", "cycles", "epochs", "candidates")},
        "band": (*PAIR, "[0.6,0.7]", "[0.4,1.5]"),
    },
    "tune": {
        "validation": (*RATIO, "0", "1", "2"), "warm_up": COUNT, "trials": ("much", "[1]"),
        **{name: PAIR for name in ("epochs", "width", "depth", "members")},
        "penalty": PAIR, "false_positive_weight": PAIR,
    },
    "design": {
        "slenderness": ("much", "[1]", "true", "nan", "inf", "-1", "0", "1e99"),
        "l_s": ("much", "[1]", "true", "nan", "inf", "-1", "0"),
    },
    "quickstart": {
        **{name: COUNT for name in ("n_train", "n_test", "n_fresh", "map_points")},
        **{name: ("much", "1.5", "[1]", "-1", "nan") for name in ("proposals", "verify")},
        "symbolic_seconds": (*RATIO, "0"), "seed": ("much", "1.5", "[1]", "-1", "nan"),
        "models": ("tree", "3", "[]", '["nosuch"]', "[3]"),
    },
    "simulate": {
        name: ("much", "[1]", "true", "nan", "inf", "-1", "1e99", '""', "-1e-9")
        for name in (*GROUPS, "rho_ratio", "hinge_width")
    },
    "check": {
        name: (
            "much", "[1]", "true", "nan", "inf", "-1", "0", '""', "3kg", "3mm mm", "1e999mm",
            "9**9mm", "mm", "1;mm", "5 % %",
        )
        for name in (*SIZES, "E_s", "rho_i")
    },
    "experiment": {"size": COUNT, "ratio": (*RATIO, "0"), "seed": ("much", "1.5", "[1]", "nan")},
}  # fmt: skip
NO_SETTING = ("nothing=1", "=1", "epochs", "", "==", "a b=1", " =", "nothing.at=1", "Epochs_=3")
DESIGNS = damage.table_damage(REDUCED.names)
LABELS = damage.table_damage(["foldable"], ("perhaps", "2", "-1", "0.5", "x", "\x00", "1e99"))
FIELD = damage.table_damage(["x", "y", "z", "beta"], ("", "nan", "inf", *damage.NO_NUMBER))
MATERIAL = (damage.strange_bytes, damage.foreign, damage.missing, damage.folder)
PARQUET = (*damage.parquet_damage(REDUCED.names), damage.cut, damage.foreign, *damage.ANY)
VTU = (damage.vtu_changed, damage.cut, damage.flipped, damage.strange_bytes, *damage.ANY)
FILES = {
    "f.csv": damage.table_damage(FULL.names),
    "d.csv": (*DESIGNS, *DESIGNS, damage.strange_bytes, *damage.ANY),
    "l.csv": (*DESIGNS, *LABELS, damage.strange_bytes, *damage.ANY),
    "d.parquet": PARQUET,
    "l.parquet": PARQUET,
    "s.db": (damage.store_changed, damage.cut, damage.flipped, *damage.ANY[:2], damage.folder),
    "c.toml": (damage.toml_changed, damage.toml_changed, damage.strange_bytes, *damage.ANY[1:]),
    "study.journal": (damage.journal_changed, damage.foreign, damage.folder),
    "materials.csv": MATERIAL,
    "b.csv": (*FIELD, damage.strange_bytes, *damage.ANY),
    "unit.msh": (damage.mesh_changed, damage.mesh_changed, damage.cut, *damage.ANY),
    # A digit that becomes another one in text is nothing that a reader could see.
    "ascii.vtu": [way for way in VTU if way != damage.flipped],
    "binary.vtu": VTU,
    "appended.vtu": VTU,
}
# Damage that may be where nobody looks, or be the same to a reader.
RANDOM = (
    damage.flipped, damage.cut, damage.strange_bytes, damage.vtu_changed, damage.card_changed,
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """``line``: of :data:`LINES`; ``kind`` of what is wrong, ``what`` it is, and the arguments.

    ``random``: whether the damage may be one that changes no answer.
    """

    line: str
    kind: str
    what: str
    arguments: tuple[str, ...]
    random: bool = False


def make(seed: int, number: int, good: Path, here: Path) -> Case:
    """The case of this number, its files in the empty folder ``here``."""
    rng = np.random.default_rng([seed, number])
    line = str(rng.choice(list(LINES), p=_WEIGHTS))
    text, files = LINES[line]
    copy(good, here, {*files, "d.csv", "l.csv"})
    for name in ("folder.csv", "folder.png"):
        (here / name).mkdir()
    arguments = shlex.split(text)
    ways = {"option": OPTIONS.get(line), "setting": SETTINGS.get(line), "file": files}
    ways["usage"] = line in OPTIONS
    kind = pick(rng, [name for name, way in ways.items() if way])
    way = {"option": _option, "setting": _setting, "usage": _usage, "file": _file}[kind]
    what, arguments, *random = way(rng, line, arguments, here)
    return Case(line, kind, what, tuple(arguments), *random)


def copy(good: Path, here: Path, names) -> None:
    for name in names:
        to = shutil.copytree if (good / name).is_dir() else shutil.copyfile
        to(good / name, here / name)


def _option(rng, line, arguments, here):
    name = pick(rng, list(OPTIONS[line]))
    value = pick(rng, OPTIONS[line][name])
    if line == "design" and name == "--angle":
        # An angle goes with --want angle; 1 alone is wrong for want of that.
        arguments += [] if value == "1" else ["--want", "angle"]
    if name == "--tolerance":
        arguments += ["--want", "angle", "--angle", "1"]
    if name in arguments:
        arguments[arguments.index(name) + 1] = value
    else:
        arguments += [name, value]
    return f"{name} {value!r}", arguments


def _setting(rng, line, arguments, here):
    names = list(SETTINGS[line])
    if not names or rng.integers(6) == 0:
        pair = pick(rng, NO_SETTING)
    else:
        name = pick(rng, names)
        pair = f"{name}={pick(rng, SETTINGS[line][name])}"
        if line == "simulate" and rng.integers(4) == 0 and name in GROUPS:
            at = next(k for k, a in enumerate(arguments) if a.startswith(f"{name}="))
            return f"without {name}", arguments[: at - 1] + arguments[at + 1 :]
    return f"--set {pair}", [*arguments, "--set", pair]


def _usage(rng, line, arguments, here):
    how = int(rng.integers(6))
    if how == 0:
        word = "".join(rng.choice(list("abcdefghijklmnopqrstuvwxyz-_"), size=rng.integers(2, 9)))
        return "an unknown option", [*arguments, f"--x{word}", "3"]
    if how == 1:
        return "one argument too many", [*arguments, "more.csv"]
    if how == 2:
        return "an option without its value", [*arguments, "--set"]
    if how == 3:
        return "another verb", [
            arguments[0] + pick(rng, ["s", "x", " ", "_"]),
            *arguments[1:],
        ]
    if how == 4:
        config = pick(rng, ["none.toml", "folder.csv", "d.csv"])
        takes = line not in ("sample", "export", "score", "predict")
        return f"--config {config}", [*arguments, "--config" if takes else "--set", config]
    # Without its input, or where there is none without an output, a model or a group.
    drop = slice(2, 4) if line == "design" else slice(1, 3)
    if line in ("augment", "simulate", "quickstart", "design", "check"):
        return "a group too many", [*arguments, "--set", f"nothing{rng.integers(99)}=1"]
    return "without an argument", [
        a for k, a in enumerate(arguments) if k not in range(drop.start, drop.stop)
    ]


def _file(rng, line, arguments, here):
    name = pick(rng, LINES[line][1])
    path = here / name
    if name in ("m", "n"):
        files = sorted(p for p in path.iterdir() if p.suffix != ".pt2")
        path = files[int(rng.integers(len(files)))]
        ways = (damage.missing, damage.folder, damage.cut, damage.flipped)
        if path.name == "model.json":
            ways = (
                damage.card_changed,
                damage.card_changed,
                damage.missing,
                damage.foreign,
                damage.cut,
            )
    elif name == "mlruns":
        path, ways = path / "mlflow.db", (damage.foreign, damage.cut, damage.strange_bytes)
    else:
        # A store that is missing is made.
        ways = [way for way in FILES[name] if line != "label into" or way != damage.missing]
    way = ways[int(rng.integers(len(ways)))]
    return f"{path.relative_to(here)} {way(rng, path)}", arguments, way in RANDOM


_HEAVY = {"quickstart tracked": 0.1, "experiment tracked": 0.3, "mesh": 1.5}
_WEIGHTS = np.array([_HEAVY.get(name, 1.0) for name in LINES])
_WEIGHTS /= _WEIGHTS.sum()
