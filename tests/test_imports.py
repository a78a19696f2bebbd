"""Who may import whom, folder by folder: experiments → foldlab → solver, and never back."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

# A room is a folder, or a file beside the folders. Small parts that anybody may use stand first.
FREE = {
    "foldlab", "foldlab.errors", "foldlab.design", "foldlab.settings", "foldlab.tables",
    "foldlab.quantities", "foldlab.materials", "foldlab.shown", "foldlab.packaged",
}  # fmt: skip
# The same of the solver.
GIVEN = {"solver.given", "solver.shown"}
MAY = {
    "solver": set(),
    "solver.given": set(),
    "solver.shown": set(),
    "solver.mesh": set(),
    "solver.physics": {"solver.mesh"},
    "solver.equilibrium": {"solver.mesh", "solver.physics"},
    "solver.paths": {"solver.equilibrium"},
    "solver.viscous": {"solver.mesh", "solver.physics", "solver.equilibrium"},
    "solver.transport": {"solver.mesh", "solver.physics"},
    # What a fit varies are states of equilibrium and, in time, of viscous bodies.
    "solver.fitting": {
        "solver.mesh", "solver.physics", "solver.equilibrium", "solver.paths", "solver.viscous",
    },
    "solver.output": {"solver.mesh", "solver.physics"},
    "solver.cases": set(),
    "solver.cases.unit": {
        "solver.cases", "solver.mesh", "solver.physics", "solver.equilibrium", "solver.paths",
        "solver.output",
    },
    "solver.cases.structure": {
        "solver.cases", "solver.cases.unit", "solver.mesh", "solver.physics", "solver.equilibrium",
        "solver.paths",
    },
    "solver.cases.lung": {
        "solver.cases", "solver.mesh", "solver.physics", "solver.equilibrium", "solver.paths",
        "solver.viscous",
    },
    "solver.cases.tissue": {
        "solver.cases", "solver.mesh", "solver.physics", "solver.equilibrium", "solver.transport",
        "solver.viscous",
        "solver.fitting",  # a pattern with parameters says on which skin its shape is seen
    },
    "foldlab": {"foldlab.datasets"},
    "foldlab.design": set(),
    "foldlab.errors": set(),
    "foldlab.settings": set(),
    "foldlab.tables": set(),
    "foldlab.quantities": set(),
    "foldlab.materials": set(),
    "foldlab.shown": {"solver.shown"},
    "foldlab.packaged": set(),
    "foldlab.memory": set(),
    "foldlab.plots": set(),
    "foldlab.terminal": set(),
    "foldlab.datasets": set(),
    "foldlab.tracking": {"foldlab.learning", "foldlab.terminal"},
    "foldlab.labels": {
        "foldlab.datasets", "foldlab.memory", "solver.cases.unit", "solver.equilibrium"
    },
    "foldlab.campaign": {"foldlab.labels"},
    "foldlab.learning": {"foldlab.labels", "foldlab.learning.symbolic", "foldlab.plots"},
    "foldlab.learning.symbolic": {"foldlab.labels"},
    "foldlab.predicted": {"foldlab.datasets", "foldlab.learning"},
    "foldlab.maps": {"foldlab.labels", "foldlab.learning", "foldlab.plots"},
    "foldlab.inverse": {"foldlab.labels", "foldlab.learning"},
    "foldlab.unit": {"foldlab.labels", "foldlab.plots", "foldlab.terminal"},
    "foldlab.structure": {
        "foldlab.labels", "foldlab.plots", "foldlab.unit", "solver.cases.structure",
        "solver.mesh", "solver.output",
        "solver.equilibrium",
    },
    "foldlab.making": {"foldlab.labels", "foldlab.plots", "foldlab.terminal", "foldlab.unit"},
    "foldlab.explore": {
        "foldlab.inverse", "foldlab.labels", "foldlab.learning", "foldlab.making",
        "foldlab.predicted", "foldlab.terminal", "foldlab.unit",
    },
    "foldlab.cli": {
        "foldlab.campaign", "foldlab.datasets", "foldlab.inverse", "foldlab.labels",
        "foldlab.learning", "foldlab.making", "foldlab.maps", "foldlab.plots",
        "foldlab.predicted", "foldlab.structure", "foldlab.terminal", "foldlab.tracking",
        "foldlab.unit",
    },
}  # fmt: skip
# Within foldlab.labels only what a solver label is made of sees the solver, and what folds a
# structure of many hinges; tables of notebooks are the solver's too.
SOLVER = {"foldlab/labels/solver.py", "foldlab/labels/run.py", "foldlab/labels/rod.py"}
SOLVER |= {"foldlab/shown.py"}
SOLVER |= {
    f"foldlab/structure/{name}.py"
    for name in ("answer", "files", "laws", "made", "pictures", "solid")
}
FILES = sorted(p for top in ("solver", "foldlab") for p in (ROOT / top).rglob("*.py"))


def room_of(dotted: str) -> str:
    """The room in which a dotted name of module or thing stands."""
    parts = dotted.split(".")
    for k in range(len(parts), 0, -1):
        here = ROOT.joinpath(*parts[:k])
        if here.is_dir():
            return ".".join(parts[:k])
        if here.with_suffix(".py").exists():
            return ".".join(parts[: k - 1] if k > 2 else parts[:k])
    return parts[0]


def imported(path):
    """Dotted names of what a file imports from this project, faces included."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (n for n in names if n.split(".")[0] in ("solver", "foldlab", "experiments"))


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_arrow(path):
    file = path.relative_to(ROOT)
    dotted = ".".join(file.with_suffix("").parts).removesuffix(".__init__")
    room = room_of(dotted)
    rooms = {room_of(name) for name in imported(path)} - {room}
    allowed = MAY[room] | (FREE if file.parts[0] == "foldlab" else GIVEN)
    assert rooms <= allowed, f"{file} may not import {sorted(rooms - allowed)}"
    if str(file) not in SOLVER:
        assert file.parts[0] == "solver" or not any(r.startswith("solver") for r in rooms)


