"""The page that the quickstart ends with: ``index.html``, plain, with relative links, no script."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from foldlab.cli.maps import CONTOURS
from foldlab.cli.showcase import (
    CONTRACTION,
    MATERIALS,
    SHEET,
    STRAIN_MARGIN,
    UNIT,
    Designed,
    Folding,
    Mapped,
)
from foldlab.design import FULL
from foldlab.learning.compare import readable
from foldlab.making.drawing import draw, millimetres
from foldlab.making.geometry import Geometry
from foldlab.making.report import as_html, sizes, views
from foldlab.unit.told import strained_by, yes

PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>foldlab: which units fold</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body {{ font: 16px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; color: #1d2330;
  max-width: 62rem; margin: 0 auto; padding: 1.5rem 1rem 4rem; }}
h1 {{ font-size: 1.9rem; line-height: 1.2; margin: 0 0 .5rem; }}
h2 {{ font-size: 1.35rem; margin: 3rem 0 .5rem; padding-top: 1rem; border-top: 2px solid #0B3C9C; }}
h3 {{ font-size: 1.05rem; margin: 0 0 .3rem; }}
a {{ color: #0B3C9C; }} p {{ margin: .5rem 0; max-width: 46rem; }}
nav a {{ margin-right: 1.2rem; }}
img, svg {{ max-width: 100%; height: auto; display: block; }}
figure {{ margin: 1rem 0; }} figcaption {{ font-size: .85rem; color: #4a5262; max-width: 46rem; }}
table {{ border-collapse: collapse; font-size: .9rem; margin: .8rem 0; }}
th, td {{ text-align: left; padding: .25rem .9rem .25rem 0; vertical-align: top;
  border-bottom: 1px solid #d9dde5; }}
.numbers td, .numbers th {{ text-align: right; font-variant-numeric: tabular-nums; }}
.numbers th:first-child, .numbers td:first-child {{ text-align: left; }}
.best td {{ font-weight: bold; }}
.wide {{ overflow-x: auto; }}
.two {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(20rem, 1fr)); gap: 1.5rem;
  align-items: start; }}
.verdict {{ font-size: 1.2rem; font-weight: bold; margin: .3rem 0; }}
.drawing svg {{ max-height: 22rem; margin: 0 auto; }}
.card {{ border: 1px solid #d9dde5; border-radius: 6px; padding: 1rem; margin: 1rem 0; }}
.small {{ font-size: .85rem; color: #4a5262; }}
pre {{ background: #f3f5f9; padding: .7rem .9rem; overflow-x: auto; font-size: .85rem;
  border-radius: 6px; margin: .4rem 0; }}
sub {{ line-height: 1; }}
</style></head><body>
{body}
</body></html>
"""
MEANS = """A self-folding unit is a flat sheet with a second layer on its middle. That layer
contracts, the hinge bends, and the panels must lift their own weight off the ground. <b>It
folds</b> if the sheet’s ends turn against each other by more than π times the contraction (or by
the angle that you ask for), the hinge curls across by less than half of that, both edges turn
alike, and the state is stable and reached from flat."""
HEADINGS = {
    "holds for": "holds for", "strain": "peak strain",
    "over the materials": "over the ranges of its materials",
}  # fmt: skip
COLUMNS = {"l_s": "length", "b_s": "width", "h_s": "thickness"}


@dataclass(frozen=True)
class Contents:
    """What the page shows. ``rows``: of the comparison; ``addresses``: of the logged models, by
    name; ``example``: values of designs by group; ``seconds``: what each part took; ``tracking``:
    MLflow's address, None where the environment says it."""

    rows: Sequence[Mapping[str, Any]]
    best: str
    labels: int
    addresses: Mapping[str, str]
    map_accuracy: float
    example: Mapping[str, Sequence[float]]
    tracking: str | None
    seconds: Mapping[str, float]
    mapped: Mapped
    folding: Folding | None = None
    designed: Designed | None = None


