"""A dimensioned drawing of a unit: plan view and side view, to scale, in named layers.

Lengths on the paper are mm, its origin is the lower left corner. The scale is 1:1 on the smallest
paper of the A series that holds it; a sheet below 30 mm is enlarged and one that no A0 holds is
reduced, by a standard scale (ISO 5455), on A4. The layers "outline", "active" and "strips" hold the
plan view's closed lines alone, each once: what a cutter may follow.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from foldlab.making.geometry import Geometry

LAYERS = ("outline", "active", "strips", "side view", "dimensions", "notes")
PAPERS = {"A4": (210, 297), "A3": (297, 420), "A2": (420, 594), "A1": (594, 841), "A0": (841, 1189)}
SMALLEST = 30.0  # mm of a sheet's length that is drawn 1:1
TEXT, SMALL = 3.5, 3.0  # heights of letters' boxes, mm
THICK, THIN = 0.35, 0.18
INK = {
    "outline": "#000000", "active": "#C04A00", "strips": "#C04A00", "side view": "#000000",
    "dimensions": "#1F4E9E", "notes": "#333333",
}  # fmt: skip
FILLS = {"passive": "#DCE5EE", "active": "#F2D3A8"}
# What the plan view needs around it, and the frame with its title.
LEFT, RIGHT, ABOVE, BELOW = 34.0, 38.0, 30.0, 28.0
SIDE, TITLE, FRAME = 50.0, 30.0, 8.0
ARROW = 2.5
ANCHORS = {"start": 0.0, "middle": 0.5, "end": 1.0}  # where words are held, of their width
WIDEST = 1.17  # of Helvetica's widths, in fonts that stand in for it


@dataclass(frozen=True)
class Line:
    """A line through points (n, 2), ``closed`` or not, ``fill``-ed with a colour or not."""

    layer: str
    points: np.ndarray
    closed: bool = False
    width: float = THIN
    fill: str | None = None


@dataclass(frozen=True)
class Text:
    """Words whose baseline starts, has its middle or ends at a point."""

    layer: str
    at: tuple[float, float]
    words: str
    anchor: str = "start"  # middle, end
    size: float = TEXT

    @property
    def width(self) -> float:
        """In mm, set in Helvetica."""
        return extent(self.words, self.size)


@dataclass
class Drawing:
    """``paper``: its name; ``size``: width and height in mm; ``scale``: drawn over true length;
    ``thick_scale``: the same of thicknesses in the side view."""

    paper: str
    size: tuple[float, float]
    scale: float
    thick_scale: float
    title: str
    items: list[Line | Text] = field(default_factory=list)

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Low x and y, high x and y around the views and their dimensions."""
        seen = [item for item in self.items if item.layer != "notes"]
        points = [item.points for item in seen if isinstance(item, Line)]
        for item in seen:
            if isinstance(item, Text):
                x = item.at[0] - WIDEST * item.width * ANCHORS[item.anchor]
                up = (WIDEST * item.width, item.size)
                points.append(np.array([(x, item.at[1]), np.add((x, item.at[1]), up)]))
        low, high = (f(np.vstack(points), axis=0) for f in (np.min, np.max))
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def of(self, layer: str) -> list[Line | Text]:
        """What is on a layer, in the order in which it is drawn."""
        return [item for item in self.items if item.layer == layer]


def draw(unit: Geometry, title: str, notes: Sequence[str] = ()) -> Drawing:
    """The drawing of a unit; ``notes``: lines of the title block, two at most."""
    paper, size, scale = _paper(unit)
    # Of 10 mm and more together, two layers have room for a word each.
    thick = standard(26.0 / (unit.thickness + unit.active_thickness))
    sheet = Drawing(paper, size, scale, thick, title)
    wide, high = size
    middle = LEFT + (wide - LEFT - RIGHT) / 2
    plan = (middle, high - FRAME - ABOVE - unit.width * scale / 2)
    _plan(sheet, unit, plan)
    _side(sheet, unit, (middle, plan[1] - unit.width * scale / 2 - BELOW - 34.0))
    _title(sheet, unit, notes)
    return sheet


def standard(most: float) -> float:
    """The largest of the scales …, 1:5, 1:2, 1:1, 2:1, 5:1, 10:1, … that is at most ``most``."""
    decade = 10.0 ** np.floor(np.log10(most) + 1e-12)
    return float(next(k * decade for k in (5, 2, 1) if k * decade <= most * (1 + 1e-12)))


def said(scale: float) -> str:
    """A scale as it is written: 5:1, 1:2."""
    return f"{scale:g}:1" if scale >= 1 else f"1:{1 / scale:g}"


def millimetres(value: float) -> str:
    """A size as it is written on a drawing: four digits, no power of ten above 1 µm."""
    text = f"{float(f'{value:.4g}'):.10f}".rstrip("0").rstrip(".")
    return text if 1e-3 <= value < 1e7 else f"{value:.3e}"


