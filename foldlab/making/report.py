"""The report: one self-contained page of HTML that needs no network and prints on an A4."""

from __future__ import annotations

import re
from base64 import b64encode
from dataclasses import replace
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from foldlab.making.drawing import Drawing, millimetres
from foldlab.making.vector import svg
from foldlab.plots import LINES, STYLE
from foldlab.unit.told import in_degrees

if TYPE_CHECKING:
    from foldlab.making.folder import Dossier
    from foldlab.making.geometry import Geometry

# Headings of the answer's words, in the order of the page; those not here are not shown.
SHOWN = (
    "angle", "stable", "tips over", "strain", "over the materials", "it stays so for", "to change",
)  # fmt: skip
LAYERS = ("passive", "active")
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>
@page {{ size: A4; margin: 8mm; }}
body {{ font: 12px/1.3 Helvetica, Arial, sans-serif; color: #222; max-width: 190mm;
  margin: 0 auto; }}
h1 {{ font-size: 15px; margin: 0; }} h2 {{ font-size: 13px; margin: 8px 0 2px; }}
.verdict {{ font-size: 19px; font-weight: bold; margin: 4px 0 0; color: {colour}; }}
.why {{ margin: 0 0 6px; }} img, svg {{ width: 100%; height: auto; display: block; }}
table {{ border-collapse: collapse; width: 100%; }}
th {{ text-align: left; font-weight: normal; color: #555; white-space: nowrap;
  padding: 1px 12px 1px 0; vertical-align: top; }}
td {{ padding: 1px 0; vertical-align: top; }}
.two {{ display: grid; grid-template-columns: 1fr 1fr; gap: 6mm; }}
.small {{ font-size: 10px; color: #555; }} .drawing svg {{ max-height: 80mm; }}
ul.small {{ columns: 2; padding: 0; margin: 0; list-style: none; }} sub {{ line-height: 1; }}
</style></head><body>
<h1>{title}</h1>
<p class="verdict">{verdict}</p><p class="why">{why}</p>
{picture}
<table>{rows}</table>
<div class="two"><div><h2>Angle over stimulus</h2>{chart}</div>
<div><h2>Drawing</h2><div class="drawing">{drawing}</div>
<p class="small">To scale in drawing.pdf and drawing.svg.</p></div></div>
<h2>Files</h2><ul class="small">{files}</ul>
</body></html>
"""


def html(dossier: Dossier, drawing: Drawing, picture: bytes | None) -> str:
    """The page's text; ``picture``: that of :func:`folded`."""
    foldable = dossier.answer.get("foldable")
    verdict = {True: "It folds", False: "It does not fold", None: "Unknown"}[foldable]
    angle = dossier.told.get("angle", "–").split(",")[0]
    if foldable is not None and angle[:1] not in "–":
        verdict += f": {angle}" if foldable else f": it turns by {angle}"
    made = " and ".join(dossier.unit.materials[k] for k in LAYERS if k in dossier.unit.materials)
    return PAGE.format(
        title=escape(", ".join(filter(None, (dossier.title, made)))),
        colour={True: "#1B6E3C", False: "#A3261B", None: "#6B5B00"}[foldable],
        verdict=escape(verdict),
        why=as_html(dossier.told.get("why", "")),
        picture="" if picture is None else _image(picture, "the unit, flat to folded"),
        rows="".join(_row(name, words) for name, words in _facts(dossier).items()),
        chart=_chart(dossier),
        drawing=views(drawing),
        files=_files(dossier),
    )


def _facts(dossier: Dossier) -> dict[str, str]:
    """Headings and words of the table."""
    out = {"sizes": sizes(dossier.geometry)}
    out |= {name: dossier.told[name] for name in SHOWN if dossier.told.get(name, "–") != "–"}
    sheet, active = (dossier.masses[layer] for layer in LAYERS)
    out["weight"] = (
        f"{_weight(sheet + active)} (sheet {_weight(sheet)}, active layer {_weight(active)})"
    )
    if dossier.cost is None:
        out["material cost"] = "needs price_low and price_high per kg of both, in --materials"
    else:
        low, high = dossier.cost
        cost = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        out["material cost"] = f"{cost}, by your prices per kg; without scrap and labour"
    if dossier.unit.stimulus:
        out["stimulus"] = dossier.unit.stimulus
    folded = []
    if dossier.reached is not None:
        folded.append(
            f"that at {100 * dossier.reached:.3g} % contraction, where the path ended, not at "
            f"{100 * dossier.unit.physical['contraction']:.3g} %"
        )
    if dossier.crossed:
        folded.append("its panels pass through each other, for contact was left out")
    if folded:
        out["folded shape"] = "; ".join(folded)
    out["confirmed"] = _confirmed(dossier)
    return out


def _weight(mass: float) -> str:
    return f"{mass:.3g} kg" if mass >= 1 else f"{1e3 * mass:.3g} g"


def sizes(unit: Geometry) -> str:
    mm = millimetres
    sheet = f"sheet {mm(unit.length)} × {mm(unit.width)} × {mm(unit.thickness)} mm"
    sheet += " (l_s × b_s × h_s)"
    if unit.waisted:
        sheet += f", its hinge {mm(unit.hinge_width)} mm wide"
    active = f"active layer {mm(unit.hinge_length)} × {mm(unit.strip)} × "
    active += f"{mm(unit.active_thickness)} mm (l_i × b_i × h_i)"
    return f"{sheet}; {active}" + (f", {unit.strips} strips" if unit.strips else "")


def _confirmed(dossier: Dossier) -> str:
    answer, source = dossier.answer, dossier.source
    if dossier.run is None:
        return "no"
    words = "by the finite-strain solver, with weight on a ground"
    if not source.conditions.heavy:
        words = "by the finite-strain solver, without weight"
    if dossier.run.history:
        words += f", {len(dossier.run.history)} states of {source.conditions.growth} contraction"
    if answer.get("core_seconds") is not None:
        words += f", {answer['core_seconds']:.2g} core-seconds"
    rod = "; margins by a planar rod" if answer.get("holds") is not None else ""
    return f"{words} (version {source.version}){rod}"


def folded(dossier: Dossier) -> bytes | None:
    """PNG of the unit, flat to folded: a rendered picture where there is one, else from the side;
    None where the solver gave no shape."""
    from foldlab.unit.plots import plot_side

    if dossier.picture is not None and dossier.picture.exists():
        return dossier.picture.read_bytes()
    if dossier.run is None or not dossier.run.shapes:
        return None
    shapes = [dossier.run.shapes[k] for k in (0, -1)]
    curves = np.stack([shape.state.curves for shape in shapes])
    heavy = dossier.source.conditions.heavy
    titles = [f"{100 * dossier.run.history[k]['contraction']:.3g} % contraction" for k in (0, -1)]
    figure = plot_side(curves, dossier.unit.groups, titles, ground=heavy)
    return _png(figure)


def _chart(dossier: Dossier) -> str:
    """Fold angle in degrees over the contraction in per cent."""
    run = dossier.run
    if run is None or not run.history:
        return "<p>–</p>"
    x = [100 * row["contraction"] for row in run.history]
    y = np.degrees([row["m1"] for row in run.history])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 2.7), layout="constrained", dpi=160)
        ax = figure.subplots()
        ax.plot(x, y, "o-", ms=3, color=LINES[0])
        if dossier.answer.get("need") is not None:
            need = np.degrees(dossier.answer["need"])
            ax.axhline(need, ls=(0, (4, 3)), lw=0.9, color=LINES[4])
            ax.annotate(
                "counts as folded", (0.02, need), (0, 2), xycoords=ax.get_yaxis_transform(),
                textcoords="offset points", fontsize=8, color=LINES[4],
            )  # fmt: skip
        ax.set_xlabel("contraction of the active layer, %")
        ax.set_ylabel("fold angle, °")
        ax.set_xlim(left=0)
        ax.spines[["top", "right"]].set_visible(False)
    return _image(_png(figure), "fold angle over contraction")