def html(contents: Contents) -> str:
    """The page's text; its links are relative to the quickstart's folder."""
    sections = {
        "unit": ("One unit folds", _unit(contents.folding)),
        "designs": ("Designs for a wish", _designs(contents.designed)),
        "map": ("Where units fold under their weight", _map(contents.mapped)),
        "models": ("Models that learned from labels", _models(contents)),
        "seconds": ("What it took", _seconds(contents)),
        "on": ("Go on", _commands(contents)),
    }
    links = "".join(f'<a href="#{key}">{title}</a>' for key, (title, _) in sections.items())
    body = [f"<h1>Which self-folding units fold?</h1><p>{MEANS}</p><nav>{links}</nav>"]
    body += [
        f'<h2 id="{key}">{title}</h2>\n{"".join(parts)}' for key, (title, parts) in sections.items()
    ]
    return PAGE.format(body="\n".join(body))


def _unit(shown: Folding | None) -> Iterable[str]:
    if shown is None:
        yield "<p>Left out; <code>--set unit=true</code> shows one.</p>"
        return
    answer, g = shown.answer, shown.unit.physical["contraction"]
    passive, active = (escape(shown.unit.materials[role]) for role in ("passive", "active"))
    verdict = {True: "It folds", False: "It does not fold", None: "Unknown"}[answer["foldable"]]
    if answer["fold_angle"] is not None:
        verdict += f": {_degrees(answer['fold_angle'])}"
    if answer["error_m1"] is not None:
        verdict += f" ± {_degrees(answer['error_m1'], 1)}"
    yield (
        f"<p>A {passive} with a {active} on its middle: "
        f"{as_html(sizes(Geometry.of(shown.unit.physical)))}. The layer contracts by "
        f"{100 * g:.3g} %; the panels weigh, lie on a ground and stop at each other.</p>"
    )
    facts = {
        "why": f"{as_html(answer['reason'])}. {_story(shown)}",
        "tips over, if let go": yes(answer["topples"]),
        "peak strain": escape(strained_by(answer["strain"])),
        "cost": f"{answer['core_seconds']:.2g} core-seconds",
        "files": ", ".join(_link(f"unit/{name}", name) for name in shown.files),
    }
    words = f'<p class="verdict">{escape(verdict)}</p>{_facts(facts)}'
    yield f'<div class="two"><div>{_film(shown)}</div><div>{words}</div></div>'
    pictures = {"angle.png": "Angles over contraction", "strain.png": "Strain at the end"}
    kept = [_figure(f"unit/{k}", v, v) for k, v in pictures.items() if k in shown.files]
    yield f'<div class="two">{"".join(kept)}</div>'


def _film(shown: Folding) -> str:
    """The animation; a still where nothing moves, by wish or for want of a renderer."""
    if "shapes.png" not in shown.files:
        return "<p>The solver gave no shape.</p>"
    if "fold.gif" not in shown.files:
        why = "<p>VTK can’t render in three dimensions here, so there is no animation.</p>"
        return _figure("unit/shapes.png", "the unit from the side, flat to folded") + why
    still = '<source srcset="unit/shapes.png" media="(prefers-reduced-motion: reduce)">'
    moving = _image("unit/fold.gif", "the unit folds, state by state")
    caption = (
        f"{shown.states} equilibrium states, each found by the finite-strain solver. "
        "Blue: passive sheet; orange: active layer."
    )
    return f"<figure><picture>{still}{moving}</picture><figcaption>{caption}</figcaption></figure>"


def _story(shown: Folding) -> str:
    """When it lifts off and when its panels meet."""
    first: dict[str, float] = {}
    for event in shown.label.evidence.get("events", []):
        first.setdefault(event["kind"], 100 * event["contraction"])
    told = []
    if "lift-off" in first:
        told.append(f"leave the ground at {first['lift-off']:.2g} % contraction")
    if "contact" in first:
        told.append(f"meet at {first['contact']:.3g} % and press on each other from there on")
    return f"Its panels {', '.join(told)}." if told else ""


