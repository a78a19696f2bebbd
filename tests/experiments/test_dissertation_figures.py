"""What the comparison with the dissertation's figures measures on its own, and its verdicts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import dissertation_figures as figures
from experiments.dissertation_figures import TABLE_41, TABLE_42, Config
from foldlab.labels.label import Label


def test_bending_is_that_of_the_hinge_and_about_the_axis_that_it_bends_about():
    design = figures.TABLE_41 | {"contraction": 0.05}
    run, _ = figures._path(figures.Config(), design, effects="none")
    larger, other, off = figures._bending(run)
    # Without curling the turning within the hinge is curvature times length.
    assert larger == pytest.approx(run.history[-1]["hinge"] / 0.2, rel=0.01)
    assert abs(other) < 1e-2 * larger and off < 1


@pytest.fixture
def asked(monkeypatch):
    """Paths in place of the solver's; ``asked.answer(design, growth, effects, options)`` tells."""
    seen = SimpleNamespace(paths=[], answer=lambda *_: Label({}, True, "", {"outcome": "folds"}))

    def path(config, design, *, growth="uniaxial", effects="gravity,ground", **options):
        seen.paths.append((design, growth, effects, options))
        return ("run", len(seen.paths)), seen.answer(design, growth, effects, options)

    monkeypatch.setattr(figures, "_path", path)
    return seen


def label(folds, **evidence):
    return Label({}, folds, "", {"outcome": "folds" if folds else "curled", **evidence})


def test_fig_417_agrees_where_weight_alone_keeps_the_light_unit_from_folding(asked):
    def answer(design, growth, effects, options):
        free = effects == "none" or design["stiffness_to_weight"] == 0.4
        return label(free or (asked.more and design["contraction"] == 0.4))

    asked.answer, asked.more = answer, False
    paths, said = figures.weight(Config())
    groups = [(d["stiffness_to_weight"], d["contraction"], e) for d, _, e, _ in asked.paths]
    both = "gravity,ground"
    assert groups == [
        (0.04, 0.25, both), (0.4, 0.25, both), (0.04, 0.4, both), (0.4, 0.25, "none"),
    ]  # fmt: skip
    assert said["agrees"] and len(paths) == 4
    assert said["ours"] == ("without weight yes; Γ = 0.04: no at 0.25, no at 0.4; Γ = 0.4: yes")
    asked.more = True
    assert not figures.weight(Config())[1]["agrees"]


def test_fig_418_agrees_where_one_kind_of_contraction_has_the_three_verdicts(asked):
    def answer(design, growth, effects, options):
        if options.get("question") == "exists" and asked.holds:
            return label(design["stiffness_to_weight"] == 0.4 and design["aspect"] == 0.25)
        return label(None if growth == "uniaxial" else False)

    asked.answer, asked.holds = answer, True
    paths, said = figures.lift_and_width(Config(scan=1))
    assert said["agrees"] and len(paths) == 9
    assert said["ours"] == (
        "uniaxial: unknown, unknown, unknown; isotropic from flat: no, no, no; "
        "isotropic, exists: no, yes, no"
    )
    assert "0 for holds" not in said["why"] and "does not hold for 1" in said["why"]
    asked.holds = False
    assert not figures.lift_and_width(Config(scan=1))[1]["agrees"]


@pytest.mark.parametrize(
    ("answers", "word"),
    [
        ((False, True, False), "holds"),
        ((False, None, False), "is unknown"),
        ((True, True, False), "does not hold"),
        ((None, True, True), "does not hold"),
    ],
)
def test_a_scanned_unit_is_counted_once(asked, answers, word):
    cases = {"A": (0.04, 0.25), "B": (0.4, 0.25), "C": (0.4, 0.5)}
    by = dict(zip(cases.values(), answers, strict=True))
    asked.answer = lambda design, *_: label(by[design["stiffness_to_weight"], design["aspect"]])
    held, counts = figures._scanned(Config(scan=1), cases)
    assert {k: n for k, n in counts.items() if n} == {word: 1}
    assert held == (["0.05, 0.2, 0.15"] if word == "holds" else [])
    # B is asked first; what is wrong already asks no more.
    assert asked.paths[0][0]["stiffness_to_weight"] == 0.4 and asked.paths[0][0]["aspect"] == 0.25
    assert {growth for _, growth, *_ in asked.paths} == {"isotropic"}
    assert len(asked.paths) == (2 if answers[0] is True else 3)
    assert asked.paths[0][0]["E_ratio"] == 0.05 and asked.paths[0][0]["hinge_length"] == 0.15


def test_fig_430_agrees_where_a_solid_and_a_cut_unit_fold_at_one_weight(asked):
    asked.both = True

    def answer(design, growth, effects, options):
        if options:
            return label(options["strips"] == 3 or (None if options["strips"] == 2 else False))
        return label(asked.both and design["stiffness_to_weight"] > 1, m2=0.25)

    asked.answer = answer
    paths, said = figures.patterned_unit(Config(strips=(2, 3, 5), fraction=(0.5, 0.8)))
    assert said["agrees"] and len(paths) == 4
    assert [d["stiffness_to_weight"] for d, *_ in asked.paths] == [0.4] * 7 + [10.0] * 7
    assert asked.paths[1][3] == {"strips": 2, "strip_share": 0.5}
    assert said["ours"].split("; ")[0] == (
        "Γ = 0.4: solid no (m2 0.25), strips that fold: 3 of 0.5, 3 of 0.8 of 6 patterns, 2 unknown"
    )
    asked.both = False
    assert not figures.patterned_unit(Config(strips=(3,), fraction=(0.5,)))[1]["agrees"]


