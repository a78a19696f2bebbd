"""Loads on lines and nodes, and the elastic foundation: derivatives, totals, closed forms."""

import numpy as np
import pytest
import skfem
from proofs import BODIES, ELEMENTS, block, prove, state
from pytest import approx
from reference_scenes import MidLine, at_end, cantilever, held, modulus, near, strip

from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.mesh.lines import Line
from solver.mesh.structured import box, polar
from solver.physics.elastic import Elastic
from solver.physics.loads import Foundation, LineLoad, PointLoad, Traction
from solver.physics.materials import SmallStrain


def edge(body):
    return body.nodes_where(lambda X: (X[:, 0] > 1 - 1e-9) & (X[:, 2] > 0.8 - 1e-9))


@pytest.mark.parametrize("element", ELEMENTS)
def test_derivatives(element):
    body, u = BODIES[element], state(BODIES[element])
    line = Line.of(body, edge(body))
    prove(LineLoad(body, line, lambda e, X: e * np.cross(X, (1, 2, 3))), u, 0.5)
    prove(PointLoad(body, [3, 5], lambda e: (e, 0, -2 * e)), u, 0.5)
    top = body.surface(lambda X: X[:, 2] > 0.8 - 1e-9)
    sides = body.surface(lambda X: X[:, 0] > 1 - 1e-9)
    prove(Foundation(body, top, lambda e, X: e * (1 + X[..., 0]), 0.3), u, 0.5)
    prove(Foundation(body, sides, 0.0, lambda e: e), u, 0.5)


@pytest.mark.parametrize("element", ELEMENTS)
def test_a_line_is_as_long_as_it_is_and_its_loads_sum_to_the_total(element):
    body = BODIES[element]
    line = Line.of(body, edge(body))
    assert line.weights.sum() == approx(1.5, rel=1e-12)
    # q = y² (0, 0, 1): total ∫ y² dy, moment about x ∫ y³ dy, whatever the division.
    loads = LineLoad(body, line, lambda e, X: X[..., 1, None] ** 2 * np.array([0, 0, 1.0])).loads(0)
    assert loads.sum(axis=0) == approx([0, 0, 1.5**3 / 3], rel=1e-12)
    assert body.nodes[:, 1] @ loads[:, 2] == approx(1.5**4 / 4, rel=1e-12)
    assert not loads[np.setdiff1d(np.arange(len(loads)), edge(body))].any()
    # Nodes in any order, or as a mask, make the same line.
    mask = np.zeros(len(body.nodes), bool)
    mask[edge(body)] = True
    for nodes in (edge(body)[::-1], mask):
        np.testing.assert_array_equal(Line.of(body, nodes).nodes, line.nodes)


def test_lines_through_faces_and_cells_of_27_nodes_and_along_curves():
    body = Body.build(box([0, 1, 3], [0, 2], [0, 1]), "hex27")
    for k, x in ((1, (0.5, 1, 0.5)), (1, (1, 1, 0.5)), (0, (0, 1, 0.5))):
        on = body.nodes_where(lambda X, k=k, x=x: np.abs(np.delete(X - x, k, 1)).max(1) < 1e-9)
        assert Line.of(body, on).weights.sum() == approx((3, 2)[k], rel=1e-12)
    curved = Body.build(box([1, 2], np.linspace(0, np.pi / 2, 5), [0, 1], shape=polar), "hex27")
    arc = curved.nodes_where(lambda X: (np.hypot(*X.T[:2]) > 2 - 1e-9) & (X[:, 2] < 1e-9))
    assert Line.of(curved, arc).weights.sum() == approx(np.pi, rel=1e-4)
    # 20 nodes have none in their faces' middles.
    body = Body.build(skfem.MeshHex(), "hex20")
    with pytest.raises(ValueError, match=r"no line: .* none meet at \(0, 0, 0.5\)"):
        Line.of(body, body.nodes_where(lambda X: (X[:, 2] == 0.5) & (X[:, 0] == 0)))


