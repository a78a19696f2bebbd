"""Whatever JSON a request holds, the answer is an answer or one sentence, never a fault."""

import json
import random

import explore_toys
import pytest

from foldlab.design import FULL
from foldlab.errors import InputError
from foldlab.explore.asked import SIZES
from foldlab.explore.jobs import Jobs
from foldlab.explore.live import FIRST, Live
from foldlab.explore.work import checked
from foldlab.terminal import plain

MIDDLE = {name: float(FULL[name].from_unit(0.5)) for name in FULL.names}
ODD = [
    None, True, False, 0, -1, 1e308, -1e-308, 10**400, 2**70, "", "x", "40mm", "1e400mm", "nan",
    "-5", "1 kg/m³", "9" * 70, "mm", "1 m" + "*m" * 20, "\u0000", "\ud800", "../..",
    "/etc/passwd", [], [[]], {}, {"groups": {}}, [1, 2], "polyester film", "E_ratio", "h_s",
]  # fmt: skip


def spoiled(value, rng):
    """The value with one part replaced, taken away or added."""
    value = json.loads(json.dumps(value))
    part = value
    while True:
        inner = [v for v in part.values() if isinstance(v, dict) and v]
        if not inner or rng.random() < 0.3:
            break
        part = rng.choice(inner)
    kind = rng.randrange(4)
    if kind == 0 and part:
        del part[rng.choice(list(part))]
    elif kind == 1:
        part[rng.choice(["path", "out", "", "design", "groups", "\u0000"])] = rng.choice(ODD)
    else:
        part[rng.choice(list(part) or ["a"])] = rng.choice(ODD)
    return value


@pytest.fixture(scope="module")
def routes():
    live, jobs = Live(), Jobs(explore_toys.serve)
    asked = {"design": FIRST, "contact": True, "accuracy": 0.02, "seconds": 60}
    yield [
        (live.answer, FIRST),
        (live.answer, {"groups": MIDDLE, "passive": "PET"}),
        (live.map, {"design": FIRST, "x": "h_s", "y": "h_i", "side": 3}),
        (live.map, {"design": {"groups": MIDDLE}, "x": "aspect", "y": "h_ratio", "side": 3}),
        (live.facts, {}),
        (jobs.state, {"job": 1}),
        (jobs.cancel, {"job": 1}),
        (jobs.file, {"job": 1}),
        (lambda request: {"seconds": checked("mend", request)}, asked),
    ]
    jobs.close()


def test_spoiled_requests_are_answered_or_refused_in_one_sentence(routes):
    rng, refused = random.Random(1), 0
    for _ in range(300):
        route, request = routes[rng.randrange(len(routes))]
        refused += answered(route, spoiled(request, rng))
    assert 100 < refused < 300


def test_limits_of_sliders_are_answered(routes):
    answer = routes[0][0]
    for p in SIZES:
        for value in (p.low, p.high):
            answered(answer, {**FIRST, "quantities": FIRST["quantities"] | {p.name: value}})
    for p in FULL:
        for value in (p.low, p.high):
            answer({"groups": MIDDLE | {p.name: value}})


def answered(route, request) -> bool:
    """Whether it was refused, in one short line."""
    try:
        told = route(request)
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 600, request
        return True
    json.dumps(plain(told), allow_nan=False)
    return False