@pytest.mark.parametrize(
    ("solid", "strips", "agrees"), [(45, 5, True), (25, 5, False), (65, 5, False), (45, 20, False)]
)
def test_fig_431_agrees_where_the_solid_bends_about_a_diagonal_and_strips_do_not(
    asked, monkeypatch, solid, strips, agrees
):
    offs = iter((solid, strips))
    monkeypatch.setattr(figures, "_bending", lambda run: (2.5, 0.5, next(offs)))
    _, said = figures.patterned_layer(Config(strips=(2, 7)))
    assert said["agrees"] is agrees
    (square, *_, options), (*_, cut) = asked.paths
    assert options == {} and cut == {"strips": 7} and square["aspect"] == 1.0
    assert f"solid 2.5 and 0.5 about an axis {solid}° off x" in said["ours"]


def test_fig_415_agrees_where_an_upright_unit_can_topple(asked):
    events = [{"kind": "snap", "contraction": 0.1}, {"kind": "toppling", "contraction": 0.28},
              {"kind": "toppling", "contraction": 0.29}]  # fmt: skip
    asked.answer = lambda *_: label(True, events=events, fold_angle=1.25)
    paths, said = figures.toppling(Config())
    assert said["agrees"] and list(paths) == ["held upright", "free to fall"]
    assert said["ours"] == "can topple from g = 0.28 on; let go: folds, m1 1.25 rad"
    assert asked.paths[1][3] == {"upright": False} and asked.paths[0][0] == TABLE_41
    asked.answer = lambda *_: label(True, events=events[:1])
    said = figures.toppling(Config())[1]
    assert not said["agrees"] and said["ours"] == "no toppling; let go: folds, m1 nan rad"


@pytest.mark.parametrize(("angle", "agrees"), [(3.29, True), (3.31, False), (2.69, False)])
def test_fig_416_agrees_within_03_rad_and_says_what_locking_explains(
    asked, monkeypatch, angle, agrees
):
    asked.answer = lambda design, growth, *_: label(
        True, fold_angle=angle if growth == "uniaxial" else 1.0, m2=0.5
    )
    unit = SimpleNamespace(hinge_length=0.2)
    run = SimpleNamespace(folding=SimpleNamespace(model=SimpleNamespace(unit=unit)))
    path = figures._path
    monkeypatch.setattr(figures, "_path", lambda *a, **k: (run, path(*a, **k)[1]))
    locked = SimpleNamespace(
        last=SimpleNamespace(curves="curves"), model=SimpleNamespace(scene=SimpleNamespace(size=77))
    )
    monkeypatch.setattr(figures, "build", lambda *given: given)
    monkeypatch.setattr(figures, "fold", lambda given: locked)
    monkeypatch.setattr(
        figures,
        "measure",
        lambda curves, length: SimpleNamespace(m1=angle * (0.9 if length == 0.2 else 0)),
    )
    _, said = figures.no_weight(Config())
    assert said["agrees"] is agrees
    assert said["ours"] == (
        f"uniaxial {angle:.2f} rad; isotropic from flat 1.00 rad, curled by 0.50 rad"
    )
    assert "(77 unknowns): locking explains 10 % of the" in said["why"]
    assert f"they read {100 * (angle - 3) / angle:.0f} % less" in said["why"]


def test_each_figure_has_a_row_and_a_picture(tracker, monkeypatch):
    monkeypatch.setattr(figures, "toppling", lambda config: ({}, {"ours": "so", "agrees": True}))
    monkeypatch.setattr(
        figures, "_picture",
        lambda paths, title: SimpleNamespace(savefig=lambda path, dpi: path.write_bytes(b"png")),
    )  # fmt: skip
    result = figures.run(replace(Config(), figures=("4.15",)), tracker)
    assert result["table"] == [{"figure": "4.15", "ours": "so", "agrees": True}]
    assert set(tracker.figures) == {"figure_4_15"}


def test_pictures_show_the_start_the_middle_and_the_end():
    def state(k):
        return SimpleNamespace(curves=np.full((4, 3, 3), float(k)))

    run = SimpleNamespace(
        folding=SimpleNamespace(states=[state(k) for k in range(5)]),
        history=[{"contraction": 0.1}, {"contraction": 0.234}],
    )
    none = SimpleNamespace(folding=SimpleNamespace(states=[]), history=[])
    figure = figures._picture({"so": run, "none": none}, "title")
    first, second = figure.axes
    heights = [line.get_data_3d()[2][0] for line in first.lines]
    assert heights == [0.0] * 4 + [2.0] * 4 + [4.0] * 4
    assert first.get_title() == "so\nto g = 0.23" and not second.lines


def test_tables_are_those_of_the_dissertation():
    assert (TABLE_41["hinge_length"], TABLE_41["h_ratio"], TABLE_41["contraction"]) == (0.2, 5, 0.3)
    assert (TABLE_42["hinge_length"], TABLE_42["h_ratio"], TABLE_42["contraction"]) == (
        0.25, 0.2, 0.4,
    )  # fmt: skip
