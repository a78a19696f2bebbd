"""Pictures of bodies: which state stands where, and mirror images on their side of a plane."""

from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest
import pyvista

from experiments import furrow, problem_p
from experiments._lung import plots
from solver.cases.tissue import furrow as furrow_case
from solver.cases.tissue import neural_tube as tube_case


@pytest.mark.parametrize(
    ("case", "mirrors"),
    [
        (furrow_case, ()), (furrow_case, ("x",)), (furrow_case, ("y",)), (furrow_case, ("x", "y")),
        (tube_case, ("z",)),
    ],
)  # fmt: skip
def test_what_is_warped_is_the_body_and_its_mirror_images(case, mirrors):
    model = case.build(0, element="hex8")
    body, u = model.body, np.zeros_like(model.body.nodes)
    # Away from the planes and along them, by another amount in each direction.
    scale = np.array([1.1, 1.3, 1.7])
    still, moved = furrow.warped(model, [(0.0, u), (1.0, body.nodes * (scale - 1))], mirrors)
    for shape, times in ((still, 1.0), (moved, scale)):
        low, high = times * body.nodes.min(axis=0), times * body.nodes.max(axis=0)
        for k, axis in enumerate("xyz"):
            if axis in mirrors:
                # A plane of the body at 0 is where its image begins.
                assert min(abs(low[k]), abs(high[k])) == pytest.approx(0, abs=1e-9)
                high[k] = max(high[k], -low[k])
                low[k] = -high[k]
        assert shape.bounds[::2] == pytest.approx(low, abs=1e-6)
        assert shape.bounds[1::2] == pytest.approx(high, abs=1e-6)
        assert shape.n_cells == len(body.cells) * 2 ** len(mirrors)
        beta = shape.point_data["beta"]
        assert beta.min() >= 0 and 0.5 < beta.max() <= 1


def test_problem_p_is_pictured_at_the_start_the_middle_and_the_end(monkeypatch):
    picked, places, shape = [], [], pyvista.Sphere()
    shape.point_data["displacement"] = np.zeros((shape.n_points, 3))
    shape.point_data["layer"] = np.zeros(shape.n_points)
    reader = SimpleNamespace(set_active_time_point=picked.append, read=lambda: [shape])

    class Plotter(SimpleNamespace):
        def __init__(self, **options):
            nothing = dict.fromkeys(("set_background", "add_mesh", "close"), lambda *a, **o: None)
            super().__init__(camera=SimpleNamespace(zoom=lambda by: None), **nothing)
            assert options["shape"] == (1, 3)

        def subplot(self, *place):
            places.append(place)

        def screenshot(self, path):
            places.append(path)

    monkeypatch.setattr(pyvista, "get_reader", lambda path: reader)
    monkeypatch.setattr(pyvista, "Plotter", Plotter)
    series = SimpleNamespace(path="unit.pvd", loads=[0.0, 0.1, 0.45, 0.52, 0.7, 0.9, 1.0])
    problem_p.picture(series, "shapes.png")
    assert picked == [0, 3, 6] and places == [(0, 0), (0, 1), (0, 2), "shapes.png"]


def test_lungs_that_do_not_move_have_no_scale_of_colours(tmp_path):
    paths = []
    for k in range(3):
        paths.append(tmp_path / f"{k}.png")
        matplotlib.image.imsave(paths[-1], np.full((4, 4), 0.1 * k), cmap="gray", vmin=0, vmax=1)
    limits = [(0.0, 0.0), (0.0, 2e-3), (-0.1, 0.2)]
    figure = plots.plot_pictures(paths, ["flat", "still", "inflated"], limits)
    pictures, bars = figure.axes[:3], figure.axes[3:]
    assert [ax.get_title() for ax in pictures] == ["flat", "still", "inflated"]
    assert [ax.images[0].get_array()[0, 0, 0] for ax in pictures] == pytest.approx(
        [0.0, 0.1, 0.2], abs=0.01
    )
    assert [bar.get_visible() for bar in bars] == [False, False, True]
    assert bars[2].get_xlim() == pytest.approx((-0.1, 0.2))