def test_the_rule_has_no_circles():
    done = set()
    while len(done) < len(MAY):
        free = {room for room in MAY if room not in done and MAY[room] - {room} <= done}
        assert free, f"these import each other: {sorted(set(MAY) - done)}"
        done |= free


def test_every_folder_is_small():
    # experiments/ stays flat: `python -m experiments.NAME` names its questions.
    for folder in {p.parent for p in FILES}:
        assert len([p for p in FILES if p.parent == folder]) <= 15, folder


def spelled_endings(tree):
    """Lines that compare the name or sentence of an ending with a string."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            parts = [part for side in (node.left, *node.comparators) for part in ast.walk(side)]
            words = [p for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)]
            owners = [
                ast.unparse(p.value).split(".")[-1]
                for p in parts
                if isinstance(p, ast.Attribute) and p.attr in ("name", "value")
            ]
            if words and {"ending", "outcome"} & set(owners):
                yield node.lineno


def test_endings_are_read_as_a_type():
    wrong = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in FILES
        for line in spelled_endings(ast.parse(path.read_text()))
    ]
    assert not wrong, f"compare the ending with a member of its enum in {', '.join(wrong)}"


@pytest.mark.parametrize(
    "line, wrong",
    [
        ('folding.ending.name == "REACHED"', True),
        ('"TIMEOUT" != run.folding.ending.name', True),
        ('path.outcome.name.lower() in ("reached", "stopped")', True),
        ('ending.value == "the time allowed was used up"', True),
        ("folding.ending is Ending.REACHED", False),
        ('self.name == "x"', False),
        ('label["outcome"] == "folds"', False),
    ],
)
def test_the_ending_test_sees_comparisons(line, wrong):
    assert bool(list(spelled_endings(ast.parse(line)))) is wrong


def test_the_arrow_test_sees_imports(tmp_path):
    probe = tmp_path / "probe.py"
    probe.write_text("import solver.mesh.body\ndef f():\n    from foldlab.design import FULL\n")
    rooms = {room_of(name) for name in imported(probe)}
    assert rooms == {"solver.mesh", "foldlab.design"}
