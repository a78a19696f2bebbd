"""How does a neural tube close, where first, and on which mesh is that to be believed?

A half-cylindrical plate of a standard linear solid contracts along two lines on its inner side,
most at the anterior end (§5.5.4). Pictures of the whole at 0, half and full contraction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solver.cases.tissue import neural_tube

from . import furrow
from .common import main
from .furrow import panel, study, warped


@dataclass(frozen=True)
class Config(furrow.Config):
    """As that of the furrow."""

    meshes: tuple[str, ...] = ("tet4:3", "hex20:1", "hex20:2", "hex27:0", "hex27:1", "hex27:2")
    contraction: float = 0.4


TINY = Config(meshes=("hex20:0",), steps=5, contraction=0.05)


def run(config: Config, tracker) -> dict[str, Any]:
    return study(
        config, tracker, "neural_tube", neural_tube.build,
        ("closure", "closure_middle", "closure_posterior"),
        ("distance of the edges (radii):\nanterior —, middle - -, posterior · ·",
         ("closed", "fraction of the edges that touch")), draw,
    )  # fmt: skip


def draw(model, shapes, path) -> None:
    """The whole from above at an angle with its anterior end in front, and straight from above."""
    import pyvista

    middle = model.body.nodes[:, 0].max() / 2
    plotter = pyvista.Plotter(
        off_screen=True, window_size=(500 * len(shapes), 800), shape=(2, len(shapes)), border=False
    )
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    for k, shape in enumerate(warped(model, shapes, ("z",))):
        panel(plotter, (0, k), shape, ((1, 0.8, 0.7), (0, 1, 0), (middle, -0.4, 0), 2.1))
        panel(plotter, (1, k), shape, ((0, 1, 0), (0, 0, -1), (middle, 0, 0), 1.9))
    plotter.screenshot(str(path))
    plotter.close()


if __name__ == "__main__":
    main(__doc__, run, Config, TINY)