def test_a_fork_of_three_edges_is_no_line():
    body = Body.build(skfem.MeshHex(), "hex8")
    fork = body.nodes_where(lambda X: X.sum(axis=1) < 1.5)
    assert len(fork) == 4
    with pytest.raises(ValueError, match=r"no line: .* more than two meet at \(0, 0, 0\)"):
        Line.of(body, fork)


@pytest.mark.parametrize("element", ["hex27", "hex8"])
def test_a_line_between_cells_that_run_opposite_ways(element):
    mesh = skfem.MeshHex.init_tensor([0, 1], [0, 1], [0, 1, 2])
    X = skfem.ElementHex1().doflocs
    half_turn = [int(np.argmin(np.abs(X - (1 - x[0], 1 - x[1], x[2])).sum(1))) for x in X]
    t = mesh.t.copy()
    t[:, 1] = t[half_turn, 1]
    body = Body.build(skfem.MeshHex(mesh.p, t), element)
    on = body.nodes_where(lambda X: (X[:, 1] == 0) & (X[:, 2] == 1))
    assert Line.of(body, on).weights.sum() == approx(1.0)


def test_a_point_load_acts_on_its_nodes():
    body = BODIES["tet4"]
    each = PointLoad(body, [2, 7], (0, 0, 3.0)).loads(0.0)
    assert each[[2, 7], 2].tolist() == [3, 3] and np.abs(each).sum() == 6
    own = np.array([[1.0, 0, 0], [0, 2, 0]])
    mask = np.isin(np.arange(len(body.nodes)), [2, 7])
    loads = PointLoad(body, mask, lambda e: e * own).loads(2.0)
    np.testing.assert_array_equal(loads[[2, 7]], 2 * own)


@pytest.mark.parametrize("how", ["point", "line"])
def test_cantilever_under_its_tip_load(how):
    # references.md §1, α = 1; the load on the mid-line of the end, or on that line's nodes.
    base, h = cantilever(tip_load=1.0), 0.01
    body = base.body
    tip = body.nodes_where(lambda X: (X[:, 0] > 1 - 1e-9) & (np.abs(X[:, 2]) < 1e-9))
    tip = tip[np.argsort(body.nodes[tip, 1])]
    if how == "line":
        load = LineLoad(body, Line.of(body, tip), lambda e: (0, 0, -e))
    else:
        load = PointLoad(body, tip, lambda e: np.outer([1, 4, 1], (0, 0, -e * h / 6)))
    elastic = next(t for t in base.terms if isinstance(t, Elastic))
    fixed = [*held(body, 1, 0.0, 1), *held(body, 1, h, 1), *held(body, 0, 0.0, 0, 1, 2)]
    scene = Scene(body, [elastic, load], fixed=fixed)
    drop, shortening, angle = MidLine(scene).tip(*at_end(scene))
    assert drop == approx(0.301720774, rel=5e-3)
    assert shortening == approx(0.056433236, rel=5e-3)
    assert -angle == approx(0.461351950, rel=5e-3)


def test_beam_on_an_elastic_foundation():
    # Hetényi, Beams on Elastic Foundation (1946), semi-infinite beam, load P at its free end:
    # w = 2 P β/k exp(−βx) cos βx, β⁴ = k/4B. B = 1 per width; E is free of Poisson's effect.
    h, beta, P = 0.01, 10.0, 1e-3
    body, fixed = strip(h, 40)
    base = body.surface(near(2, -h / 2))
    end = body.surface(near(0, 0.0))
    k = 4 * beta**4
    terms = [
        Elastic(body, SmallStrain(modulus(h), 0.0)),
        Foundation(body, base, k),
        Traction(body, end, (0, 0, -P / h)),
    ]
    scene = Scene(body, terms, fixed=[*fixed, *held(body, 0, 1.0, 0)])
    system = scene.system(np.zeros(scene.size), 1.0)
    u = scene.displacement(-system.factorise().solve(system.residual), 1.0)
    on = body.nodes_where(lambda X: (np.abs(X[:, 2]) < 1e-9) & (X[:, 1] < 1e-9))
    x, w = body.nodes[on, 0], -u[on, 2]
    exact = 2 * P * beta / k * np.exp(-beta * x) * np.cos(beta * x)
    assert np.abs(w - exact).max() < 5e-3 * exact.max()
    # What the springs carry is the load.
    springs = scene.terms[1].evaluate(u, 1.0, 1).force.sum(axis=0)
    assert springs == approx([0, 0, -P * h], abs=1e-9 * P * h)


