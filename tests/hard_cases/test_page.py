"""The page of hard cases says what the tests prove, and names all of them."""

import page


def test_the_page_is_what_the_docstrings_say():
    assert page.PAGE.read_text(encoding="utf-8") == page.page(), (
        "docs/hard_cases.md is stale; run python tests/hard_cases/page.py"
    )


def test_there_are_forty_cases_and_each_says_what_it_proves():
    tests = [case for group in page.cases().values() for case in group]
    assert len(tests) >= 40 and len({name for name, _ in tests}) == len(tests)
    assert all(len(proves) > 60 for _, proves in tests)


def test_every_question_is_answered_by_tests_that_exist():
    names = {name for group in page.cases().values() for name, _ in group}
    asked = {name for answers in page.QUESTIONS.values() for name in answers}
    assert asked <= names, asked - names
