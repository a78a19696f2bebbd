"""The unit's mesh across the hinge: as fine as the curling that it has to resolve."""

import numpy as np
import pytest

from solver.cases.unit import mesh as unit_mesh
from solver.cases.unit.unit import Unit

P = Unit(
    E_ratio=0.1, rho_ratio=1.0, hinge_length=0.2, hinge_width=1.0, h_ratio=5.0,
    stiffness_to_weight=1.0, aspect=0.4, slenderness=4e-3, contraction=0.3,
)  # fmt: skip


@pytest.mark.parametrize("curls", [False, True])
def test_columns_across_the_hinge_turn_by_no_more_than_the_level_allows(curls):
    body = unit_mesh.mesh(P, 1, mirrors=("x", "y"), element="hex27", heavy=False, curls=curls)
    # 27-node cells have a node in their middle.
    x = np.unique(np.round(body.nodes[body.nodes[:, 0] <= P.width / 2 * (1 + 1e-9), 0], 12))
    columns = (len(x) - 1) / 2
    turning = min(P.curvature * P.width / 2, np.pi)
    needed = np.ceil(turning / unit_mesh.LEVELS[1].turn)
    assert needed > 2
    assert columns >= needed if curls else columns < needed
