"""A drawing as SVG and as PDF: lengths in millimetres, layers by name in both."""

from __future__ import annotations

import zlib
from html import escape

import numpy as np

from foldlab.making.drawing import ANCHORS, INK, LAYERS, Drawing, Line, Text

FONT = "Helvetica, Arial, 'Liberation Sans', sans-serif"
POINT = 72 / 25.4  # in a millimetre


def svg(drawing: Drawing) -> str:
    """The text of an SVG 1.1 file whose user unit is one millimetre.

    Each layer is a group with its name as id (blanks become "-") and as Inkscape's label.
    """
    wide, high = drawing.size
    out = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<svg xmlns="http://www.w3.org/2000/svg" '
        'xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" version="1.1" '
        f'width="{wide:g}mm" height="{high:g}mm" viewBox="0 0 {wide:g} {high:g}">',
        f"<title>{escape(drawing.title)}</title>",
    ]
    for layer in LAYERS:
        name = layer.replace(" ", "-")
        out.append(f'<g id="{name}" inkscape:groupmode="layer" inkscape:label="{layer}">')
        out += [_svg_item(item, high) for item in drawing.of(layer)]
        out.append("</g>")
    return "\n".join([*out, "</svg>", ""])


def _svg_item(item: Line | Text, high: float) -> str:
    ink = INK[item.layer]
    if isinstance(item, Text):
        x, y = item.at
        return (
            f'<text x="{_n(x)}" y="{_n(high - y)}" text-anchor="{item.anchor}" fill="{ink}" '
            f'font-family="{FONT}" font-size="{_n(item.size)}">{escape(item.words)}</text>'
        )
    points = " L ".join(f"{_n(x)} {_n(high - y)}" for x, y in item.points)
    return (
        f'<path d="M {points}{" Z" * item.closed}" fill="{item.fill or "none"}" stroke="{ink}" '
        f'stroke-width="{_n(item.width)}" stroke-linejoin="miter"/>'
    )


def pdf(drawing: Drawing) -> bytes:
    """A PDF 1.5 file of one page; each layer is an optional content group of its name."""
    wide, high = drawing.size
    names = {layer: f"L{k}" for k, layer in enumerate(LAYERS)}
    content = [f"{_n(POINT)} 0 0 {_n(POINT)} 0 0 cm"]
    for layer, name in names.items():
        content.append(f"/OC /{name} BDC")
        content += [_pdf_item(item) for item in drawing.of(layer)]
        content.append("EMC")
    stream = zlib.compress("\n".join(content).encode("cp1252", "replace"))
    groups = {layer: 7 + k for k, layer in enumerate(LAYERS)}
    listed = " ".join(f"{number} 0 R" for number in groups.values())
    properties = " ".join(f"/{names[layer]} {number} 0 R" for layer, number in groups.items())
    objects = [
        "<< /Type /Catalog /Pages 2 0 R /OCProperties << "
        f"/OCGs [{listed}] /D << /Order [{listed}] /ON [{listed}] >> >> >>",
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {_n(wide * POINT)} {_n(high * POINT)}] "
        f"/Contents 5 0 R /Resources << /Font << /F 4 0 R >> /Properties << {properties} >> >> >>",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        f"<< /Length {len(stream)} /Filter /FlateDecode >>\nstream\n",
        f"<< /Title {_pdf_text(drawing.title)} /Creator (foldlab) >>",
        *(f"<< /Type /OCG /Name {_pdf_text(layer)} >>" for layer in groups),
    ]
    out, places = bytearray(b"%PDF-1.5\n%\xe2\xe3\xcf\xd3\n"), []
    for number, text in enumerate(objects, start=1):
        places.append(len(out))
        body = text.encode("cp1252", "replace")
        body += stream + b"\nendstream" if number == 5 else b""
        out += b"%d 0 obj\n" % number + body + b"\nendobj\n"
    start = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info 6 0 R >>\n" % (len(objects) + 1)
    out += b"startxref\n%d\n%%%%EOF\n" % start
    return bytes(out)


def _pdf_item(item: Line | Text) -> str:
    ink = _rgb(INK[item.layer])
    if isinstance(item, Text):
        x = item.at[0] - item.width * ANCHORS[item.anchor]
        return (
            f"BT {ink} rg /F {_n(item.size)} Tf {_n(x)} {_n(item.at[1])} Td "
            f"{_pdf_text(item.words)} Tj ET"
        )
    points = [f"{_n(x)} {_n(y)}" for x, y in item.points]
    path = " l ".join([f"{points[0]} m {points[1]}", *points[2:]]) + " l"
    paint = {(False, False): "S", (True, False): "s", (True, True): "b", (False, True): "B"}
    fill = f"{_rgb(item.fill)} rg " if item.fill else ""
    end = paint[item.closed, item.fill is not None]
    return f"{ink} RG {fill}{_n(item.width)} w {path} {end}"


def _rgb(colour: str) -> str:
    return " ".join(f"{int(colour[k : k + 2], 16) / 255:.3f}" for k in (1, 3, 5))


def _pdf_text(words: str) -> str:
    return "(" + "".join("\\" + c if c in "()\\" else c for c in words) + ")"


def _n(value: float) -> str:
    """A number as both formats read it, to 1e-9."""
    return np.format_float_positional(value, precision=9, trim="-")
