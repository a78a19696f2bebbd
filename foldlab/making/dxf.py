"""The cutter's file: every closed line is one cut, 1:1 in millimetres."""

from __future__ import annotations

from io import StringIO

from foldlab.making.geometry import Geometry

# Layer and its colour by AutoCAD's index. Strips are on their own layer, and then nothing is on
# that of the active layer: no line is cut twice.
LAYERS = {"outline": 7, "active": 30, "strips": 30}


def dxf(unit: Geometry) -> str:
    """The text of a DXF file (R2000) whose header sets millimetres.

    Closed polylines: the sheet on the layer "outline", the active layer on "active" or its strips
    on "strips", where they lie on the sheet. Raises ImportError where ezdxf is not installed.
    """
    import ezdxf
    from ezdxf import units

    document = ezdxf.new("R2000", units=units.MM)
    for name, colour in LAYERS.items():
        document.layers.add(name, color=colour)
    space = document.modelspace()

    def cut(points, layer: str) -> None:
        space.add_lwpolyline(points.tolist(), close=True, dxfattribs={"layer": layer})

    cut(unit.outline, "outline")
    for patch in unit.patches:
        cut(patch, "strips" if unit.strips else "active")
    out = StringIO()
    document.write(out)
    return out.getvalue()
