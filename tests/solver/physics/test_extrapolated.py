"""Stresses that a step leads to in proportion, and the stiffness of a body under them."""

import numpy as np
import pytest

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.structured import box
from solver.physics import elastic
from solver.physics.elastic import Elastic
from solver.physics.growth import Orthotropic
from solver.physics.loads import Gravity
from solver.physics.materials import NeoHookean
from solver.physics.supports import Fixed
from solver.physics.term import Evaluation

E = 0.7


def grown(element="hex8", cells=None):
    """A block whose upper half grows unevenly, bent and sheared; the term, u and a step du."""
    body = Body.build(
        box(np.linspace(0, 1.5, 4), np.linspace(0, 1, 3), np.linspace(0, 0.4, 3)), element
    )
    mask = body.cells_where(lambda X: X[:, 2] > 0.2)
    growth = Orthotropic((0.3, lambda e: -0.2 * e, 0.1), cells=mask)
    term = Elastic(body, NeoHookean(3.0, 0.35), growth, cells=mask if cells else None)
    x, y, z = body.nodes.T
    u = np.stack([0.2 * x * z, 0.1 * x * x + 0.05 * z, -0.15 * x * y], axis=1)
    du = np.random.default_rng(3).standard_normal(u.shape) * 0.1
    return body, term, u, du


@pytest.mark.parametrize("cells", [False, True])
def test_stresses_grow_along_a_step_as_their_rate_says(cells):
    _, term, u, du = grown(cells=cells)
    still = np.zeros_like(u)
    rate = term.extrapolated(u, du, E) - term.extrapolated(u, still, E)
    assert np.abs(rate).max() > 0.1
    h = 1e-5
    ends = [term.extrapolated(u + side * h * du, still, E) for side in (1, -1)]
    assert rate == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-7)
    twice = term.extrapolated(u, 2 * du, E) - term.extrapolated(u, still, E)
    assert twice == pytest.approx(2 * rate, abs=1e-12)


def quadratic(body, blocks, du):
    """du · K du of a stiffness as blocks."""
    a = np.repeat(np.arange(body.graph.n), np.diff(body.graph.indptr))
    return float(np.einsum("bi,bij,bj->", du[a], blocks, du[body.graph.indices]))


@pytest.mark.parametrize("element", ["hex8", "hex27"])
@pytest.mark.parametrize("cells", [False, True])
def test_a_stress_stiffens_by_its_work_on_the_second_order_of_strain(element, cells, monkeypatch):
    monkeypatch.setattr(elastic, "CHUNK", 64)  # several pieces of the body
    # ∫ Jg S : dFᵀdF with dF = ∂du/∂X Fg⁻¹, of what S is more than the state's own.
    body, term, u, du = grown(element, cells)
    own = term.extrapolated(u, np.zeros_like(u), E)
    more = np.random.default_rng(5).standard_normal(own.shape)
    more = more + np.swapaxes(more, 2, 3)
    _, inverse, J = term._at(E)
    shape = body.weights.shape
    inverse = np.broadcast_to(inverse, (*shape, 3, 3))[term.ids]
    J = np.broadcast_to(J, shape)[term.ids]
    dF = np.einsum("cai,cqaj->cqij", du[body.cells[term.ids]], body.gradients[term.ids]) @ inverse
    strain = np.swapaxes(dF, 2, 3) @ dF
    work = float(np.einsum("cq,cq,cqij,cqij->", body.weights[term.ids], J, more, strain))
    assert quadratic(body, term.under(own + more, u, E), du) == pytest.approx(work, rel=1e-10)
    assert np.abs(term.under(own, u, E)).max() < 1e-12


def test_a_scene_under_its_own_stresses_is_itself_and_under_others_another():
    body, _, u, du = grown("hex27")
    mask = body.cells_where(lambda X: X[:, 2] > 0.2)
    # Two stiff terms, one on some of the cells, and one without a stiffness.
    terms = [
        Elastic(body, NeoHookean(3.0, 0.35), cells=mask, name="upper"),
        Elastic(body, NeoHookean(1.0, 0.2), cells=~mask, name="lower"),
        Gravity(body, 0.1, 1.0),
    ]
    scene = Scene(
        body,
        terms,
        fixed=[Fixed(body.nodes_where(lambda X: X[:, 0] < 1e-9), axis) for axis in np.eye(3)],
    )
    x, dx = scene.unknowns(u), scene.unknowns(du)
    plain = scene.system(x, 0.5)
    same = scene.system(x, 0.5, scene.extrapolated(x, 0 * dx, 0.5))
    assert same.values == pytest.approx(plain.values, abs=1e-12)
    other = scene.system(x, 0.5, scene.extrapolated(x, dx, 0.5))
    assert other.residual == pytest.approx(plain.residual, abs=1e-15)
    u, step = scene.displacement(x, 0.5), scene.step_displacement(dx)
    more = sum(t.under(t.extrapolated(u, step, 0.5), u, 0.5) for t in terms[:2])
    difference = scene.frame.pattern.gather(more)
    assert other.values - plain.values == pytest.approx(difference, abs=1e-12)
    assert np.abs(difference).max() > 1e-2


def test_no_stress_is_told_of_a_state_that_the_material_does_not_admit():
    _, term, u, du = grown()
    inverted = -3.0 * term.body.nodes
    assert term.extrapolated(inverted, du, E) is None
    assert term.under(term.extrapolated(u, du, E), inverted, E) is None


class Kept(Elastic):
    """One that keeps its stiffness for whoever asks next."""

    kept = None

    def evaluate(self, u, e, order=2):
        if self.kept is None:
            self.kept = super().evaluate(u, e, 2)
        return Evaluation(self.kept.energy, self.kept.force, self.kept.stiffness)


def test_a_stiffness_that_a_term_keeps_is_not_changed():
    body, _, u, du = grown()
    root = body.nodes_where(lambda X: X[:, 0] < 1e-9)
    term = Kept(body, NeoHookean(1.0, 0.3))
    scene = Scene(body, [term], fixed=[Fixed(root, axis) for axis in np.eye(3)])
    term.kept = None
    x = scene.unknowns(u)
    stresses = scene.extrapolated(x, scene.unknowns(du), 0.0)
    values = [scene.system(x, 0.0, stresses).values for _ in range(2)]
    assert np.array_equal(*values)