def test_a_foundation_along_and_across_a_face():
    body = block("hex27", distort=0)
    top = body.surface(lambda X: X[:, 2] > 0.8 - 1e-9)  # 1 × 1.5
    shift = np.broadcast_to([0.1, 0.2, 0.3], body.nodes.shape)
    for normal, tangential, want in (
        (2.0, 0.0, (0, 0, 0.9)), (0.0, 2.0, (0.3, 0.6, 0)), (2.0, 2.0, (0.3, 0.6, 0.9)),
    ):  # fmt: skip
        at = Foundation(body, top, normal, tangential).evaluate(shift, 0.0)
        assert at.force.sum(axis=0) == approx(want, abs=1e-12)
        assert at.energy == approx(np.dot(want, (0.1, 0.2, 0.3)) / 2, rel=1e-12)


BODY = BODIES["hex8"]
SIDE = BODY.surface(lambda X: X[:, 2] < 1e-9)
TOP = BODIES["hex27"].surface(lambda X: X[:, 2] > 0.8 - 1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Line.of(BODY, [0, 1000]), r"nodes 0 … 1000; the body has 0 … 17"),
        (lambda: Line.of(BODY, [0.0, 1.0]), "expected numbers of nodes or a mask"),
        (lambda: Line.of(BODY, np.zeros(18, bool)), "at least one"),
        (lambda: Line.of(BODY, [0]), "no line: .* none meet at"),
        (
            lambda: Line.of(BODY, BODY.nodes_where(lambda X: X[:, 2] < 1e-9)),
            r"no line: .* more than two meet at \(",
        ),
        (lambda: LineLoad(BODY, Line.of(BODY, edge(BODY)), (1.0, 2.0)), "line load gave shape"),
        (lambda: PointLoad(BODY, [0, 1], np.ones((3, 3))), "point load gave shape"),
        (lambda: PointLoad(BODY, [-1], (0, 0, 1)), r"nodes -1 … -1; the body has"),
        (lambda: PointLoad(BODY, [3, 5, 3], (0, 0, 1)), "node 3 is named 2 times"),
        # A mask of whole numbers would load nodes 0 and 1 with all of it.
        (
            lambda: PointLoad(BODY, np.isin(np.arange(18), edge(BODY)).astype(int), (0, 0, 1)),
            r"18 zeros and ones, .* mask.astype\(bool\)",
        ),
        (
            lambda: LineLoad(BODY, [0, 1], (0, 0, 1.0)),
            r"got list \[0, 1\]; expected a Line \(Line.of",
        ),
        (lambda: Traction(BODY, "x+", (0, 0, 1.0)), "got str 'x.'; expected a Surface"),
        (lambda: Foundation(BODY, edge(BODY), 1.0), "got ndarray .*; expected a Surface"),
        (lambda: Traction(BODY, TOP, (0, 0, 1.0)), r"Surface has node \d+, .* another body"),
        (lambda: Foundation(BODY, SIDE, -1.0), "normal stiffness = -1 .*expected >= 0"),
        (lambda: Foundation(BODY, SIDE, 1.0, lambda e: e - 1), "tangential stiffness = -1 at e"),
        (lambda: Foundation(BODY, SIDE, np.ones(3)), "normal stiffness gave shape"),
        (lambda: Foundation(BODY, SIDE, np.inf), "normal stiffness is not finite"),
        (lambda: Foundation(BODY, SIDE, 1.0, np.nan), "tangential stiffness is not finite"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_springs_follow_e():
    u = state(BODY)
    used = Foundation(BODY, SIDE, lambda e: 1 + e)
    for e in (0.2, 0.9, 0.2):
        fresh = Foundation(BODY, SIDE, 1 + e).evaluate(u, e)
        np.testing.assert_allclose(used.evaluate(u, e).force, fresh.force, rtol=0, atol=1e-14)
