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


def test_a_notebook_has_the_terms_of_a_scene_and_the_points_of_a_path_with_their_events():
    scene = truss()
    html = scene._repr_html_()
    assert f"{scene.n_free} unknowns" in html and "<td>Bars</td><td>yes</td>" in html
    assert "<td>PointLoad</td><td>–</td>" in html
    arc = ArcLength(1e-10, a=0.02, b=2e-5)
    path = trace(scene, np.zeros(scene.size), arc, until=load(4e-4), max_steps=100)
    html = path._repr_html_()
    assert f"{len(path.points)} points: {path.reason}" in html
    for event in path.events:
        assert f"{event.kind} at {event.e:.4g}" in html
    last = len(path.points) - 1
    assert f"<tr><td>{last}</td><td>0.0004</td><td>0</td>" in html
    assert html.count("<tr>") <= 1 + 12 + len(path.events) < last
    # What happened beyond the last point stands in a row of its own.
    cut = Path(path.points[:1], path.outcome, path.events[:1])
    row = f"<td></td><td>{path.events[0].kind} at {path.events[0].e:.4g}</td></tr></tbody>"
    assert row in cut._repr_html_()
    assert "0 points" in Path((), Outcome.NOT_CONVERGED, ())._repr_html_()