def _paper(unit: Geometry) -> tuple[str, tuple[float, float], float]:
    """Name, width and height (mm) of the paper, and the scale."""
    if unit.length >= SMALLEST:
        for name, (short, long) in PAPERS.items():
            for size in ((long, short), (short, long)):
                if _room(unit, size) >= 1:
                    return name, (float(size[0]), float(size[1])), 1.0
    short, long = PAPERS["A4"]
    sizes = ((long, short), (short, long))
    size = max(sizes, key=lambda s: standard(_room(unit, s)))
    return "A4", (float(size[0]), float(size[1])), standard(_room(unit, size))


def _room(unit: Geometry, size: tuple[float, float]) -> float:
    """The largest scale at which the unit has its place on a paper."""
    wide, high = size
    return min(
        (wide - LEFT - RIGHT) / unit.length,
        (high - 2 * FRAME - ABOVE - BELOW - SIDE - TITLE) / unit.width,
    )


def _plan(sheet: Drawing, unit: Geometry, at: tuple[float, float]) -> None:
    """The view from above; ``at``: where its middle is."""
    k, at = sheet.scale, np.array(at)
    sheet.items.append(Line("outline", at + k * unit.outline, True, THICK))
    layer = "strips" if unit.strips else "active"
    sheet.items += [Line(layer, at + k * p, True, THICK) for p in unit.patches]
    x, y = at
    half = k * np.array([unit.length, unit.width, unit.hinge_length, unit.hinge_width]) / 2
    low = y - half[1]
    panel = (unit.length - unit.hinge_length) / 2
    _along(sheet, (x - half[0], x - half[2]), (low, y - half[3]), low - 9, panel, x - half[0])
    hinge = (x - half[2], x + half[2])
    _along(sheet, hinge, (y - half[3],) * 2, low - 9, unit.hinge_length, x + half[0])
    _along(sheet, (x - half[0], x + half[0]), (low, low), low - 18, unit.length)
    _up(sheet, (low, y + half[1]), (x - half[0],) * 2, x - half[0] - 9, [unit.width], -1)
    if unit.waisted:
        ends = (y - half[3], y + half[3])
        _up(sheet, ends, (x + half[2],) * 2, x + half[0] + 9, [unit.hinge_width], 1)
    top = y + half[1]
    if unit.strips:
        gap = unit.pitch - unit.strip
        words = [
            f"{unit.strips} active strips, each {millimetres(unit.strip)} wide,",
            f"{millimetres(gap)} apart, {millimetres(gap / 2)} from the hinge's edges",
        ]
        _leader(sheet, tuple(at + k * unit.patches[-1].mean(axis=0)), top, words)
    else:
        _leader(sheet, (x, y), top, ["active layer"])


def _side(sheet: Drawing, unit: Geometry, at: tuple[float, float]) -> None:
    """The view from the side; ``at``: the middle of the sheet's underside."""
    x, y = at
    k, t = sheet.scale, sheet.thick_scale
    long, hinge = k * unit.length / 2, k * unit.hinge_length / 2
    h, top = t * unit.thickness, t * unit.active_thickness

    def block(half, low, high, fill):
        corners = [(x - half, low), (x + half, low), (x + half, high), (x - half, high)]
        sheet.items.append(Line("side view", np.array(corners), True, THICK, FILLS[fill]))

    block(long, y, y + h, "passive")
    block(hinge, y + h, y + h + top, "active")
    ends = (x + long, x + long, x + hinge)
    _up(
        sheet, (y, y + h, y + h + top), ends, x + long + 9,
        [unit.thickness, unit.active_thickness], 1,
    )  # fmt: skip
    words = f"side view: length {said(k)}, thickness {said(t)}"
    if t != k:
        words += f" (enlarged {t / k:g} times)" if t > k else f" (reduced {k / t:g} times)"
    sheet.items.append(Text("side view", (x - long, y - 10), words, size=SMALL))


def _along(sheet, ends, features, line: float, size: float, edge: float | None = None) -> None:
    """A dimension along the sheet, between ``ends`` of features at heights, at the height
    ``line``. Words that have no room stand beside it, towards the sheet's ``edge`` and where they
    would cross that beyond it."""
    low, high = ends
    words = millimetres(size)
    for end, feature in zip(ends, features, strict=True):
        _line(sheet, [(end, feature - 1), (end, line - 1.5)])
    out = 0.0 if high - low >= 2 * ARROW + 1 else 2 * ARROW
    _line(sheet, [(low - out, line), (high + out, line)])
    inwards = 1 if out else -1
    _arrow(sheet, (low, line), (inwards, 0))
    _arrow(sheet, (high, line), (-inwards, 0))
    if edge is None or high - low >= extent(words, TEXT) + 1:
        sheet.items.append(Text("dimensions", ((low + high) / 2, line + 1), words, "middle"))
        return
    side = 1 if edge >= high else -1
    at = (high if side > 0 else low) + side * (out + 1)
    if side * (edge - at) < WIDEST * extent(words, TEXT) + 1:
        at = side * max(side * at, side * edge + 2)
        _line(sheet, [((high if side > 0 else low), line), (at - side, line)])
    anchor = "start" if side > 0 else "end"
    sheet.items.append(Text("dimensions", (at, line - 0.36 * TEXT), words, anchor))


