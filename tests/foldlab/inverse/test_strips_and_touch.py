"""Wishes that only the solver can judge: panels that touch, and an active layer cut in strips."""

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
import pytest

from foldlab.design import FULL, PATTERNED, to_physical
from foldlab.errors import InputError
from foldlab.inverse.draft import Draft, Work
from foldlab.inverse.finish import as_wished, finish
from foldlab.inverse.propose import propose
from foldlab.inverse.rungs import CUT_SPACE, PRESSED, SPACE, Rungs, parted, solid, turned
from foldlab.inverse.weighted import drafts, regions_of, weighted
from foldlab.inverse.wish import Angle, Wish
from foldlab.labels import beam
from foldlab.labels.asked import Conditions
from foldlab.labels.label import Label
from foldlab.labels.solver import SolverSource

PAIR = {"passive": ("PET",), "active": ("SMP",)}
SIZE = {"l_s": 0.04, "b_s": 0.01}
CONTACT = SolverSource(Conditions(effects="gravity,ground,contact"))
TOUCH = Wish(SPACE, fixed=SIZE, touching=True, **PAIR)
RIGHT = Angle(np.pi / 2, 0.05)
CUT = Wish(CUT_SPACE, want=RIGHT, fixed={**SIZE, "strips": 3, "strip_share": 0.6}, **PAIR)


@dataclass(frozen=True)
class ByRod:
    """A source that believes the rod, for strips too, and says of panels what it is told to."""

    conditions: Conditions = field(default_factory=Conditions)
    patterned: bool = True
    touch: bool = False
    seen: list = field(default_factory=list)

    name = "by rod"

    def label(self, design):
        self.seen.append(dict(design))
        angle = turned(design)[0]
        evidence = {"m1": angle, "stable": True, "topples": False, "core_seconds": 0.1}
        evidence["events"] = [{"kind": "contact", "contraction": 0.1}] if self.touch else []
        return Label(design, bool(angle > np.pi * design["contraction"]), "", evidence)


def first(wish, n=1):
    return drafts(wish, regions_of(wish), n, seed=0, walkers=512).drafts


def test_panels_that_shall_touch_are_confirmed_by_the_solver():
    draft = first(TOUCH)[0]
    assert -PRESSED <= parted(draft.groups) <= 0
    proposal = finish(Work(TOUCH, draft, CONTACT, box=False))
    events = [event["kind"] for event in proposal.label.evidence["events"]]
    assert proposal.confirmed is True and "contact" in events
    apart = replace(TOUCH, touching=False, want=Angle(2.0, 0.05), margin=0.0)
    (other,) = first(apart)
    assert parted(other.groups) > 0
    proposal = finish(Work(apart, other, CONTACT, box=False))
    events = [event["kind"] for event in proposal.label.evidence["events"]]
    assert proposal.confirmed is True and "contact" not in events


def test_panels_part_by_what_two_straight_lines_would():
    # With a short hinge turned by θ the ends of panels of length L are L cos(θ/2) from the plane.
    design = {
        "E_ratio": 1.0, "rho_ratio": 0.1, "hinge_length": 0.05, "hinge_width": 1.0, "h_ratio": 1.0,
        "stiffness_to_weight": 1e6, "aspect": 0.1, "slenderness": 1e-3, "contraction": 0.065,
    }  # fmt: skip
    angle = turned(design)[0]
    half, hinge, panel = angle / 2, 0.025, 0.475
    reach = hinge * np.sin(half) / half + panel * np.cos(half)
    gap = reach - 0.0005 * np.sin(half)
    assert 2.0 < angle < 3.1
    assert parted(design) == pytest.approx(2 * gap / (0.5 - hinge / 2), rel=0.02)


def test_what_the_label_says_of_contact_decides():
    (draft,) = first(replace(TOUCH, touching=None, margin=0.0))
    for asked, touch, verdict in ((True, True, True), (True, False, False), (False, True, False),
                                  (False, False, True), (None, True, True)):  # fmt: skip
        work = Work(replace(TOUCH, touching=asked), draft, ByRod(touch=touch))
        assert as_wished(work, work.source.label(draft.groups)) is verdict


@pytest.mark.parametrize(
    ("change", "source", "words"),
    [
        ({}, ByRod(), "told by the solver with contact among its effects"),
        ({"touching": None, "fixed": CUT.fixed}, ByRod(patterned=False), "solid active layers"),
    ],
)
def test_who_cannot_tell_is_refused(change, source, words):
    with pytest.raises(InputError, match=words):
        weighted(replace(TOUCH, **change), 1, seed=0, source=source, walkers=64)


