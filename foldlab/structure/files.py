"""Crease patterns as files: FOLD (https://github.com/edemaine/fold) and SVG with coloured lines.

Of FOLD vertices, edges with their assignment and, where they are there, faces are read; the keys
``foldlab:edges_hingeLength`` (in the file's unit), ``foldlab:edges_start`` and
``foldlab:edges_end`` give single creases a hinge and an order. In SVG red lines are mountains, blue
ones valleys, black, grey and green ones borders and cuts, yellow ones creases that only bend; lines
are cut where they meet. Some patterns are shipped (:data:`SHIPPED`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foldlab.errors import InputError
from foldlab.packaged import needed_for

if TYPE_CHECKING:
    from solver.cases.structure.path import State
    from solver.cases.structure.pattern import Pattern

PATTERNS = Path(__file__).parent.parent / "data" / "patterns"
SHIPPED = {path.stem: path.name for path in sorted(PATTERNS.iterdir())}
MOST_BYTES, MOST_EDGES = 20_000_000, 5000
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "pt": 0.0254 / 72, "um": 1e-6, "µm": 1e-6}
FOLDS = {"M": -1, "V": 1, "F": 0, "U": 0, "J": 0}
BORDERS = ("B", "C")
INCH = 0.0254 / 96  # an SVG pixel in metres


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a file holds: ``vertices`` (n, 2), ``edges`` (m, 2) with ``assignment`` (m,) as in FOLD,
    ``faces`` (None: to be told from the edges), ``metres`` per unit (None: not said), and what the
    file says of single creases, by edge."""

    vertices: np.ndarray
    edges: np.ndarray
    assignment: list[str]
    faces: list[list[int]] | None
    metres: float | None
    hinge: dict[int, float] = field(default_factory=dict)
    start: dict[int, float] = field(default_factory=dict)
    end: dict[int, float] = field(default_factory=dict)

    def pattern(self, hinge: float | None = None, size: float | None = None) -> Pattern:
        """The pattern in metres.

        ``hinge``: length of hinges of which the file says none, m; ``size``: largest extent of the
        flat sheet, m, needed where the file says no unit. Raises :class:`InputError` for what is
        missing, and for a sheet that is no pattern (see
        :class:`solver.cases.structure.pattern.Pattern`).
        """
        from solver.cases.structure.pattern import Crease, Pattern

        extent = float(np.ptp(self.vertices, axis=0).max())
        if size is None and self.metres is None:
            raise InputError(
                f"the pattern has no unit, its largest extent is {extent:g}; say --set "
                "size=100mm, the largest extent of the flat sheet"
            )
        scale = self.metres if size is None else size / extent
        inner = [k for k, a in enumerate(self.assignment) if a in FOLDS]
        if not any(FOLDS[self.assignment[k]] for k in inner):
            raise InputError("the pattern has no mountain and no valley, so nothing folds")
        if hinge is None and any(k not in self.hinge for k in inner):
            raise InputError("the pattern says no length of its hinges; add --set l_i=10mm")
        try:
            creases = [
                Crease(
                    tuple(self.edges[k].tolist()),
                    FOLDS[self.assignment[k]],
                    self.hinge[k] * scale if k in self.hinge else hinge,
                    self.start.get(k, 0.0),
                    self.end.get(k, 1.0),
                )
                for k in inner
            ]
            faces = self._faces() if self.faces is None else self.faces
            return Pattern(self.vertices * scale, faces, creases)
        except ValueError as error:
            raise InputError(f"the pattern can't be folded: {error}") from None

    def _faces(self) -> list[list[int]]:
        """Faces between the edges; ValueError for edges that cross or border no face."""
        import shapely
        from scipy.spatial import cKDTree

        lines = [shapely.LineString(self.vertices[edge]) for edge in self.edges]
        tree = shapely.STRtree(lines)
        a, b = tree.query(lines, predicate="crosses")
        if (a < b).any():
            k = int(np.flatnonzero(a < b)[0])
            i, j = (self.edges[m].tolist() for m in (a[k], b[k]))
            raise ValueError(f"the edges {i} and {j} cross; put a vertex where they meet")
        polygons, cuts, dangles, rest = shapely.polygonize_full(lines)
        loose = [*cuts.geoms, *dangles.geoms, *rest.geoms]
        where = cKDTree(self.vertices)
        if loose:
            ends = where.query(np.array(loose[0].coords))[1].tolist()
            raise ValueError(f"the edge {ends} borders no face; close the outline there")
        return [
            where.query(np.array(polygon.exterior.coords)[:-1])[1].tolist()
            for polygon in polygons.geoms
        ]


