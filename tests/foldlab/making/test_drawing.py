"""Drawings read back as what they show, by an XML reader and by pypdf."""

import xml.etree.ElementTree as ET
from itertools import combinations, pairwise

import numpy as np
import pytest
from made_units import UNITS

from foldlab.errors import InputError
from foldlab.making.drawing import LAYERS, Line, Text, draw, millimetres, standard
from foldlab.making.geometry import Geometry
from foldlab.making.vector import pdf, svg

NOTES = ("passive: polyester film; active: shape-memory polymer", "The ends rise (20 %).")
SVG = "{http://www.w3.org/2000/svg}"
INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}"
OTHERS = {
    "small": Geometry(8.0, 2.0, 0.02, 1.0, 1.0, 0.15),
    "tiny hinge": Geometry(30.0, 30.0, 0.5, 1.5, 6.25, 0.05, strips=10, strip_share=0.3),
    "large": Geometry(300.0, 200.0, 2.0, 50.0, 100.0, 0.25),
    "huge": Geometry(3000.0, 800.0, 2.0, 500.0, 500.0, 9.0),
    "short": Geometry(31.0, 2.85, 0.104, 5.464, 2.811, 0.8699),
    "thick": Geometry(40.0, 10.0, 4.0, 10.0, 10.0, 39.0),
    "short panels": Geometry(60.0, 20.0, 0.1, 56.0, 20.0, 0.1),
    "shorter panels": Geometry(60.0, 20.0, 0.1, 57.75, 20.0, 0.1),
}


def expected(unit):
    """Closed lines that each layer of the plan view must have, their middle at the origin."""
    patches = [np.array(p) for p in unit.patches]
    by_layer = {"outline": [unit.outline], "active": patches, "strips": []}
    if unit.strips:
        by_layer |= {"active": [], "strips": patches}
    return by_layer


def same(lines, wanted, scale):
    """Whether lines are the wanted ones, all moved alike, at a scale."""
    assert {k: len(v) for k, v in lines.items()} == {k: len(v) for k, v in wanted.items()}
    middle = (lines["outline"][0].min(axis=0) + lines["outline"][0].max(axis=0)) / 2
    for layer, drawn in lines.items():
        for points, exact in zip(drawn, wanted[layer], strict=True):
            size = np.ptp(exact, axis=0).min()
            np.testing.assert_allclose((points - middle) / scale, exact, atol=1e-6 * size)


@pytest.mark.parametrize("name", UNITS)
def test_an_svg_holds_the_sizes_in_millimetres_in_named_layers(name):
    drawing = draw(UNITS[name], "Self-folding unit", NOTES)
    root = ET.fromstring(svg(drawing).encode())
    wide, high = drawing.size
    assert root.get("width") == f"{wide:g}mm" and root.get("height") == f"{high:g}mm"
    assert [float(v) for v in root.get("viewBox").split()] == [0, 0, wide, high]
    groups = root.findall(f"{SVG}g")
    assert [g.get(f"{INKSCAPE}label") for g in groups] == list(LAYERS)
    lines = {}
    for group in groups[:3]:
        paths = [path.get("d") for path in group.iter(f"{SVG}path")]
        assert all(d.startswith("M ") and d.endswith(" Z") for d in paths)
        lines[group.get("id")] = [
            np.array([p.split() for p in d[2:-2].split(" L ")], float) * (1, -1) for d in paths
        ]
    assert drawing.scale == 1.0 and drawing.paper == "A4"
    same(lines, expected(UNITS[name]), 1.0)


