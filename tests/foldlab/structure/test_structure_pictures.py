"""Pictures of a structure: which states, which colours and angles, and what ParaView reads."""

import xml.etree.ElementTree as ET
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista
from matplotlib.colors import to_hex
from PIL import Image

from foldlab.structure import pictures

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def a_state(e, *angles):
    """Two panels beside each other, the second lifted by the load, and a strip for each angle."""
    strips = np.stack([SQUARE * 0.1 + [0, 0, e + k] for k in range(len(angles))])
    panels = (SQUARE, SQUARE[:3] + np.array([1.0, 0, e]))
    return SimpleNamespace(e=np.float64(e), panels=panels, strips=strips, angles=np.array(angles))


def a_folding(loads, folds=(1, -1, 0)):
    states = [a_state(e, *(e * np.arange(1.0, 1 + len(folds)))) for e in loads]
    hinges = [SimpleNamespace(crease=SimpleNamespace(fold=fold)) for fold in folds]
    structure = SimpleNamespace(pattern=SimpleNamespace(hinges=hinges))
    return SimpleNamespace(states=states, model=SimpleNamespace(structure=structure))


@pytest.mark.parametrize(
    ("loads", "count", "taken"),
    [
        ([0, 0.1, 0.2, 0.45, 0.8, 1.0], 3, [0, 0.45, 1.0]),
        ([0, 0.1, 0.2, 0.45, 0.8, 1.0], 4, [0, 0.45, 0.8, 1.0]),
        ([0, 0.1, 0.3], 3, [0, 0.1, 0.3]),  # of a path that ended early
        ([0, 1.0], 4, [0, 1.0]),  # none twice
    ],
)
def test_states_are_spread_evenly_over_the_load(loads, count, taken):
    states = [a_state(e, 0.0) for e in loads]
    assert [float(s.e) for s in pictures.picked(states, count)] == taken


def test_states_stand_side_by_side_in_one_box_in_millimetres():
    figure = pictures.plot_states(a_folding([0.0, 0.5, 1.0]), 3)
    assert [ax.get_title() for ax in figure.axes] == [
        f"{n} % of the contraction" for n in (0, 50, 100)
    ]
    for ax in figure.axes:
        # Of the panels in all states, so that they don't change their size.
        assert np.ravel([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]) == pytest.approx(
            [0, 2000, 0, 1000, 0, 1000], abs=1e-6
        )


@pytest.mark.parametrize(
    ("fold", "colour"), [(1, pictures.VALLEY), (-1, pictures.MOUNTAIN), (0, pictures.FREE)]
)
def test_strips_have_the_colour_of_their_fold(fold, colour):
    (ax,) = pictures.plot_states(a_folding([1.0], folds=(fold, fold)), 1).axes
    (faces,) = ax.collections
    drawn = [to_hex(own).upper() for own in faces.get_facecolor()]
    # Matplotlib draws from the back to the front.
    assert sorted(drawn) == sorted([pictures.PANEL] * 2 + [colour] * 2)
    assert len({pictures.PANEL, pictures.VALLEY, pictures.MOUNTAIN, pictures.FREE}) == 4


def test_angles_are_drawn_in_degrees_over_the_contraction_and_named_once():
    folding = a_folding([0.0, 0.5, 1.0], folds=(1, -1, -1))
    (ax,) = pictures.plot_angles(folding).axes
    valley, *mountains = [line for line in ax.lines if len(line.get_xdata()) == 3]
    assert valley.get_xydata() == pytest.approx(
        np.column_stack([[0, 50, 100], np.degrees([0, 0.5, 1.0])])
    )
    assert mountains[1].get_ydata()[-1] == pytest.approx(np.degrees(3.0))
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["valley", "mountain"]
    assert valley.get_color() != mountains[0].get_color() == mountains[1].get_color()


def test_a_series_holds_panels_and_strips_with_their_angles_over_the_load(tmp_path):
    folding = a_folding([0.0, 0.25])
    path = pictures.save_series(folding, tmp_path / "series")
    sets = list(ET.parse(path).getroot().iter("DataSet"))
    assert [float(s.get("timestep")) for s in sets] == [0.0, 0.25]
    last = pyvista.read(path.parent / sets[1].get("file"))
    assert last.n_cells == 5
    assert last.cell_data["angle"] == pytest.approx([0, 0, 0.25, 0.5, 0.75])
    assert last.cell_data["fold"].tolist() == [0, 0, 1, -1, 0]
    assert last.get_cell(1).points == pytest.approx(folding.states[1].panels[1])
    assert last.get_cell(3).points == pytest.approx(folding.states[1].strips[1])


def test_a_film_shows_every_state_and_holds_the_last(tmp_path):
    pictures.save_gif(a_folding([0.0, 0.4, 1.0]), tmp_path / "fold.gif")
    with Image.open(tmp_path / "fold.gif") as film:
        assert film.n_frames == 3
        times = []
        for k in range(3):
            film.seek(k)
            times.append(film.info["duration"])
    assert times[-1] > 10 * times[0] == 10 * times[1] > 0
