"""What a verb prints for the eye: a table, and the single values below it."""

import json

from foldlab.terminal import emit


def test_below_a_table_stand_single_values_only(capsys):
    rows = [{"model": "tree", "accuracy": 0.912345}]
    result = {"n": 3, "models": rows, "axes": ["h_ratio"], "of": {"a": 1}, "gone": None}
    emit(result, False, rows)
    *table, first, last = capsys.readouterr().out.splitlines()
    assert (first, last) == ("n: 3", "gone: –")
    assert "0.9123" in "".join(table) and "h_ratio" not in "".join(table)
    assert "axes" not in "".join([*table, first, last])
    emit(result, True, rows)
    assert json.loads(capsys.readouterr().out) == result


def test_brackets_are_printed_and_are_no_markup(capsys):
    words = "b = 5 [mm] of [red]paper[/red], [/]"
    emit({"told": words}, False, [{"what [SI]": words}, {"what [SI]": "[b]x"}])
    head, _, first, second, last = capsys.readouterr().out.splitlines()
    assert head.strip() == "what [SI]" and first.strip() == words and second.strip() == "[b]x"
    assert last == f"told: {words}"


def test_numbers_of_a_pair_have_as_many_digits_as_single_ones(capsys):
    emit({"interval": (0.8380132448, 1.0), "of": ("a", None, 3)}, False)
    assert capsys.readouterr().out == "interval: (0.838, 1)\nof: (a, –, 3)\n"
