"""Which states `foldlab simulate` shows."""

import numpy as np

from foldlab.labels.asked import Conditions, Effort
from foldlab.labels.solver import SolverSource
from foldlab.unit import plots, record, render

DESIGN = {
    "E_ratio": 0.1, "rho_ratio": 1.0, "hinge_length": 0.2, "hinge_width": 1.0, "h_ratio": 5.0,
    "stiffness_to_weight": 1.0, "aspect": 0.2, "slenderness": 4e-3, "contraction": 0.3,
}  # fmt: skip


def test_shapes_are_of_the_flat_the_half_folded_and_the_last_state(tmp_path, monkeypatch):
    source = SolverSource(Conditions(effects="none"), Effort(accuracy=0.05))
    run, label = source.follow(DESIGN)
    asked, shown = [], []
    monkeypatch.setattr(render, "render", lambda request, folder: asked.append(request))
    right = plots.plot_side
    monkeypatch.setattr(
        plots, "plot_side", lambda curves, *a, **k: shown.append(curves) or right(curves, *a, **k)
    )
    record.draw(tmp_path, label, run, source, animate=False)
    loads = np.array([shape.load for shape in run.shapes])
    wanted = [k for k, name, _ in asked[0].pictures if name not in asked[0].strained]
    middle = wanted[1]
    assert wanted == [0, middle, len(loads) - 1]
    # No other state is nearer to half of the contraction.
    assert abs(loads[middle] - 0.5) == np.abs(loads - 0.5).min()
    # The last one once more, by strain up to the peak that the label knows.
    assert [k for k, name, _ in asked[0].pictures if name in asked[0].strained] == [wanted[-1]]
    assert asked[0].most == max(label.evidence["strain"].values()) > 0.3
    assert len(shown[0]) == 3 and (tmp_path / "shapes.png").exists()
    # Its shapes alone, where nothing measured is asked for.
    alone = tmp_path / "alone"
    alone.mkdir()
    record.draw(alone, label, run, source, animate=False, measured=False)
    assert [path.name for path in alone.iterdir()] == ["shapes.png"]
    assert [k for k, _, _ in asked[1].pictures] == wanted


def test_cells_are_coloured_by_the_elastic_strain_alone():
    grown = np.diag([1.0, 0.7, 1.0])
    F = np.stack([grown, np.eye(3), np.diag([1.0, 1.0, 0.9])]).reshape(3, 9)
    growth = np.stack([grown, grown, np.eye(3)]).reshape(3, 9)
    np.testing.assert_allclose(render.principal(F, growth), [0, 1 / 0.7 - 1, 0.1], atol=1e-12)