def _files(dossier: Dossier) -> str:
    from foldlab.making.folder import FILES

    told = {
        name: f"not written: {dossier.missing[name]}" if name in dossier.missing else words
        for name, words in FILES.items()
    }
    return "".join(f"<li><b>{escape(k)}</b> {escape(v)}</li>" for k, v in told.items())


def views(drawing: Drawing) -> str:
    """The drawing's views as SVG to stand in a page, without its frame and title."""
    x0, y0, x1, y1 = drawing.box
    pad, high = 3.0, drawing.size[1]
    box = f"{x0 - pad:g} {high - y1 - pad:g} {x1 - x0 + 2 * pad:g} {y1 - y0 + 2 * pad:g}"
    text = svg(replace(drawing, items=[i for i in drawing.items if i.layer != "notes"]))
    # Layers have ids, and a page may hold several drawings.
    text = re.sub(r'^<\?xml.*?\?>\s*|(?<=<g) id="[^"]*"', "", text)
    return re.sub(
        r'width="\S+mm" height="\S+mm" viewBox="[^"]*"', f'viewBox="{box}"', text, count=1
    )


def _row(name: str, words: str) -> str:
    return f"<tr><th>{escape(name)}</th><td>{as_html(words)}</td></tr>"


def as_html(words: object) -> str:
    """Words with angles in degrees and symbols as symbols."""
    text = in_degrees(escape(str(words)))
    text = re.sub(r"\b(E|rho|l|b|h)_([si])\b", r"<i>\1</i><sub>\2</sub>", text)
    return text.replace("<i>rho</i>", "<i>ρ</i>")


def _png(figure: Figure) -> bytes:
    out = BytesIO()
    figure.savefig(out, format="png", dpi=figure.dpi)
    return out.getvalue()


def _image(content: bytes, words: str) -> str:
    return f'<img alt="{escape(words)}" src="data:image/png;base64,{b64encode(content).decode()}">'
