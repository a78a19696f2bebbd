"""Furrow, neural tube, patterns that a user brings, and elastic scenes made to creep."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import reference_scenes as case
from pytest import approx

from experiments import viscous_rates
from solver.cases.tissue import furrow, neural_tube
from solver.cases.tissue.model import Tissue, ramp
from solver.cases.unit import model as folding_unit
from solver.cases.unit import problem_p
from solver.cases.unit.choices import Meshing
from solver.cases.unit.unit import Unit
from solver.equilibrium.scene import Scene
from solver.mesh.body import Body
from solver.output import write_vtu
from solver.paths.continuation import trace
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.materials import NeoHookean
from solver.physics.patterns import Pattern, read_pattern
from solver.physics.supports import Fixed
from solver.viscous.evolution import TimeSteps, Unresolved, evolve, start, viscous
from solver.viscous.rheology import SLS, Maxwell
from solver.viscous.term import softened

SHELL = furrow.Counts(3, 4, 4, 1)
PLATE = neural_tube.Counts(3, 4, 1)


def grown(model, ratio=5.0, n=10, **options):
    """The path in time of a contraction over ``ratio`` relaxation times."""
    t_fin = ratio * model.tissue.tau
    scene = model.viscous(t_fin / n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unresolved)
        path = evolve(
            scene,
            start(scene),
            TimeSteps(1e-7, t_fin / n, **options),
            until=t_fin,
            load=ramp(t_fin),
            breaks=(t_fin,),
        )
    assert path.reached
    return path, scene.displacement(path.last.x, 1.0)


def test_a_tissue_s_time_is_the_shortest_of_its_cells():
    uneven = Tissue(E_m=np.array([5.0, 10.0, 5.0]), eta=np.array([1.0, 1.0, 4.0]))
    assert uneven.tau == approx(0.1) and Tissue(eta=2.0).tau == approx(0.4)


def elastic(model, material):
    scene = model.elastic(material)
    path = trace(scene, np.zeros(scene.size), LoadSteps(1e-8, 0.2), max_steps=50, events=False)
    assert path.reached
    return scene.displacement(path.last.x, 1.0)


# -- furrow --------------------------------------------------------------------------------------


@pytest.mark.parametrize("element", ["hex27", "hex20", "tet4"])
def test_the_shell_is_an_ellipsoid(element):
    shape = furrow.Shape()
    model = furrow.build(SHELL, element=element)
    outer = np.array([shape.long, shape.across, shape.across])
    inner = outer - shape.thickness
    ball = 4 / 3 * np.pi
    rel = 1e-3 if element != "tet4" else 0.15
    still = model.measure(np.zeros_like(model.body.nodes))
    assert still.cavity == approx(ball * inner.prod(), rel=rel)
    assert still.tissue == approx(ball * (outer.prod() - inner.prod()), rel=rel)
    assert still.tissue == approx(4 * model.body.weights.sum(), rel=1e-4 if rel < 0.1 else 1e-2)
    assert still.depth == still.indentation == 0
    X = model.body.nodes
    assert shape.depth(X).min() == approx(0, abs=1e-9) and shape.depth(X).max() == approx(1)
    # β: 1 at the midline's outer side, nothing dorsally and inside.
    beta = shape.beta(np.array([[0, 0, -0.4], [0, 0, 0.4], [0, 0, -0.35], [1, 0, 0]]))
    assert beta[0] == approx(1) and (beta[1:] < 0.01).all()
    assert model.beta.min() >= 0 and model.beta.max() > 0.4


def test_a_furrow_forms_and_the_mirror_planes_hold():
    model = furrow.build(SHELL, element="hex20", contraction=0.5)
    path, u = grown(model)
    found = model.measure(u)
    assert found.depth > 0.01 and found.indentation > 0.1
    assert found.cavity < 0.97 * model.measure(0 * u).cavity
    X = model.body.nodes
    for axis in (0, 1):
        assert np.abs(u[np.abs(X[:, axis]) < 1e-9, axis]).max() == 0
    taken = [s.dissipated for s in path.states]
    assert (np.diff(taken) > 0).all()


def test_contraction_shrinks_and_its_sign_matters():
    whole = furrow.build(SHELL, element="hex20", contraction=0.2, beta=lambda X: X[..., 0] * 0 + 1)
    _, u = grown(whole, n=4)
    # Everywhere alike it is a scaling by 1/(1 + g β) without any stress.
    assert whole.measure(u).tissue == approx(whole.measure(0 * u).tissue / 1.2**3, rel=1e-6)


def test_a_yolk_keeps_the_cavity_and_flattens_the_furrow():
    empty = furrow.build(SHELL, element="hex20")
    _, u = grown(empty)
    still, free = empty.measure(0 * u), empty.measure(u)
    found = {}
    for yolk in (1.0, 100.0):
        full = furrow.build(SHELL, element="hex20", yolk=yolk)
        _, v = grown(full)
        found[yolk] = full.measure(v)
        (term,) = full.terms
        p = term.pressure(v, 1.0)
        assert p == approx(yolk * 5.0 * (1 - found[yolk].cavity / still.cavity), rel=1e-6)
        assert 0.001 < p < 0.1
    assert free.cavity < 0.97 * still.cavity
    assert found[100.0].cavity == approx(still.cavity, rel=1e-3)
    assert free.cavity < found[1.0].cavity < found[100.0].cavity
    assert found[100.0].indentation < found[1.0].indentation < 0.6 * free.indentation
    assert empty.terms == ()


def test_growth_too_fast_for_the_step_is_warned_of():
    model = furrow.build(SHELL, element="hex20", tissue=Tissue(eta=100.0))
    scene = model.viscous(0.05)
    with pytest.warns(Unresolved, match=r"lets term 'viscous' grow by 0\.0\d+ in a step; take dt"):
        evolve(scene, start(scene), TimeSteps(1e-6, 0.05), until=0.1)


# -- neural tube ---------------------------------------------------------------------------------


def test_the_plate_is_half_a_cylinder_and_closes_in_front_first():
    shape = neural_tube.Shape()
    model = neural_tube.build(PLATE, element="hex20")
    still = model.measure(np.zeros_like(model.body.nodes))
    assert still.tissue == approx(np.pi * shape.thickness * shape.length, rel=1e-3)
    assert still.closure == still.closure_posterior == approx(2 - shape.thickness)
    _, u = grown(model, n=12)
    found = model.measure(u)
    assert found.closure < 0.03 < 0.08 < found.closure_middle < 0.6 * found.closure_posterior
    assert found.closed > 0.1
    # Both halves meet at the mirror plane, and don't pass it by more than contact may.
    z = (model.body.nodes + u)[:, 2]
    assert z.min() > -neural_tube.TOUCHING * shape.thickness
    # Supports hold nothing but rigid motion.
    feet = [f for f in model.fixed if len(np.atleast_1d(f.nodes)) < 3]
    force = model.elastic(model.tissue.slow()).terms[0].evaluate(
        elastic(neural_tube.build(PLATE, element="hex20", contraction=0.05), model.tissue.slow()),
        0.05 / 0.4, 1,
    ).force  # fmt: skip
    size = np.abs(force).max()
    for f in feet:
        assert np.abs(force[f.nodes] @ np.asarray(f.direction)).max() < 1e-6 * size


# -- limits --------------------------------------------------------------------------------------


def unlike(build, counts, **options):
    """A model whose passive part alone relaxes, so that its limits differ."""
    beta = build(counts, **options).beta
    E_m = 20.0 * np.maximum(1 - beta / beta.max(), 1e-3)
    return build(counts, tissue=Tissue(E_m=E_m, eta=0.2 * E_m), **options)


def test_slow_growth_is_elastic_and_fast_growth_instantaneous():
    model = unlike(furrow.build, SHELL, element="hex20", contraction=0.3)
    slow, fast = (elastic(model, m) for m in (model.tissue.slow(), model.tissue.fast()))
    size = np.abs(slow).max()
    assert np.abs(slow - fast).max() > 0.05 * size
    for ratio, limit in ((1e-3, fast), (1e4, slow)):
        _, u = grown(model, ratio, n=5)
        assert np.abs(u - limit).max() < 5e-3 * size


def test_of_one_tissue_without_loads_both_limits_are_the_same():
    model = furrow.build(SHELL, element="hex20", contraction=0.3)
    slow, fast = (elastic(model, m) for m in (model.tissue.slow(), model.tissue.fast()))
    np.testing.assert_allclose(slow, fast, atol=1e-9)


def test_global_unknowns_give_the_same_step():
    config = replace(viscous_rates.TINY, contraction=0.3)
    found = viscous_rates.cost(config, "hex8:0")
    assert found["difference"] < 1e-9
    assert found["global_unknowns"] > 5 * found["local_unknowns"]


# -- elastic scenes made to creep ----------------------------------------------------------------


def test_a_hinge_that_creeps_goes_from_its_fast_to_its_slow_angle():
    body = problem_p.mesh(0, "hex20")
    active = body.cells_of("active")
    angles = {}
    for name, E in (("fast", 1.0), ("slow", 0.1)):
        scene = problem_p.scene(body, -0.1)
        (term,) = scene.terms
        hard = Elastic(body, NeoHookean(np.where(active, E, 1.0), 0.3), term.growth)
        path = trace(scene.with_terms([hard]), np.zeros(scene.size), LoadSteps(1e-8, 0.25),
                     max_steps=50, events=False)  # fmt: skip
        angles[name] = problem_p.fold_angle(scene, path.last.x, 1.0)
    assert abs(angles["slow"] - angles["fast"]) > 0.1
    scene = softened(problem_p.scene(body, -0.1), SLS(0.1, 0.9, 0.3, 0.9), dt=1e-4, cells=active)
    assert [t.name for t in scene.terms] == ["viscous", "elastic"]
    stepper = TimeSteps(1e-8, 2e-4, tolerance=1e-3)
    path = evolve(scene, start(scene), stepper, until=100.0, load=ramp(1e-3), breaks=(1e-3,))
    assert path.reached
    at = int(np.flatnonzero(path.times == 1e-3)[0])
    found = [problem_p.fold_angle(scene, path.states[k].x, 1.0) for k in (at, -1)]
    assert found == [approx(angles["fast"], rel=5e-3), approx(angles["slow"], rel=5e-3)]


def test_a_unit_on_the_ground_sags_as_its_hinge_relaxes():
    unit = Unit(
        E_ratio=0.1, rho_ratio=1.0, hinge_length=0.25, hinge_width=1.0, h_ratio=5.0,
        stiffness_to_weight=0.1, aspect=0.2, slenderness=4e-3, contraction=0.1,
    )  # fmt: skip
    model = folding_unit.build(unit, Meshing(0, "hex20"))
    hinge = model.body.cells_where(lambda X: np.abs(X[:, 1]) < unit.hinge_length / 2)
    E = np.where(model.body.cells_of("active"), unit.E_ratio, 1.0)
    scene = softened(model.scene, SLS(0.5 * E, 0.5 * E, 0.3, 0.5 * E), dt=1e-3, cells=hinge)
    stepper = TimeSteps(1e-7, 1e-3, tolerance=5e-3)
    path = evolve(scene, start(scene), stepper, until=10.0, load=ramp(0.02), breaks=(0.02,))
    assert path.reached
    tip = np.argmax(model.body.nodes[:, 1])
    height = [scene.displacement(s.x, s.e)[tip, 2] for s in path.states]
    at = int(np.flatnonzero(path.times == 0.02)[0])
    assert height[-1] < 0.8 * height[at]
    assert model.gaps(path.last.x, 1.0).min() > -0.1 * unit.slenderness


def test_a_shell_under_pressure_creeps_to_the_elastic_stretch():
    shell = case.sphere(n=3, e_to=0.01)
    scene = softened(shell, SLS(1.0, 3.0, 0.3, 3.0), dt=1e-3)
    path = evolve(
        scene, start(scene), TimeSteps(1e-9, 1e-3, tolerance=1e-3), until=60.0, load=lambda t: 1.0
    )
    assert path.reached
    first, last = (case.inner_stretch(scene, path.states[k].x, 1.0) for k in (1, -1))
    static = trace(shell, np.zeros(shell.size), LoadSteps(1e-9, 0.5), max_steps=20, events=False)
    assert last == approx(case.inner_stretch(shell, static.last.x, 1.0), rel=1e-3)
    assert first - 1 < 0.3 * (last - 1)


def test_swapping_keeps_supports_and_refuses_what_is_not_there():
    shell = case.sphere(n=3)
    with pytest.raises(ValueError, match="no Elastic term 'skin'; there are: elastic"):
        softened(shell, Maxwell(1.0, 0.3, 1.0), dt=0.1, term="skin")
    scene = softened(shell, Maxwell(1.0, 0.3, 1.0), dt=0.1)
    assert scene.solver is shell.solver and scene.size == shell.size
    lonely = Scene(scene.body, [viscous(scene)[0]], fixed=[Fixed(np.arange(3), [1, 0, 0])])
    open_load = case.sphere(n=3, closed=False).terms[1]
    with pytest.raises(ValueError, match="not symmetric"):
        lonely.with_terms([*lonely.terms, open_load])


# -- patterns ------------------------------------------------------------------------------------


def table(path, points, values, header="x,y,z,beta"):
    np.savetxt(path, np.column_stack([points, values]), delimiter=",", header=header, comments="")
    return path


def test_a_field_of_ones_own_drives_the_furrow(tmp_path):
    shape, fine = furrow.Shape(), furrow.build(furrow.Counts(6, 8, 8, 1))
    points, values = fine.body.nodes, shape.beta(fine.body.nodes)
    exact = furrow.build(SHELL).beta
    mine = [
        read_pattern(table(tmp_path / "beta.csv", points, values)),
        read_pattern(write_vtu(tmp_path / "beta.vtu", fine.body, point_data={"beta": values})),
    ]
    for pattern in mine:
        found = furrow.build(SHELL, beta=pattern).beta
        assert np.abs(found - exact).max() < 0.1
        assert np.abs(found - exact).mean() < 0.01


def test_bad_fields_are_refused(tmp_path):
    model = furrow.build(SHELL, element="hex20")
    X = model.body.nodes
    with pytest.raises(ValueError, match=r"beta runs from .* to 2; expected values in \[0, 1\]"):
        furrow.build(SHELL, beta=lambda X: X[..., 0] * 0 + 2)
    with pytest.raises(ValueError, match="beta has shape"):
        furrow.build(SHELL, beta=np.ones(3))
    half = X[X[:, 2] < 0]
    short = read_pattern(table(tmp_path / "half.csv", half, half[:, 0]))
    with pytest.raises(ValueError, match=r"half\.csv does not cover the mesh: .* check units"):
        furrow.build(SHELL, element="hex20", beta=short)
    # A hollow body's hull is no cover.
    with pytest.raises(ValueError, match="does not cover the mesh"):
        Pattern(X, X[:, 0])(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="no column 'beta'; there are: x, y, z, b"):
        read_pattern(table(tmp_path / "b.csv", X, X[:, 0], "x,y,z,b"))
    (tmp_path / "words.csv").write_text("x,y,z,beta\n1,2,3,much\n")
    with pytest.raises(ValueError, match=r"words\.csv is no table of numbers"):
        read_pattern(tmp_path / "words.csv")
    with pytest.raises(
        ValueError, match="no point field 'beta' of numbers; there are: displacement"
    ):
        read_pattern(write_vtu(tmp_path / "b.vtu", model.body, 0 * X))
    with pytest.raises(ValueError, match="there is no file"):
        read_pattern(tmp_path / "none.csv")
    with pytest.raises(ValueError, match=r"ends in \.csv or \.vtu"):
        read_pattern(table(tmp_path / "beta.txt", X, X[:, 0]))
    with pytest.raises(ValueError, match="in one plane"):
        Pattern(X * (1, 1, 0), X[:, 0])
    with pytest.raises(ValueError, match="not finite at its point 0"):
        Pattern(X, np.full(len(X), np.nan))


def test_bad_shapes_are_refused():
    for bad in ({"thickness": 0.5}, {"across": 0.0}):
        with pytest.raises(ValueError, match="expected"):
            furrow.Shape(**bad)
    for bad in ({"thickness": 1.5}, {"posterior": 2.0}, {"length": -1.0}):
        with pytest.raises(ValueError, match="expected"):
            neural_tube.Shape(**bad)
    with pytest.raises(ValueError, match="level 9; there are 0 to 3"):
        furrow.build(9)
    with pytest.raises(ValueError, match="expected a time > 0"):
        ramp(0.0)
    assert isinstance(furrow.build(SHELL).body, Body)
