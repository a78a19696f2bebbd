"""What the full solid says of a structure: its verdict, its error, and what it can't tell."""

from dataclasses import replace

import numpy as np
import pytest
from crease_patterns import for_angle, structure, two_panels
from pytest import approx

from foldlab.structure.solid import _verdict, save_solid, solid

pytest.importorskip("gmsh")
HALF = 0.3  # hinge, in the panels' length


def made(angle=0.6, gamma=100.0):
    contraction = for_angle(angle, HALF)
    return structure(two_panels(HALF), contraction=contraction, gamma=gamma)


def test_two_panels_fold_and_their_last_state_is_written(tmp_path):
    said = []
    result = solid(made(), ("gravity", "ground", "contact"), upright=True, tell=said.append)
    assert result.foldable is True and result.reason.startswith("all 1 hinges fold; least room ")
    assert result.angles[0] == approx(0.6, abs=0.05)
    assert 0 < result.error[0] < 0.05
    assert len(said) == 2 and said[1] == f"solid: {result.unknowns} unknowns"
    row = result.row()
    assert row["angles"] == result.angles.tolist() and row["core_seconds"] > 0
    assert result.folding.model.effects == ("gravity", "ground", "contact")
    assert row["contraction_reached"] == 1.0 and result.folding.last.clearance == np.inf
    save_solid(result.folding, tmp_path / "solid.vtu")
    import pyvista

    grid = pyvista.read(tmp_path / "solid.vtu")
    extent = result.folding.model.structure.pattern.extent
    assert np.ptp(grid.points, axis=0).max() == approx(extent)
    moved = grid.points + grid.point_data["displacement"]
    # Both panels rise.
    assert np.ptp(moved[:, 2]) > 2 * np.ptp(grid.points[:, 2])


def test_where_panels_meet_the_answer_is_what_they_had_folded_by(monkeypatch):
    from solver.cases.structure import path

    followed = path.fold

    def fold(model, *, meet):
        assert meet is False
        whole = followed(model)
        return replace(whole, states=whole.states[:-1], ending=path.Ending.STOPPED)

    monkeypatch.setattr(path, "fold", fold)
    result = solid(made(), (), need=0.01)
    assert result.foldable is True and 0 < result.contraction < 1
    assert result.reason.endswith(
        f"panels meet at {100 * result.contraction:.3g} % of the contraction"
    )
    assert result.row()["contraction_reached"] == result.contraction
    assert result.angles[0] < 0.59
    # What hasn't folded by then may yet, as panels slide on.
    result = solid(made(), (), need=0.595)
    assert result.foldable is None
    assert result.reason.startswith("unknown: 1 of 1 hinges don't fold; ")
    assert result.reason.endswith("of the contraction, and what they do then isn't followed")


def test_a_path_without_time_is_unknown():
    result = solid(made(), (), timeout=0.0)
    assert result.foldable is None and result.angles is None and result.error is None
    assert result.reason == "unknown: the time allowed was used up"


@pytest.mark.parametrize(
    "angle, error, foldable, says",
    [
        (0.6, 0.01, True, "all 1 hinges fold; least room 5.73°"),
        (0.6, 0.2, None, "1 of 1 hinges are nearer to what is asked than their error"),
        (0.4, 0.01, False, "1 of 1 hinges don't fold; least room -5.73°"),
        (0.6, None, None, "on a coarser mesh the path came to no end"),
    ],
)
def test_an_error_leaves_open_what_is_near(angle, error, foldable, says):
    error = None if error is None else np.array([error])
    verdict, reason = _verdict(made(), np.array([angle]), error, need=0.5)
    assert verdict is foldable
    assert says in reason


@pytest.mark.parametrize("level", [0, 9])
def test_a_level_needs_one_below_it(level):
    with pytest.raises(ValueError, match="expected 1 to 2"):
        solid(made(), level=level)