def _up(sheet, ends, features, line: float, sizes: Sequence[float], side: int) -> None:
    """A chain of dimensions across, between heights ``ends`` of features at x, at x = ``line``;
    words stand to the ``side`` of it, −1 left or 1 right."""
    for end, feature in zip(ends, features, strict=True):
        _line(sheet, [(feature + side, end), (line + 1.5 * side, end)])
    tight = min(b - a for a, b in pairwise(ends)) < 2 * ARROW + 1
    if tight:
        _line(sheet, [(line, ends[0] - 2 * ARROW), (line, ends[-1] + 2 * ARROW)])
        _arrow(sheet, (line, ends[0]), (0, 1))
        _arrow(sheet, (line, ends[-1]), (0, -1))
        for end in ends[1:-1]:
            # No room for two arrows: a stroke, as on narrow chains.
            _line(sheet, [(line - 1, end - 1), (line + 1, end + 1)], THICK)
    else:
        _line(sheet, [(line, ends[0]), (line, ends[-1])])
        for low, high in pairwise(ends):
            _arrow(sheet, (line, low), (0, -1))
            _arrow(sheet, (line, high), (0, 1))
    for (low, high), size in zip(pairwise(ends), sizes, strict=True):
        at = (line + 2.5 * side, (low + high) / 2 - 0.36 * TEXT)
        anchor = "start" if side > 0 else "end"
        sheet.items.append(Text("dimensions", at, millimetres(size), anchor))


def _leader(sheet, point, top: float, words: Sequence[str]) -> None:
    """Words above the plan view, and a line from them to a point with a dot at its end."""
    x, y = point
    up = top + 7.5
    _line(sheet, [(x, y), (x + 4, up), (x + 7, up)])
    angles = np.linspace(0, 2 * np.pi, 13)[:-1]
    dot = np.array(point) + 0.5 * np.column_stack([np.cos(angles), np.sin(angles)])
    sheet.items.append(Line("dimensions", dot, True, THIN, INK["dimensions"]))
    for k, line in enumerate(reversed(words)):
        at = (x + 8, up - 0.36 * TEXT + 1.4 * TEXT * k)
        sheet.items.append(Text("dimensions", at, line))


def _title(sheet: Drawing, unit: Geometry, notes: Sequence[str]) -> None:
    """The frame, the title block and a bar to measure the print by."""
    wide, high = sheet.size
    for low, up in ((FRAME, high - FRAME), (FRAME, FRAME + TITLE)):
        corners = [(FRAME, low), (wide - FRAME, low), (wide - FRAME, up), (FRAME, up)]
        sheet.items.append(Line("notes", np.array(corners, float), True, THICK))
    left, right, top = FRAME + 4, wide - FRAME - 4, FRAME + TITLE
    lines = [(sheet.title, TEXT + 1), *((note, SMALL) for note in notes[:2])]
    facts = [f"scale {said(sheet.scale)}, {sheet.paper}", "all sizes in mm"]
    room = right - left - WIDEST * max(extent(words, SMALL) for words in facts) - 4
    for k, (words, size) in enumerate(lines):
        words = _shortened(words, size, room)
        sheet.items.append(Text("notes", (left, top - 7 - 6 * k), words, size=size))
    for k, words in enumerate(facts):
        sheet.items.append(Text("notes", (right, top - 7 - 6 * k), words, "end", SMALL))
    bar = right - 50.0
    y = FRAME + 5.0
    ticks = [(bar, y + 1.5), (bar, y), (right, y), (right, y + 1.5)]
    sheet.items.append(Line("notes", np.array(ticks), False, THICK))
    words = "50 mm on paper: measure it on your print"
    sheet.items.append(Text("notes", (bar - 3, y), words, "end", SMALL))


def _line(sheet, points, width: float = THIN) -> None:
    sheet.items.append(Line("dimensions", np.array(points, float), False, width))


def _arrow(sheet, tip, towards) -> None:
    t = np.array(towards, float)
    back = np.array(tip) - ARROW * t
    across = 0.4 * np.array([-t[1], t[0]])
    points = np.array([tip, back + across, back - across])
    sheet.items.append(Line("dimensions", points, True, 0.05, INK["dimensions"]))


def _shortened(words: str, size: float, room: float) -> str:
    """Words that fit into a width, with "…" for what does not."""
    if WIDEST * extent(words, size) <= room:
        return words
    while words and WIDEST * extent(f"{words}…", size) > room:
        words = words[:-1]
    return f"{words.rstrip()}…"


def extent(words: str, size: float) -> float:
    """Width of words in Helvetica, mm."""
    widths = _widths()
    return sum(widths.get(ord(letter), 600) for letter in words) * size / 1000


@cache
def _widths() -> dict[int, int]:
    """Widths of Helvetica's letters by code, in thousandths of their size, as Adobe states them."""
    from matplotlib import get_data_path

    path = Path(get_data_path()) / "fonts" / "pdfcorefonts" / "Helvetica.afm"
    rows = re.findall(r"^C (\d+) ; WX (\d+) ;", path.read_text(encoding="latin-1"), re.MULTILINE)
    return {int(code): int(width) for code, width in rows}
