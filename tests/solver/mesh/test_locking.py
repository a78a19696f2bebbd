"""Locking is cured or said: thin curved bodies, linear elements, materials of ν near ½."""

import pickle
import re
import warnings

import numpy as np
import pytest
import reference_scenes as case
from reference_structures import arch, hemisphere, hemisphere_mesh

from solver.cases.unit import problem_p
from solver.cases.unit.mesh import mesh as unit_mesh
from solver.cases.unit.unit import Unit
from solver.mesh import locking
from solver.mesh.body import Body
from solver.mesh.locking import Locking, excess, thickness_at
from solver.mesh.structured import box, graded, polar, spherical
from solver.paths.steppers import LoadSteps
from solver.physics.elastic import Elastic
from solver.physics.materials import NeoHookean, StVenantKirchhoff
from solver.physics.rubber import MooneyRivlin

PINCHED = 0.0940
AT_ONCE = LoadSteps(rtol=1e-6, step=1.0, first=1.0)


def linear(scene):
    """Displacement (n, 3) under the load of e = 1 in linear theory."""
    system = scene.system(np.zeros(scene.size), 1.0)
    return scene.displacement(-system.factorise().solve(system.residual), 1.0)


def pinched(body):
    scene, at = hemisphere(body)
    return linear(scene)[at, 0].mean() / PINCHED


# -- curved thin bodies --------------------------------------------------------------------------


@pytest.mark.parametrize("n", [10, 16])
def test_the_default_element_bends_a_thin_curved_shell(n):
    body = Body.build(hemisphere_mesh(n))
    assert body.element == "hex20" and body.locking() == ()
    assert pinched(body) == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    "element, n, layers, abs_",
    [
        ("hex27", 10, 1, 0.1), ("hex27", 16, 1, 0.06), ("hex27", 16, 2, 0.06),
        ("tet10", 16, 1, 0.02),
    ],
)  # fmt: skip
def test_what_a_chosen_element_loses_on_it_is_said_beforehand(element, n, layers, abs_):
    body = Body.build(hemisphere_mesh(n, layers=layers, tets=element == "tet10"), element)
    with pytest.warns(Locking, match=f"^{element} elements are .* take hex20") as record:
        seen = pinched(body)
    (warning,) = (w.message for w in record)
    assert (warning.element, warning.cause) == (element, "curved")
    assert seen == pytest.approx(1 / (1 + warning.excess), abs=abs_)


def test_the_loss_that_is_told_is_one_of_displacement():
    ring = box([1, 1.1], np.linspace(0, np.pi, 9), [0, 0.1], shape=polar)
    (warning,) = Body.build(ring, "hex27").locking()
    told = int(re.search(r"they move about (\d+) % too little", str(warning))[1])
    # Stiffer by the excess, it moves by 1/(1 + excess) of what is right.
    assert 0.05 < warning.excess < 0.5
    assert told == pytest.approx(100 * (1 - 1 / (1 + warning.excess)), abs=0.5)


def test_shorter_elements_and_the_bent_axis_are_cures():
    assert excess(Body.build(hemisphere_mesh(40), "hex27")) < locking.NEGLIGIBLE
    ring = box([1, 1.01], np.linspace(0, np.pi, 9), [0, 0.1], shape=polar)
    assert excess(Body.build(ring, "hex27")) > 5
    assert excess(Body.build(ring, "hex27", bent=1)) < locking.NEGLIGIBLE
    assert Body.build(ring, bent=1).element == "hex27"


def test_separate_parts_that_curve_get_the_default_element_too():
    apart = box(
        [1, 1.01], np.linspace(0, np.pi, 10), [0, 0.1],
        keep=lambda X: np.abs(X[:, 1] - np.pi / 2) > 0.2, shape=polar,
    )  # fmt: skip
    body = Body.build(apart, parts=True)
    assert body.element == "hex20" and body.locking() == ()
    assert len(body.cells) == 8
    with pytest.raises(ValueError, match="the mesh is 2 parts"):
        Body.build(apart)


def test_a_ring_counts_by_its_own_thickness_however_thin_it_is_cut():
    angles = np.linspace(0, np.pi, 9)
    losses = [
        excess(Body.build(box([1, 1.01], angles, [0, width], shape=polar), "hex27"))
        for width in (0.1, 1e-3)
    ]
    assert losses[1] == pytest.approx(losses[0], rel=0.05) and losses[1] > 5


def test_thickness_is_that_of_the_body_not_of_a_cell():
    body = Body.build(hemisphere_mesh(4, layers=3, thickness=0.3), "hex27")
    flat = 0.3 * np.cos(np.pi / 8)  # between the cells' flat faces it is a little less
    centres = body.mesh.p[:, body.mesh.t].mean(axis=1).T
    radial = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    found = thickness_at(body, np.arange(len(body.cells)), radial)
    assert (found < 0.3 + 1e-9).all() and (found > flat**2).all()