def _designs(shown: Designed | None) -> Iterable[str]:
    if shown is None:
        yield "<p>Left out; <code>--set proposals=5</code> finds some.</p>"
        return
    wish, answer = shown.answer.wish, shown.answer
    sheet = ", ".join(f"{COLUMNS[k]} {millimetres(1e3 * v)} mm" for k, v in SHEET.items())
    yield (
        f"<p>The wish: a sheet of {escape(' with '.join(MATERIALS))} ({sheet}) that folds by "
        f"{_degrees(wish.want.value)} ± {_degrees(wish.want.tolerance)} under its weight and "
        f"strains its materials by at least {100 * STRAIN_MARGIN:.0f} % less than they surely "
        "bear. Beam formulas and a rod propose; the solver corrects and confirms each design and "
        f"the worst corners of its tolerances. Answer: {escape(answer.reason)}, "
        f"{answer.core_seconds:.3g} core-seconds.</p>"
    )
    if shown.rows:
        table = [{k: _number(v) for k, v in row.items()} for row in shown.rows]
        yield _table(table) + (
            '<p class="small">Sizes in mm: <i>l</i> length, <i>b</i> width, <i>h</i> thickness; '
            "<i>s</i> sheet, <i>i</i> active layer.</p>"
        )
    for number, (proposal, made) in enumerate(
        zip(answer.proposals, shown.made, strict=True), start=1
    ):
        yield _card(number, proposal, made, shown.words)


def _card(number: int, proposal, made: Mapping[str, Any], words: Mapping[str, Any]) -> str:
    folder = f"designs/{made['folder']}"
    drawing = draw(Geometry.of(proposal.physical, proposal.groups), f"Design {number}")
    picture = ""
    if "folded.png" in made["files"]:
        picture = _image(f"{folder}/folded.png", f"design {number}, flat to folded")
    facts = {"confirmed": as_html(words[str(number)].removeprefix("confirmed "))}
    for name, heading in HEADINGS.items():
        if f"{number} {name}" in words:
            facts[heading] = as_html(words[f"{number} {name}"])
    facts["files"] = ", ".join(_link(f"{folder}/{name}", name) for name in made["files"])
    if made["missing"]:
        why = [f"{name}: {told}" for name, told in made["missing"].items()]
        facts["not written"] = escape("; ".join(why))
    return (
        f'<div class="card"><h3>Design {number}: {_degrees(made["fold_angle"])}</h3>{picture}'
        f'<div class="two"><div class="drawing">{views(drawing)}</div>{_facts(facts)}</div></div>'
    )


def _map(shown: Mapped) -> Iterable[str]:
    c = shown.checked
    yield (
        f"<p>The shipped model <code>{escape(shown.model)}</code> learned from the solver’s labels "
        f"and says of {shown.regime.points:,} designs whether they fold: stiffness of the active "
        "layer over that of the sheet against their thicknesses, from heavy sheets (first panel) "
        "to stiff ones (last). The dashed line is where they would fold if nothing weighed.</p>"
    )
    if c:
        agree, known = shown.sure
        others = f"{c['verified_agree'] - agree} of {c['verified_known'] - known}"
        yield (
            f"<p>The solver was asked of {c['verified']} of them (dots), half of these near the "
            f"model’s boundary. It agrees on <b>{agree} of {known}</b> where the model is sure (P "
            f"below {CONTOURS[0]:g} or above {CONTOURS[1]:g}) and on <b>{others}</b> between the "
            f"white lines; {c['verified_core_seconds']:.2g} core-seconds.</p>"
        )
    yield _figure("map_under_weight.png", "map of designs that fold under their weight")


def _models(contents: Contents) -> Iterable[str]:
    yield (
        f"<p>{contents.labels:,} designs without weight, labelled by beam theory, teach each of "
        "these models; “fresh” is the fraction of designs that no model saw on which it is right. "
        f"The best one drew the maps and is kept in {_link('model/model.json', 'model')}; "
        f"{_link('comparison.csv', 'comparison.csv')} has all columns.</p>"
    )
    best = [row["model"] for row in contents.rows].index(contents.best)
    yield _table(readable(contents.rows), best)
    maps = {
        "regimes_predicted.png": "What the best model predicts, without weight.",
        "regimes_validated.png": "The same against beam theory: it is right on "
        f"{100 * contents.map_accuracy:.2f} % of the map.",
    }
    figures = [_figure(name, text, text) for name, text in maps.items()]
    yield f'<div class="two">{"".join(figures)}</div>'
    yield (
        "<p>Every model is in MLflow with its signature and an example of its input, and hears "
        "designs by the names of their columns:</p>"
    )
    lines = ["import mlflow", "import pandas as pd", ""]
    if contents.tracking is not None:
        lines.append(f'mlflow.set_tracking_uri("{contents.tracking}")')
    values = ", ".join(f'"{k}": {list(v)}' for k, v in contents.example.items())
    lines += [
        f'model = mlflow.pyfunc.load_model("{contents.addresses[contents.best]}")',
        f"designs = pd.DataFrame({{{values}}})",
        "print(model.predict(designs))",
    ]
    code = "\n".join(lines)
    yield f"<pre>{escape(code)}</pre>"
    yield _facts({k: f"<code>{escape(v)}</code>" for k, v in contents.addresses.items()})


