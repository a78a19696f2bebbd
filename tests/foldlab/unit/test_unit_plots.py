"""Figures of one unit: what is drawn where, and what it is called."""

import numpy as np
import pytest
from matplotlib.image import imsave
from PIL import Image

from foldlab.unit import plots, render
from foldlab.unit.record import _title

HISTORY = [
    {"contraction": 0.0, "m1": 0.0, "m2": 0.0},
    {"contraction": 0.1, "m1": 0.4, "m2": 0.1},
    {"contraction": 0.2, "m1": 0.9, "m2": 0.3},
]
LIMITS = (0.6, 0.25)


def lines(ax):
    return {line.get_label(): line.get_xydata().tolist() for line in ax.get_lines()}


@pytest.mark.parametrize("loads", [None, [0.0, 1.0, 2.0]])
def test_angles_stand_over_the_contraction_against_the_limits_that_tell_folded_and_curled(loads):
    events = [{"kind": "snap", "contraction": 0.1}]
    figure = plots.plot_angles(HISTORY, 0.2, LIMITS, events, loads)
    x = np.array([0.0, 10.0, 20.0]) if loads is None else np.array(loads)
    names = ("m1", "folded above"), ("m2", "curled above")
    for ax, (name, says), limit in zip(figure.get_axes(), names, LIMITS, strict=True):
        curve = ax.get_lines()[0].get_xydata()
        np.testing.assert_allclose(curve, np.column_stack([x, [h[name] for h in HISTORY]]))
        # What counts as folded grows with the contraction, and stays while it is released.
        start = 0.0 if loads is None else limit
        assert lines(ax)[says] == [[0, start], [pytest.approx(x[-1]), limit]]
        assert ax.get_xlim() == pytest.approx((0, 1.03 * x[-1]))
        assert ("%" in ax.get_xlabel()) == (loads is None)
    assert len(figure.get_axes()[0].texts) == (loads is None) and not figure.get_axes()[1].texts


def test_events_too_near_for_two_names_share_one():
    def named(*events):
        told = [{"kind": kind, "contraction": g} for kind, g in events]
        ax = plots.plot_angles(HISTORY, 0.2, LIMITS, told).get_axes()[0]
        at = [line.get_xdata()[0] for line in ax.get_lines() if line.get_linestyle() == ":"]
        return at, [(text.get_text(), text.xy[0]) for text in ax.texts]

    # Within 3.5 % of the axis, here 0.72 % contraction, the later one has no room for its name.
    at, names = named(("b", 0.1071), ("a", 0.1), ("c", 0.15))
    assert at == pytest.approx([10.0, 10.71, 15.0])
    assert names == [("a, b", 10.0), ("c", 15.0)]
    assert named(("a", 0.1), ("b", 0.1075))[1] == [("a", 10.0), ("b", pytest.approx(10.75))]
    assert named(("a", 0.1), ("a", 0.101))[1] == [("a", 10.0)]


def flat():
    """The four curves of a flat sheet whose middle lies at z = 0.02."""
    curves = np.zeros((4, 201, 3))
    curves[0, :, 1] = np.linspace(-0.5, 0.5, 201)
    curves[..., 2] = 0.02
    return curves


@pytest.mark.parametrize("ground", [True, False])
def test_from_the_side_layers_are_as_thick_and_the_active_one_as_long_as_they_are(ground):
    design = {"slenderness": 0.04, "h_ratio": 2.0, "hinge_length": 0.2}
    figure = plots.plot_side(np.stack([flat(), flat()]), design, ["a", "b"], ground=ground)
    left, right = figure.get_axes()
    assert [left.get_title(), right.get_title()] == ["a", "b"]
    passive, active, *floor = (patch.get_extents() for patch in right.patches)
    inverse = right.transData.inverted()
    boxes = [inverse.transform_bbox(e).extents for e in (passive, active)]
    assert boxes[0] == pytest.approx([-0.5, 0.0, 0.5, 0.04], abs=1e-9)
    assert boxes[1] == pytest.approx([-0.1, 0.04, 0.1, 0.12], abs=1e-9)
    assert len(floor) == ground
    if ground:
        low, high = inverse.transform_bbox(floor[0]).extents[[1, 3]]
        assert (low, high) == pytest.approx((-0.02, 0.0))
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["passive", "active", *["ground"] * ground, "C1, along the sheet"]


