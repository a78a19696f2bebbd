"""The judge of wrong inputs sees each kind of fault; a run goes on where it was cut off."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments import wrong_inputs
from experiments._wrong_inputs import cases, judge

SAMPLE = "sample -n 9 -o o.csv"
CLEAR = "error: no file none.csv; give an existing table"


def refuse(*lines, status=2, write=None):
    def main():
        if write:
            Path(write).write_text("half")
        print("\n".join(lines), file=sys.stderr)
        sys.exit(status)

    return main


def fail():
    raise KeyError("h_ratio")


ENDINGS = {
    judge.REFUSED: refuse("warning: thick", CLEAR),
    judge.ACCEPTED: refuse(status=0),
    judge.TRACEBACK: fail,
    judge.LEFT_OVER: refuse(CLEAR, write="o.csv"),
}
UNCLEAR = {
    "nothing": refuse(),
    "two sentences": refuse(CLEAR, CLEAR),
    "a second line": refuse(CLEAR, "  in row 3"),
    "no sentence": refuse("error: 3"),
    "an address": refuse("error: no table in <object at 0x7f>"),
    "another status": refuse("not reached: the error is not known", status=3),
}


@pytest.mark.parametrize(
    ("ending", "main"),
    [*ENDINGS.items(), *((judge.UNCLEAR, main) for main in UNCLEAR.values())],
    ids=[*ENDINGS, *UNCLEAR],
)
def test_each_ending_is_called_by_its_name(ending, main, tmp_path, monkeypatch):
    case = cases.Case("sample", "option", "-n 'much'", ("sample", "-n", "much"))
    monkeypatch.setattr(cases, "make", lambda *given: case)
    monkeypatch.setattr(judge.app, "main", main)
    row = judge.attempt(0, 7, tmp_path, tmp_path / "case", {})
    assert (row["case"], row["ending"]) == (7, ending)


@pytest.mark.parametrize(("answer", "ending"), [("1", judge.HARMLESS), ("2", judge.ACCEPTED)])
def test_random_damage_is_harmless_where_the_answer_is_the_same(
    answer, ending, tmp_path, monkeypatch
):
    case = cases.Case("score", "file", "l.csv flipped", ("score", "m", "l.csv"), random=True)
    monkeypatch.setattr(cases, "make", lambda *given: case)
    text = f'{{"n": {answer}, "train_seconds": 0.5}}'
    monkeypatch.setattr(judge.app, "main", lambda: print(text))
    right = {"score": judge.CHANGING.sub("", '{"n": 1, "train_seconds": 0.1}\n')}
    assert judge.attempt(0, 7, tmp_path, tmp_path / "case", right)["ending"] == ending


def test_a_line_that_was_cut_off_is_tried_again(tmp_path):
    path = tmp_path / "seed_0.jsonl"
    path.write_text(json.dumps({"case": 0}) + "\n" + json.dumps({"case": 1}))
    assert wrong_inputs._known(path) == {0: {"case": 0}}
    assert path.read_text().count("\n") == 1


def test_each_seed_has_cases_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "copy", lambda *given: None)
    monkeypatch.setattr(cases, "_file", lambda rng, line, arguments, here: ("a file", arguments))

    def made(seed, folder):
        here = [tmp_path / folder / str(number) for number in range(20)]
        for path in here:
            path.mkdir(parents=True)
        return [cases.make(seed, number, tmp_path, path) for number, path in enumerate(here)]

    assert made(0, "once") == made(0, "again") != made(1, "other")


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("-n", "sample -n 0 -o o.csv"), ("-o", "sample -n 9 -o 0"), ("--seed", f"{SAMPLE} --seed 0")],
)
def test_a_wrong_value_stands_in_the_place_of_the_right_one(name, wrong, monkeypatch):
    monkeypatch.setattr(cases, "OPTIONS", {"sample": {name: ("0",)}})
    what, arguments = cases._option(np.random.default_rng(0), "sample", SAMPLE.split(), None)
    assert (what, arguments) == (f"{name} '0'", wrong.split())


def test_what_is_not_right_is_a_fault_and_told(tracker, tmp_path, monkeypatch):
    endings = [judge.REFUSED, judge.HARMLESS, judge.ACCEPTED, judge.HANG, judge.REFUSED]
    asked = []

    def attempts(numbers, config, files):
        asked.append(list(numbers))
        for k in numbers:
            yield {
                "case": k,
                "line": "sample" if k else "label",
                "kind": "option",
                "what": f"-n {k}",
                "seconds": float(k),
                "ending": endings[k],
                "status": 2,
                "said": f"one\nline {k}",
            }

    monkeypatch.setattr(wrong_inputs, "attempts", attempts)
    config = wrong_inputs.Config(until=5, folder=str(tmp_path / "cases"))
    result = wrong_inputs.run(config, tracker)
    assert (result["cases"], result["faults"], result["seconds_most"]) == (5, 2, 4.0)
    assert result[judge.REFUSED] == 2 and result[judge.HANG] == 1
    assert result["complaints"] == [
        f"case 2: sample, -n 2: {judge.ACCEPTED}: ['line 2']",
        f"case 3: sample, -n 3: {judge.HANG}: ['line 3']",
    ]
    label = next(row for row in result["table"] if row["line"] == "label")
    assert label[judge.REFUSED] == 1 and label[judge.ACCEPTED] == 0
    # What is known is not tried again.
    path = tmp_path / "cases" / "seed_0.jsonl"
    path.write_text("".join(path.read_text().splitlines(True)[:3]))
    again = wrong_inputs.run(config, tracker)
    assert asked == [[0, 1, 2, 3, 4], [3, 4]] and again["faults"] == 2


def test_a_case_whose_process_ended_took_its_time_only_if_it_hung(tmp_path, monkeypatch):
    case = cases.Case("sample", "option", "-n 'much'", ("sample", "-n", "much"))
    monkeypatch.setattr(cases, "make", lambda seed, number, *_: case)
    config = wrong_inputs.Config(seconds=9.0)
    hung = wrong_inputs._lost(4, config, tmp_path, judge.HANG)
    assert hung["seconds"] == 9.0 and hung["case"] == 4 and hung["status"] is None
    assert hung["said"] == "sample -n much" and hung["line"] == "sample"
    assert np.isnan(wrong_inputs._lost(4, config, tmp_path, judge.CRASH)["seconds"])


def test_a_group_that_is_left_out_takes_its_option_with_it():
    arguments = cases.LINES["simulate"][0].split()
    seen = set()
    for seed in range(300):
        what, made = cases._setting(np.random.default_rng(seed), "simulate", arguments, None)
        if not what.startswith("without "):
            # What is set is appended to the line.
            assert made[:-2] == arguments and made[-2] == "--set" and what == f"--set {made[-1]}"
            continue
        name = what.removeprefix("without ")
        (at,) = (k for k, word in enumerate(arguments) if word.startswith(f"{name}="))
        assert arguments[at - 1] == "--set"
        assert made == [a for k, a in enumerate(arguments) if k not in (at - 1, at)]
        seen.add(name)
    assert len(seen) > 3