def ordinary():
    """Bodies whose elements suit them."""
    a = np.linspace(0, np.pi / 4, 4)
    unit = Unit(
        E_ratio=0.1, rho_ratio=0.1, hinge_length=0.25, hinge_width=1, h_ratio=5,
        stiffness_to_weight=1, aspect=0.2, slenderness=4e-3, contraction=0.3,
    )  # fmt: skip
    skins = 1 + graded(0, 1, 12, toward="both", ratio=100)
    wide = box([1, 2], np.linspace(0, np.pi / 2, 7), [0, 0.01], shape=polar)
    return {
        "problem P": problem_p.mesh(1),
        "problem P, reduced": problem_p.mesh(1, "hex20"),
        "problem P, tetrahedra": problem_p.mesh(0, "tet10"),
        "unit": unit_mesh(unit, 1, mirrors=("x", "y")),
        "half a unit that curls": unit_mesh(unit, 1, mirrors=("x",), curls=True),
        "flat thin sheet": Body.build(box(np.arange(4.0), np.arange(4.0), [0, 1e-3])),
        "cube": Body.build(box([0, 1], [0, 1], [0, 1]), "hex8"),
        "flat ring, curved in its plane": Body.build(wide, "hex27"),
        "thick cylinder": case.cylinder().body,
        "thick sphere with thin layers at its faces": Body.build(
            box(skins, a, a, shape=spherical), "hex27"
        ),
        "arch along its bent axis": arch(hinged=False)[0].body,
    }


def test_units_and_ordinary_bodies_are_not_warned_of():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name, body in ordinary().items():
            assert body.locking() == (), name
            Elastic(body, NeoHookean(1.0, 0.49 if body.element != "hex8" else 0.4))


# -- bodies that bend on the way -----------------------------------------------------------------


def test_a_path_says_that_its_elements_lock_where_they_bent():
    def path(bent):
        scene = case.cantilever(tip_load=1, h=1e-3, n=10, bent=bent)
        return case.walked(scene)

    (warning,) = path(None).warnings
    assert isinstance(warning, Locking) and warning.cause == "curved" and warning.excess > 0.1
    assert "at the end of the path" in str(warning)
    assert path(0).warnings == ()


def test_a_unit_folds_without_a_warning():
    scene = problem_p.scene(problem_p.mesh(1), g=-0.3)
    path = case.walked(scene)
    assert path.last.e == 1 and path.warnings == ()


def test_a_path_says_that_the_shape_at_rest_locks():
    scene, _ = hemisphere(Body.build(hemisphere_mesh(8), "hex27"))
    path = case.walked(scene, AT_ONCE)
    assert [w.cause for w in path.warnings] == ["curved"]
    assert "at the end" not in str(path.warnings[0])
    again = pickle.loads(pickle.dumps(path.warnings[0]))
    assert (str(again), again.excess) == (str(path.warnings[0]), path.warnings[0].excess)


@pytest.mark.parametrize("tets", [False, True])
def test_a_path_says_that_linear_elements_are_too_long_to_bend(tets):
    element = "tet4" if tets else "hex8"
    scene, at = hemisphere(Body.build(hemisphere_mesh(10, tets=tets), element))
    (warning,) = case.walked(scene, AT_ONCE).warnings
    assert (warning.element, warning.cause) == (element, "linear")
    assert linear(scene)[at, 0].mean() / PINCHED < 0.01 and warning.excess > 100


def test_a_thin_slice_that_stays_plane_is_no_shell():
    scene, _ = case.cook(element="hex8", n=4, plane="strain")
    assert excess(scene.body, np.eye(3)[[2] * len(scene.body.nodes)]) > 1  # were it to bend
    assert case.walked(scene, AT_ONCE).warnings == ()


# -- nearly incompressible materials -------------------------------------------------------------


@pytest.mark.parametrize(
    "element, nu, said",
    [
        ("hex8", 0.45, False), ("hex8", 0.4999, True), ("tet4", 0.49, True),
        ("hex27", 0.49, False), ("hex27", 0.4999, True), ("tet10", 0.4999, True),
        ("hex20", 0.4999, False),
    ],
)  # fmt: skip
def test_a_ratio_near_a_half_is_said_where_the_element_cannot_follow(element, nu, said):
    body = Body.build(box([0, 1, 2], [0, 1], [0, 1], tets=element.startswith("tet")), element)
    ratios = np.full(len(body.cells), 0.3)
    ratios[-1] = nu
    for material in (NeoHookean(2.0, nu), StVenantKirchhoff(1.0, ratios), MooneyRivlin(1, 1, nu)):
        with warnings.catch_warnings(record=True) as record:
            warnings.simplefilter("always")
            term = Elastic(body, material)
        assert [w.message for w in record] == list(term.locking)
        assert [w.cause for w in term.locking] == ["incompressible"] * said
    assert Elastic(body, NeoHookean(1.0, ratios), cells=ratios == 0.3).locking == ()


def test_linear_hexahedra_of_a_ratio_near_a_half_are_too_stiff():
    options = {"n": 8, "nu": 0.4999, "E": 240.565, "load": 10, "plane": "strain", "ratio": 10}

    def drop(element):
        scene, right = case.cook(element=element, **options)
        end = np.unique(right.nodes)
        return scene, linear(scene)[end, 1].mean()

    (scene, stiff), (_, right) = drop("hex8"), drop("hex20")
    assert stiff < 0.4 * right
    path = case.walked(scene, AT_ONCE)
    assert [w.cause for w in path.warnings] == ["incompressible"]