def read_pattern(path: str | Path) -> Drawn:
    """The crease pattern of a .fold, .json or .svg file, or a shipped one by its name.

    Raises :class:`InputError` for files that can't be read, are too large or hold no pattern.
    """
    path = Path(path)
    if path.name == str(path) and path.name in SHIPPED:
        path = PATTERNS / SHIPPED[path.name]
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path} is larger than {MOST_BYTES // 1_000_000} MB")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        error = getattr(error, "strerror", None) or error
        shipped = f"; shipped are {', '.join(SHIPPED)}" if not path.suffix else ""
        raise InputError(f"can't read the pattern {path}: {error}{shipped}") from None
    kind = path.suffix.lower()
    if kind not in (".fold", ".json", ".svg"):
        raise InputError(f"{path}: ending {kind or '(none)'!r}; expected .fold, .json or .svg")
    try:
        drawn = _svg(path) if kind == ".svg" else _fold(json.loads(text))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ValueError, TypeError, LookupError, RecursionError, SyntaxError) as error:
        raise InputError(f"{path} is no crease pattern: {type(error).__name__}: {error}") from None
    if len(drawn.edges) > MOST_EDGES:
        raise InputError(f"{path} has {len(drawn.edges)} edges; at most {MOST_EDGES} are read")
    return drawn


def _fold(data: Any) -> Drawn:
    if not isinstance(data, dict):
        raise InputError("expected a JSON object with vertices_coords")
    missing = [key for key in ("vertices_coords", "edges_vertices") if key not in data]
    if missing:
        raise InputError(f"the file has no {missing[0]}; it has {', '.join(list(data)[:8])}")
    vertices = np.array([[float(c) for c in place] for place in data["vertices_coords"]])
    if vertices.ndim != 2 or vertices.shape[1] not in (2, 3) or not np.isfinite(vertices).all():
        raise InputError("vertices_coords: expected two or three finite numbers each")
    if vertices.shape[1] == 3 and np.ptp(vertices[:, 2]) > 1e-9 * np.ptp(vertices, axis=0).max():
        raise InputError("the sheet is not flat (z differs); give the crease pattern, unfolded")
    edges = np.array([[int(v) for v in edge] for edge in data["edges_vertices"]]).reshape(-1, 2)
    if len(edges) and (edges.min() < 0 or edges.max() >= len(vertices)):
        raise InputError(f"edges_vertices names vertex {edges.max()} of {len(vertices)}")
    assignment = [str(a).upper() for a in data.get("edges_assignment", ())]
    if len(assignment) != len(edges):
        raise InputError(
            f"{len(assignment)} entries of edges_assignment for {len(edges)} edges; give M, V, F "
            "or B of each"
        )
    unknown = sorted(set(assignment) - set(FOLDS) - set(BORDERS))
    if unknown:
        raise InputError(f"edges_assignment {unknown[0]!r}; expected M, V, F, U, J, B or C")
    unit = str(data.get("frame_unit", "unit"))
    own = {
        name: {
            k: float(v)
            for k, v in enumerate(data.get(f"foldlab:edges_{key}") or ())
            if v is not None
        }
        for name, key in (("hinge", "hingeLength"), ("start", "start"), ("end", "end"))
    }
    return Drawn(
        vertices[:, :2], edges, assignment, data.get("faces_vertices"), METRES.get(unit), **own
    )


def _colour(shape) -> str | None:
    """Assignment of a line by its stroke; None where it has none."""
    stroke = shape.stroke
    if stroke is None or stroke.value is None:
        return None
    r, g, b = stroke.red, stroke.green, stroke.blue
    high, low = max(r, g, b), min(r, g, b)
    if high - low < 64:
        return "B"
    if r == high and g < high - 64 and b < high - 64:
        return "M"
    if b == high and r < high - 64:
        return "V"
    if g == high and r < high - 64:
        return "C"
    if b == low and min(r, g) > 128:
        return "F"
    raise InputError(
        f"a line has the colour {stroke.hex}; expected red (mountain), blue (valley), yellow (only "
        "bends), black, grey or green (border, cut)"
    )