@pytest.mark.parametrize("name", UNITS)
def test_a_pdf_holds_the_sizes_in_points_in_named_layers(name):
    from io import BytesIO

    from pypdf import PdfReader
    from pypdf.generic import ContentStream

    drawing = draw(UNITS[name], "Self-folding unit", NOTES)
    reader = PdfReader(BytesIO(pdf(drawing)))
    (page,) = reader.pages
    size = np.array([float(page.mediabox.width), float(page.mediabox.height)]) * 25.4 / 72
    np.testing.assert_allclose(size, drawing.size, rtol=1e-6)
    properties = page["/Resources"]["/Properties"]
    assert [properties[k]["/Name"] for k in sorted(properties)] == list(LAYERS)
    lines, layer, matrix = {k: [] for k in LAYERS}, None, None
    for given, operator in ContentStream(page["/Contents"], reader).operations:
        if operator == b"cm":
            matrix = [float(v) for v in given]
        elif operator == b"BDC":
            layer = properties[given[1]]["/Name"]
        elif operator == b"m":
            points = [[float(v) for v in given]]
        elif operator == b"l":
            points.append([float(v) for v in given])
        elif operator in (b"s", b"b"):
            lines[layer].append(np.array(points) * matrix[0] * 25.4 / 72)
    assert matrix[0] == matrix[3] and matrix[1:3] == [0, 0] and matrix[4:] == [0, 0]
    same({k: lines[k] for k in ("outline", "active", "strips")}, expected(UNITS[name]), 1.0)
    words = page.extract_text()
    for value in (UNITS[name].length, UNITS[name].width, UNITS[name].active_thickness):
        assert f"{value:.4g}" in words
    assert "scale 1:1" in words and NOTES[1] in words


def crosses(box, a, b):
    """Whether the straight line from a to b passes through the box (x0, y0, x1, y1)."""
    start, end, d = 0.0, 1.0, b - a
    for k in (0, 1):
        if abs(d[k]) < 1e-12:
            if not box[k] < a[k] < box[k + 2]:
                return False
        else:
            low, high = sorted(((box[k] - a[k]) / d[k], (box[k + 2] - a[k]) / d[k]))
            start, end = max(start, low), min(end, high)
    return start < end


@pytest.mark.parametrize("name", {**UNITS, **OTHERS})
def test_words_overlap_nothing_and_stay_on_the_paper(name):
    drawing = draw({**UNITS, **OTHERS}[name], "Self-folding unit", NOTES)
    boxes = []
    for item in drawing.items:
        if isinstance(item, Text):
            # Fonts that stand in for Helvetica are up to a sixth wider.
            wide = 1.17 * item.width
            x = item.at[0] - wide * {"start": 0.0, "middle": 0.5, "end": 1.0}[item.anchor]
            y = item.at[1]
            boxes.append((item.words, x, y - 0.2 * item.size, x + wide, y + 0.75 * item.size))
    assert len(boxes) > 8
    x0, y0, x1, y1 = drawing.box
    assert x0 > 8 and y0 > 38 and x1 < drawing.size[0] - 8 and y1 < drawing.size[1] - 8
    for words, x0, y0, x1, y1 in boxes:
        assert x0 > 8 and y0 > 8 and x1 < drawing.size[0] - 8 and y1 < drawing.size[1] - 8, words
    for a, b in combinations(boxes, 2):
        apart = a[3] <= b[1] or b[3] <= a[1] or a[4] <= b[2] or b[4] <= a[2]
        assert apart, f"{a[0]!r} lies over {b[0]!r}"
    for item in drawing.items:
        if isinstance(item, Text):
            continue
        points = np.vstack([item.points, item.points[:1]]) if item.closed else item.points
        for a, b in pairwise(points):
            for words, *box in boxes:
                # Words stand 1 mm over their own line: without what hangs below their baseline.
                box[1] += 0.2 * 3.5
                assert not crosses(box, a, b), f"a line of {item.layer} crosses {words!r}"


def test_long_names_are_cut_where_the_title_block_ends():
    unit = Geometry(130.0, 120.0, 0.1, 10.0, 10.0, 0.2)  # on a portrait page
    drawing = draw(unit, "unit", ["passive: " + "a film of a long name " * 20, "short"])
    wide, _ = drawing.size
    words = [t for t in drawing.of("notes") if isinstance(t, Text)]
    (cut,) = [t for t in words if t.words.endswith("…")]
    assert cut.at[0] + 1.17 * cut.width < wide - 8 - 4 - 20 and len(cut.words) > 60
    assert "short" in [t.words for t in words]


@pytest.mark.parametrize(
    "name, paper, scale", [("small", "A4", 20), ("large", "A2", 1), ("huge", "A4", 0.05)]
)
def test_paper_grows_and_then_a_standard_scale_is_stated(name, paper, scale):
    drawing = draw(OTHERS[name], "unit")
    assert (drawing.paper, drawing.scale) == (paper, scale)
    text = f"{scale}:1" if scale >= 1 else f"1:{1 / scale:g}"
    says = [t.words for t in drawing.of("notes") if isinstance(t, Text)]
    assert f"scale {text}, {paper}" in says
    outline = drawing.of("outline")[0].points
    np.testing.assert_allclose(np.ptp(outline, axis=0)[0], OTHERS[name].length * scale)


