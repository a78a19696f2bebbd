"""The unit's mesh: volumes, free surfaces, and columns as fine as the curling to resolve."""

from dataclasses import replace

import numpy as np
import pytest
from folding_units import NARROW, P

from solver.cases.unit import mesh as unit_mesh

STRIPED = replace(P, hinge_width=0.8, strips=3, strip_share=0.6)
PLANES = ((), ("x",), ("y",), ("x", "y"))
WIDE = replace(P, aspect=0.4)


@pytest.mark.parametrize("unit", [P, NARROW, STRIPED, replace(STRIPED, strips=2)])
@pytest.mark.parametrize("mirrors", PLANES)
@pytest.mark.parametrize("level", [0, 2])
def test_layers_have_the_volumes_of_the_groups(unit, mirrors, level):
    body = unit_mesh.mesh(unit, level, mirrors=mirrors)
    share = 0.5 ** len(mirrors)
    hinge = unit.hinge_length * unit.hinge_width * unit.aspect
    covered = unit.strip_share if unit.strips else 1.0
    active, passive = body.cells_of("active"), body.cells_of("passive")
    assert not (active & passive).any() and (active | passive).all()
    assert body.weights[active].sum() == pytest.approx(
        share * hinge * covered * unit.h_ratio * unit.slenderness
    )
    assert body.weights[passive].sum() == pytest.approx(
        share * unit.slenderness * (hinge + (1 - unit.hinge_length) * unit.aspect)
    )
    low, high = body.nodes.min(axis=0), body.nodes.max(axis=0)
    assert high == pytest.approx([unit.aspect / 2, 0.5, (1 + unit.h_ratio) * unit.slenderness])
    assert low == pytest.approx(
        [0 if "x" in mirrors else -unit.aspect / 2, 0 if "y" in mirrors else -0.5, 0]
    )


@pytest.mark.parametrize("unit", [P, NARROW])
def test_meshes_conform(unit):
    # Faces that do not match would be boundary inside of the body.
    body = unit_mesh.mesh(unit, 1, mirrors=())
    area = body.surface(body.mesh.boundary_facets()).weights.sum()
    b_s, b_i, l_i = unit.aspect, unit.width, unit.hinge_length
    h, top = unit.slenderness, unit.active
    flat = 2 * (b_s * (1 - l_i) + b_i * l_i)
    panels = 2 * (2 * (b_s + (1 - l_i) / 2) - b_i) * h
    assert area == pytest.approx(flat + panels + 2 * l_i * h + 2 * (l_i + b_i) * top)


def test_strips_have_free_sides():
    solid = unit_mesh.mesh(replace(STRIPED, strips=0), 1, mirrors=())
    body = unit_mesh.mesh(STRIPED, 1, mirrors=())
    area, before = (b.surface(b.mesh.boundary_facets()).weights.sum() for b in (body, solid))
    n, l_i, top = STRIPED.strips, STRIPED.hinge_length, STRIPED.active
    # n strips have 2n long sides in place of 2; of the ends only the covered share is left.
    ends = 2 * (1 - STRIPED.strip_share) * STRIPED.width * top
    assert area - before == pytest.approx((2 * n - 2) * l_i * top - ends)


@pytest.mark.parametrize("curls", [False, True])
def test_columns_across_the_hinge_turn_by_no_more_than_the_level_allows(curls):
    body = unit_mesh.mesh(WIDE, 1, mirrors=("x", "y"), element="hex27", heavy=False, curls=curls)
    # 27-node cells have a node in their middle.
    x = np.unique(np.round(body.nodes[body.nodes[:, 0] <= WIDE.width / 2 * (1 + 1e-9), 0], 12))
    columns = (len(x) - 1) / 2
    turning = min(WIDE.curvature * WIDE.width / 2, np.pi)
    needed = np.ceil(turning / unit_mesh.LEVELS[1].turn)
    assert needed > 2
    assert columns >= needed if curls else columns < needed


@pytest.mark.parametrize("strips", [1, 2, 5])
@pytest.mark.parametrize("curls", [False, True])
def test_finer_meshes_are_finer_across_strips_too(strips, curls):
    unit = replace(STRIPED, strips=strips)
    # Of a body of quadratic elements every other coordinate is a midpoint.
    widest = [
        np.diff(np.unique(unit_mesh.mesh(unit, level, mirrors=("x", "y"), curls=curls)
                          .nodes[:, 0].round(9))[::2])[:4].max()
        for level in (0, 3)
    ]  # fmt: skip
    assert widest[1] <= unit.width / 2 / (4 if curls else 3) * (1 + 1e-9)
    assert widest[1] <= widest[0]


@pytest.mark.parametrize("h_ratio", [0.1, 0.5, 1.0, 2.0, 10.0])
def test_each_level_has_more_elements_through_the_layers(h_ratio):
    """Two levels alike through the layers agree by chance, and nothing is known of the error."""
    unit = replace(P, h_ratio=h_ratio)
    counts = []
    for level in range(len(unit_mesh.LEVELS)):
        body = unit_mesh.mesh(unit, level, mirrors=("x", "y"))
        z = np.unique(np.round(body.nodes[:, 2] / unit.slenderness, 9))
        counts.append([(z < 1 - 1e-6).sum(), (z > 1 + 1e-6).sum()])
    # Two planes of nodes per element.
    assert (np.diff(counts, axis=0) >= 2).all()
