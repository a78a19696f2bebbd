"""A lung whose epithelium proliferates: what is free only grows, what is caged bulges."""

import numpy as np
import pytest
from pytest import approx

from solver.cases.lung.geometry import Lung
from solver.cases.lung.measures import measure
from solver.cases.lung.mesh import hexahedra
from solver.cases.lung.model import REST, State, Tissue, muscle_of, run, scene
from solver.cases.lung.viscous import Relaxing, viscous

CAGED = Lung(n=1)


def ended(lung, body, *states):
    x = None
    for before, after in zip((REST, *states), states, strict=False):
        stage = scene(body, lung, Tissue(), before, after)
        path = run(stage, x, steps=5, events=False)
        assert path.reached
        x = path.last.x
    return stage.displacement(x, 1.0)


def test_a_bare_shell_grows_as_a_whole_without_stress():
    lung = Lung(n=1, muscle=0.0)
    body = hexahedra(lung, 0)
    u = ended(lung, body, State(0.0, proliferation=0.2))
    assert u == approx(0.2 * body.nodes, abs=1e-8)
    # And takes it back.
    back = ended(lung, body, State(0.0, proliferation=0.2), State(0.0))
    assert back == approx(0 * back, abs=1e-8)


def test_within_its_cage_it_bulges_without_any_pressure():
    body = hexahedra(CAGED, 0)
    u = ended(CAGED, body, State(0.0, proliferation=0.1))
    found = measure(body, CAGED, u)
    assert found.highest > 0.02 > found.lowest and found.aspect > 0.03
    muscle = np.unique(body.cells[muscle_of(body)])
    X = body.nodes
    cage = np.linalg.norm((X + u)[muscle], axis=1).mean() / np.linalg.norm(X[muscle], axis=1).mean()
    # The cage is 75 times as stiff: it follows a little.
    assert 1 < cage < 1.05


def test_each_tissue_grows_by_its_own_law():
    body = hexahedra(CAGED, 0)
    muscle, shape = muscle_of(body), body.weights.shape
    for kind in ("along", "isotropic", "blended"):
        tissue = Tissue(fibres=kind)
        both, alone = (
            scene(body, CAGED, tissue, REST, State(0.0, -0.2, q)).terms[0].growth
            for q in (0.3, 0.0)
        )
        for e in (0.0, 0.5, 1.0):
            F = np.linalg.inv(np.broadcast_to(
                both.evaluate(e, shape, body.points)[0], (*shape, 3, 3)))  # fmt: skip
            G = np.linalg.inv(np.broadcast_to(
                alone.evaluate(e, shape, body.points)[0], (*shape, 3, 3)))  # fmt: skip
            assert F[muscle] == approx(G[muscle])
            assert F[~muscle] == approx(
                np.broadcast_to((1 + 0.3 * e) * np.eye(3), F[~muscle].shape)
            )
    stage = viscous(body, CAGED, Tissue(), Relaxing(), (REST, State(0.0, 0.0, 0.3)), dt=0.1)
    J = np.broadcast_to(stage.terms[0].growth.evaluate(1.0, shape)[1], shape)
    assert J[~muscle] == approx(1.3**3) and J[muscle] == approx(1.0)
    assert scene(body, CAGED, Tissue(), REST, State(0.05)).terms[0].growth is None


@pytest.mark.parametrize("q", [-1.0, np.nan, np.inf])
def test_a_proliferation_to_nothing_is_refused(q):
    with pytest.raises(ValueError, match=r"proliferation .* expected a finite number above -1"):
        State(0.0, proliferation=q)