def test_the_side_view_says_by_what_thickness_is_enlarged():
    drawing = draw(UNITS["plain"], "unit")
    sheet, active = (item.points for item in drawing.of("side view") if isinstance(item, Line))
    assert np.ptp(sheet, axis=0) == pytest.approx([40, 5]) and drawing.thick_scale == 50
    assert np.ptp(active, axis=0) == pytest.approx([10, 10])
    assert active[:, 1].min() == pytest.approx(sheet[:, 1].max())
    says = [t.words for t in drawing.of("side view") if isinstance(t, Text)]
    assert "side view: length 1:1, thickness 50:1 (enlarged 50 times)" in says


def test_scales_and_sizes_are_written_as_on_drawings():
    assert [standard(s) for s in (87, 50, 1, 0.99, 0.05, 0.0321)] == [50, 50, 1, 0.5, 0.05, 0.02]
    sizes = (40.0, 0.1, 12.3456, 1234.56, 0.05, 2.5e-4)
    assert [millimetres(s) for s in sizes] == ["40", "0.1", "12.35", "1235", "0.05", "2.500e-04"]


def test_sizes_that_are_missing_or_no_unit_are_refused_in_words():
    whole = {"l_s": 0.04, "b_s": 0.01, "h_s": 1e-4, "l_i": 0.01, "b_i": 0.01, "h_i": 2e-4}
    assert Geometry.of(whole) == UNITS["plain"]
    pattern = Geometry.of(whole, {"strips": 5.0, "strip_share": 0.4})
    assert pattern.strips == 5 and pattern.strip == pytest.approx(0.8)
    with pytest.raises(InputError, match="size is not known: h_i missing; add --set h_i="):
        Geometry.of({k: v for k, v in whole.items() if k != "h_i"})
    with pytest.raises(InputError, match="hinge_length = 50 mm is more than length = 40 mm"):
        Geometry.of(whole | {"l_i": 0.05})
    with pytest.raises(InputError, match="thickness = nan mm"):
        Geometry.of(whole | {"h_s": float("nan")})


@pytest.mark.parametrize("name", UNITS)
def test_facets_tile_the_sheet_counterclockwise(name):
    unit = UNITS[name]
    vertices, faces = unit.facets([0.0, -1.0, 20.0])
    area = 0.0
    for face in faces:
        x, y = vertices[face].T
        own = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2
        assert own > 0
        area += own
    assert area == pytest.approx(unit.areas["passive"], rel=1e-12)
    # Every edge within is walked once each way.
    edges = [(a, b) for f in faces for a, b in zip(f, [*f[1:], f[0]], strict=True)]
    assert len(set(edges)) == len(edges)
    inner = [e for e in edges if e[::-1] in edges]
    assert len(inner) == 2 * (len(faces) - 1)


def test_strips_and_gaps_alternate_with_half_a_gap_at_the_edges():
    unit = Geometry(100.0, 25.0, 1.0, 20.0, 12.0, 1.0, strips=4, strip_share=0.75)
    y = unit.patches[:, :, 1]
    # Of 3 mm from strip to strip 2.25 are strip.
    assert y.min(axis=1) == pytest.approx([-5.625, -2.625, 0.375, 3.375])
    assert y.max(axis=1) == pytest.approx([-3.375, -0.375, 2.625, 5.625])
    assert np.ptp(unit.patches[:, :, 0], axis=1) == pytest.approx(20.0)
    assert unit.volumes == pytest.approx({"active": 4 * 2.25 * 20, "passive": 25 * 80 + 12 * 20})
    (patch,) = UNITS["narrow"].patches
    assert np.ptp(patch, axis=0) == pytest.approx([7.43, 6.01])
    corners = UNITS["narrow"].outline
    assert len(corners) == 12 and len(UNITS["plain"].outline) == 4
    assert set(np.abs(corners[:, 1])) == {17.9 / 2, 6.01 / 2}