def _seconds(contents: Contents) -> Iterable[str]:
    rows = [{"part": k, "seconds": f"{v:.1f}"} for k, v in contents.seconds.items()]
    yield _table([*rows, {"part": "all", "seconds": f"{sum(contents.seconds.values()):.1f}"}])
    yield '<p class="small">Wall-clock seconds, on whatever else this machine did.</p>'


def _commands(contents: Contents) -> Iterable[str]:
    made = " ".join(f"--set {k}={_given(k, v)}" for k, v in UNIT.items())
    sheet = " ".join(f"--set {k}={_given(k, v)}" for k, v in SHEET.items())
    of = f"--passive {MATERIALS[0]} --active {MATERIALS[1]}"
    slices = f"--slice stiffness_to_weight --set contraction={CONTRACTION:g}"
    commands = {
        "Will my unit fold, how sure is that, what shall I change?": f"foldlab check {of} {made}",
        "The unit above, with its film": (
            f"foldlab simulate {of} {made} --effects gravity,ground,contact --animate"
        ),
        "Designs like those above, and files to make them": (
            f"foldlab design {of} {sheet} --want angle=90deg "
            f"--strain-margin {100 * STRAIN_MARGIN:.0f}% -n 5 --files made"
        ),
        "The map above": f"foldlab map --space {FULL.name} {slices} -o map.png --verify 12",
        "Materials with their ranges and limits": "foldlab materials",
        "What there is": "foldlab --help",
    }
    if contents.tracking is not None:
        commands["All runs"] = f"mlflow ui --backend-store-uri {contents.tracking}"
    yield (
        "<p>After <code>make demo</code> these programs are in <code>.venv/bin</code>: type "
        "<code>. .venv/bin/activate</code> first, and stay in the folder that you are in.</p>"
    )
    for title, command in commands.items():
        yield f"<p>{escape(title)}</p><pre>{escape(command)}</pre>"


def _given(name: str, value: float) -> str:
    return f"{100 * value:g}%" if name == "contraction" else f"{1e3 * value:g}mm"


def _degrees(angle: float, digits: int = 3) -> str:
    return f"{float(f'{np.degrees(angle):.{digits}g}'):g}°"


def _number(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _image(name: str, words: str) -> str:
    return f'<img src="{escape(name)}" alt="{escape(words)}">'


def _link(name: str, words: str) -> str:
    return f'<a href="{escape(name)}">{escape(words)}</a>'


def _figure(name: str, words: str, caption: str = "") -> str:
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><a href="{escape(name)}">{_image(name, words)}</a>{below}</figure>'


def _facts(rows: Mapping[str, str]) -> str:
    """A table of headings and HTML."""
    lines = "".join(f"<tr><th>{escape(k)}</th><td>{v}</td></tr>" for k, v in rows.items())
    return f"<table>{lines}</table>"


def _table(rows: Sequence[Mapping[str, str]], best: int | None = None) -> str:
    head = "".join(f"<th>{as_html(name)}</th>" for name in rows[0])
    lines = []
    for k, row in enumerate(rows):
        cells = "".join(f"<td>{as_html(text)}</td>" for text in row.values())
        lines.append(f"<tr{' class=best' if k == best else ''}>{cells}</tr>")
    return f'<div class="wide"><table class="numbers"><tr>{head}</tr>{"".join(lines)}</table></div>'


def write(folder: Path, contents: Contents) -> Path:
    """Writes the page into the quickstart's folder; its path."""
    path = folder / "index.html"
    path.write_text(html(contents), encoding="utf-8")
    return path