def _svg(path: Path) -> Drawn:
    with needed_for("an SVG pattern"):
        import shapely
        import svgelements as svg

    segments, kinds = [], []
    drawing = svg.SVG.parse(str(path), ppi=96)
    if not isinstance(drawing, svg.SVG):
        raise InputError("it is XML, but its root is no <svg>")
    for shape in drawing.elements():
        if not isinstance(shape, svg.Shape) or (kind := _colour(shape)) is None:
            continue
        for part in svg.Path(shape).segments():
            if isinstance(part, svg.Move) or part.start == part.end:
                continue
            if not isinstance(part, svg.Line | svg.Close):
                raise InputError("a line is curved; only straight creases and borders are read")
            segments.append([[p.x, -p.y] for p in (part.start, part.end)])
            kinds.append(kind)
    if not segments:
        raise InputError("it has no lines with a stroke")
    if len(segments) > MOST_EDGES:
        raise InputError(f"it has {len(segments)} lines; at most {MOST_EDGES} are read")
    ends = np.array(segments, float)
    extent = np.ptp(ends.reshape(-1, 2), axis=0).max()
    grid = 1e-6 * extent
    lines = shapely.linestrings(ends)
    pieces = shapely.get_parts(shapely.union_all(lines, grid_size=grid))
    tree = shapely.STRtree(lines)
    vertices: dict[tuple, int] = {}
    edges, assignment = [], []
    for piece in pieces:
        places = np.array(piece.coords)
        for a, b in pairwise(places):
            # Where lines lie on each other the crease counts.
            middle = shapely.Point((a + b) / 2)
            on = tree.query(middle, predicate="dwithin", distance=1e-4 * extent)
            own = [kinds[k] for k in on]
            creases = {kind for kind in own if kind in FOLDS}
            if len(creases) > 1:
                raise InputError("lines of different colours lie on each other")
            edges.append([vertices.setdefault(tuple(p), len(vertices)) for p in (a, b)])
            assignment.append(next(iter(creases), "B"))
    return Drawn(np.array(list(vertices)), np.array(edges), assignment, None, INCH)


def write_fold(
    pattern: Pattern, states: Sequence[State], path: Path, title: str = "structure"
) -> None:
    """The folded states as frames of a FOLD file in mm: panels, and hinges as straight strips.

    The first frame lies flat as the pattern does; around a vertex, where hinges leave a hole, there
    is one.
    """
    counts = [len(panel) for panel in pattern.panels]
    faces, at = [], 0
    for count in (*counts, *([4] * len(pattern.hinges))):
        faces.append(list(range(at, at + count)))
        at += count

    def places(state) -> list:
        parts = [*state.panels, *state.strips]
        return (1e3 * np.concatenate(parts)).round(6).tolist()

    edges: dict[tuple[int, int], None] = {}
    for face in faces:
        for a, b in zip(face, [*face[1:], face[0]], strict=True):
            edges[(min(a, b), max(a, b))] = None
    data = {
        "file_spec": 1.2,
        "file_creator": "foldlab",
        "file_classes": ["animation"],
        "frame_title": f"{title}, e = {float(states[0].e):.3f}",
        "frame_classes": ["foldedForm"],
        "frame_attributes": ["3D"],
        "frame_unit": "mm",
        "vertices_coords": places(states[0]),
        "edges_vertices": [list(edge) for edge in edges],
        "faces_vertices": faces,
        "file_frames": [
            {
                "frame_parent": 0,
                "frame_inherit": True,
                "frame_title": f"{title}, e = {float(state.e):.3f}",
                "frame_classes": ["foldedForm"],
                "vertices_coords": places(state),
                "foldlab:hinge_angles": np.degrees(state.angles).round(4).tolist(),
            }
            for state in states[1:]
        ],
    }
    path.write_text(json.dumps(data), encoding="utf-8")
