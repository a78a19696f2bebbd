"""How a path and a scene show themselves."""

import numpy as np
import pytest
from path_toys import truss

from solver.equilibrium.outcome import Outcome
from solver.paths.continuation import Path, load, trace
from solver.paths.steppers import ArcLength


def test_a_path_tells_where_it_went_and_a_scene_of_what_it_is_in_a_line():
    scene = truss()
    arc = ArcLength(1e-10, a=0.02, b=2e-5)
    path = trace(scene, np.zeros(scene.size), arc, until=load(4e-4), max_steps=100)
    folds = [event for event in path.events if event.kind == "fold"]
    told = repr(path)
    assert told.startswith(f"Path({len(path.points)} points, e 0 to 0.0004")
    assert f"fold at {folds[0].e:.4g}" in told and path.reason in told and len(told) < 250
    assert repr(scene) == (
        f"Scene(Bars, PointLoad; {scene.n_nodes} nodes, {scene.n_free} unknowns, 0 rows)"
    )


def test_the_plot_has_every_point_and_tells_stable_ones_from_others():
    scene = truss()
    arc = ArcLength(1e-10, a=0.02, b=2e-5)
    path = trace(scene, np.zeros(scene.size), arc, until=load(4e-4), max_steps=100)
    ax = path.plot(lambda point: -point.x[0], "displacement")
    line, stable, other = ax.lines
    np.testing.assert_array_equal(line.get_xdata(), path.loads)
    np.testing.assert_array_equal(line.get_ydata(), [-p.x[0] for p in path.points])
    unstable = [p.e for p in path.points if p.unstable != 0]
    np.testing.assert_array_equal(other.get_xdata(), unstable)
    assert len(unstable) > 0 and len(stable.get_xdata()) + len(unstable) == len(path.points)
    assert ax.get_ylabel() == "displacement"
    empty = Path((), Outcome.NOT_CONVERGED, ())
    assert repr(empty).startswith("Path(0 points; ")
    with pytest.raises(ValueError, match="no points to plot"):
        empty.plot(lambda point: 0.0)