@pytest.fixture
def picture(tmp_path):
    """A picture twice as wide as high, red on the left and blue on the right."""
    pixels = np.zeros((100, 200, 3))
    pixels[:, :100, 0], pixels[:, 100:, 2] = 1, 1
    imsave(tmp_path / "a.png", pixels)
    return tmp_path / "a.png"


def test_rendered_pictures_stand_side_by_side_with_what_their_colours_mean(picture):
    figure = plots.plot_shapes([picture] * 3, ["a", "b", "c"], ground=True)
    assert [ax.get_title() for ax in figure.get_axes()] == ["a", "b", "c"]
    # As high as a third of the width allows, and room for title and legend.
    assert figure.get_size_inches() == pytest.approx((9.0, 9.0 / 3 / 2 + 0.62))
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["passive", "active", "ground", *plots.CURVE_NAMES]


def test_the_scale_of_strain_ends_at_the_most_in_per_cent(picture):
    figure = plots.plot_strain(picture, 0.08, "title")
    ax, scale = figure.get_axes()
    assert ax.get_title() == "title" and "%" in scale.get_xlabel()
    assert scale.get_xlim() == pytest.approx((0.0, 8.0))
    assert figure.get_size_inches() == pytest.approx((6.0, 6.0 / 2 + 1.2))


def test_the_last_picture_of_a_film_stays(picture, tmp_path):
    plots.write_animation(tmp_path / "a.gif", [picture] * 3, ["1", "2", "3"])
    with Image.open(tmp_path / "a.gif") as film:
        times = []
        for k in range(film.n_frames):
            film.seek(k)
            times.append(film.info["duration"])
        # Under a title of 30 pixels.
        assert film.size == (200, 130) and film.info["loop"] == 0
        pixels = np.asarray(film.convert("RGB"), int)
    assert times == [150, 150, 1500]
    assert (pixels[80, 50] > [200, -1, -1]).all() and (pixels[80, 150] > [-1, -1, 200]).all()
    assert [path.name for path in tmp_path.glob("*.gif")] == ["a.gif"]
    assert not list(tmp_path.glob(".*"))


def test_a_view_holds_all_points_about_its_middle():
    rng = np.random.default_rng(0)
    clouds = [rng.uniform(-1, 1, (50, 3)) * (0.2, 2.0, 0.1) + (3, 1, 2), rng.uniform(2, 3, (9, 3))]
    focus, reach, (width, height) = render._frame(clouds)
    towards = render.TOWARDS / np.linalg.norm(render.TOWARDS)
    right = np.cross([0, 0, 1], towards)
    right /= np.linalg.norm(right)
    at = np.vstack(clouds) - focus
    across, up = at @ right, at @ np.cross(towards, right)
    assert height == 2 * reach
    for seen, size in ((across, width), (up, height)):
        assert seen.max() == pytest.approx(-seen.min())
        # Beside the points remains a twentieth of the longer side.
        pad = size - np.ptp(seen)
        assert pad == pytest.approx(0.05 * max(np.ptp(across), np.ptp(up)))


@pytest.mark.parametrize(
    ("load", "heavy", "title"),
    [
        (0, True, "at rest"),
        (0, False, "flat"),
        (0.5, True, "15 % contraction"),
        (1.0, False, "15 % contraction"),
        (1.25, False, "15 %, released by 25 %"),
        (2, True, "15 %, released to isotropic"),
    ],
)
def test_a_state_is_titled_by_how_far_it_has_come(load, heavy, title):
    assert _title(0.15, load, heavy) == title