def test_what_cannot_be_wished_is_refused():
    with pytest.raises(InputError, match="set the angle"):
        replace(TOUCH, want=RIGHT)
    with pytest.raises(InputError, match="stay flat never touch"):
        replace(TOUCH, want="flat")
    with pytest.raises(InputError, match="let it confirm"):
        weighted(TOUCH, 1, seed=0, source=CONTACT, confirmed=False, walkers=64)
    with pytest.raises(InputError, match="the model knows solid"):
        weighted(CUT, 1, seed=0, source=ByRod(), model=object(), walkers=64)
    for wish in (TOUCH, CUT):
        with pytest.raises(InputError, match="known to the solver only"):
            propose(wish, object(), 1, seed=0)
    with pytest.raises(InputError, match="give whole numbers"):
        replace(CUT, fixed={**SIZE, "strips": 2.5})


def test_strips_count_as_a_solid_layer_of_the_same_mass_and_moment():
    design = dict(zip(FULL.names, (0.01, 1.1, 0.3, 0.8, 2.0, 5.0, 0.2, 0.01, 0.1), strict=True))
    assert solid(design) is design
    cut = {**design, "strips": 3, "strip_share": 0.5}
    stiff = solid(cut)
    assert (stiff["E_ratio"], stiff["h_ratio"], stiff["rho_ratio"]) == (0.005, 2.0, 0.55)
    soft = solid({**cut, "E_ratio": 0.001})
    assert soft["E_ratio"] == 0.001
    moment = soft["E_ratio"] * soft["h_ratio"] * (1 + soft["h_ratio"])
    assert moment == pytest.approx(0.5 * 0.001 * 2 * 3)
    assert soft["rho_ratio"] * soft["h_ratio"] == pytest.approx(0.5 * 1.1 * 2)
    # As the beam formulas have it, where both know it.
    turning = beam.turning(pd.DataFrame([cut])).iloc[0]
    assert beam.turning(pd.DataFrame([stiff])).iloc[0] == pytest.approx(turning)


def test_strips_are_part_of_the_design_its_box_and_its_mass():
    source = ByRod()
    answer = weighted(CUT, 1, seed=0, source=source, walkers=512)
    (proposal,) = answer.proposals
    assert (proposal.groups["strips"], proposal.groups["strip_share"]) == (3, 0.6)
    assert all((seen["strips"], seen["strip_share"]) == (3, 0.6) for seen in source.seen)
    assert len(source.seen) == proposal.answers > proposal.box_checked > 0
    assert "strips" not in proposal.physical
    p = proposal.physical
    sheet = p["rho_s"] * p["h_s"] * (p["b_s"] * (p["l_s"] - p["l_i"]) + p["b_i"] * p["l_i"])
    strips = p["rho_i"] * p["h_i"] * p["l_i"] * 0.6 * p["b_i"]
    assert proposal.mass == pytest.approx(sheet + strips)


def test_strips_in_a_range_are_whole_numbers():
    wish = replace(CUT, fixed=SIZE, ranges={"strips": (2, 6)}, max_mass=8e-5)
    some = first(wish, n=6)
    counts = [draft.groups["strips"] for draft in some]
    assert counts and all(count in range(2, 7) for count in counts) and len(set(counts)) > 1
    covers = [draft.groups["strip_share"] for draft in some]
    assert all(0.3 <= cover <= 0.95 for cover in covers) and len(set(covers)) > 1


def test_the_solver_corrects_and_confirms_a_unit_with_strips():
    wish = replace(CUT, fixed={**SIZE, "strips": 2, "strip_share": 0.7})
    (draft,) = first(wish)
    assert isinstance(draft, Draft)
    proposal = finish(Work(wish, draft, SolverSource(space=PATTERNED), box=False))
    assert proposal.confirmed is True and abs(proposal.angle - np.pi / 2) <= 0.05
    # A solid layer would turn it further.
    whole = SolverSource().label({k: proposal.groups[k] for k in FULL.names})
    assert whole.evidence["m1"] > np.pi / 2 + 0.1
    # What is cut fits the hinge.
    names = ["hinge_width", "aspect", "strips", "strip_share"]
    cut = to_physical(pd.DataFrame([proposal.groups])[names], l_s=0.04).iloc[0]
    assert 2 * (cut["w_i"] + cut["s_i"]) == pytest.approx(proposal.physical["b_i"])


def test_a_rung_of_panels_that_touch_is_lost_where_there_is_no_rod():
    design = first(replace(TOUCH, touching=None, margin=0.0))[0].groups
    lost = {**design, "E_ratio": 1e-5}
    assert np.isnan(parted(lost))
    assert Rungs(TOUCH, meet=True).rooms(pd.DataFrame([lost]))[0] == -10
