"""The process that draws: what counts as drawn."""

from foldlab.unit.render import drawn_apart


def test_pictures_count_where_the_process_succeeds_and_all_are_there(tmp_path):
    request, picture = tmp_path / "request.json", tmp_path / "a.png"
    picture.touch()

    # json.tool reads its file, and succeeds if that is JSON.
    def drawn(module, *pictures):
        done = drawn_apart(module, {"width": 3}, request, pictures, timeout=60)
        assert not request.exists()
        return done

    assert drawn("json.tool", picture)
    assert not drawn("json.tool", picture, tmp_path / "b.png")
    # An old picture is none of a process that failed.
    assert not drawn("no_such_module", picture)


def test_what_takes_too_long_is_not_drawn(tmp_path):
    assert not drawn_apart("json.tool", {}, tmp_path / "request.json", [], timeout=1e-6)
    assert not list(tmp_path.iterdir())
