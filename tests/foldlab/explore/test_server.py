"""The explorer's server answers its own page on this machine, and nobody and nothing else."""

import http.client
import json
import socket
import threading

import pytest

from foldlab.errors import InputError
from foldlab.explore import server as serving

SAID = []


def refuse(request):
    raise InputError("h_s = -1; expected a finite number above 0")


def break_down(request):
    raise RuntimeError("/home/somebody/secret")


@pytest.fixture(scope="module")
def server():
    routes = {"/api/echo": lambda r: {"got": r, "x": float("nan")}, "/api/refuse": refuse}
    downloads = {"/api/file": lambda r: ("unit.json", b"{}")}
    made = serving.Server(0, {**routes, "/api/broken": break_down}, downloads)
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield made
    made.shutdown()
    thread.join()
    made.server_close()


def ask(server, method, path, body=None, **headers):
    """Status, content and headers of an answer; ``headers`` replace those of the page, None: none.

    Underscores in their names are hyphens.
    """
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=5)
    kept = {
        "Host": f"127.0.0.1:{server.server_port}",
        "X-Foldlab-Token": server.token,
        "Content-Type": "application/json",
        **{name.replace("_", "-"): value for name, value in headers.items()},
    }
    if body is not None and "Content-Length" not in kept:
        kept["Content-Length"] = str(len(body))
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    for name, value in kept.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(body)
    answer = connection.getresponse()
    told = answer.status, answer.read(), answer.headers
    connection.close()
    return told


def test_it_listens_on_this_machine_only(server):
    assert server.socket.getsockname()[0] == "127.0.0.1"
    assert server.url == f"http://127.0.0.1:{server.server_port}/#{server.token}"
    with serving.Server(0, {}) as other:
        assert len(server.token) >= 32 and other.token != server.token


def test_the_page_and_its_parts_come_with_a_strict_policy(server):
    for name in ("", *serving.PAGE, "plotly.js"):
        status, content, headers = ask(server, "GET", f"/{name}", X_Foldlab_Token=None)
        assert status == 200 and len(content) > 100, name
        assert "script-src 'self';" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "Access-Control-Allow-Origin" not in headers
    for part in serving.PAGE:
        if part.endswith((".html", ".js", ".css")):
            text = ask(server, "GET", f"/{part}")[1].decode()
            assert "https://" not in text and server.token not in text


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py", "/..%2f..%2fpyproject.toml", "//etc/passwd", "/etc/passwd", "/app.js/",
        "/static/app.js", "/%2e%2e/asked.py", "/C:/x", "/index.html%00.js", "/api/echo",
    ],
)  # fmt: skip
def test_no_path_is_a_file_of_this_machine(server, path):
    status, content, _ = ask(server, "GET", path)
    assert status == 404 and json.loads(content) == {"error": "there is no such page"}


def test_a_question_is_answered_with_plain_numbers(server):
    status, content, headers = ask(server, "POST", "/api/echo", b'{"a": 1.5}')
    assert status == 200 and json.loads(content) == {"got": {"a": 1.5}, "x": None}
    assert headers["Content-Type"] == "application/json"
    status, content, headers = ask(server, "POST", "/api/file", b"{}")
    assert (status, content) == (200, b"{}") and 'filename="unit.json"' in str(headers)
    half = ask(server, "POST", "/api/echo", rb'{"a": "\ud800"}')
    assert half[0] == 200 and json.loads(half[1])["got"] == {"a": "\ud800"}
    origin = f"http://127.0.0.1:{server.server_port}"
    assert ask(server, "POST", "/api/echo", b"{}", Origin=origin)[0] == 200


@pytest.mark.parametrize(
    "headers, says",
    [
        ({"Host": "evil.example"}, "127.0.0.1 only"),
        ({"Host": "127.0.0.1:1"}, "127.0.0.1 only"),
        ({"Host": None}, "127.0.0.1 only"),
        ({"Origin": "https://evil.example"}, "no other site"),
        ({"Origin": "null"}, "no other site"),
        ({"Sec_Fetch_Site": "cross-site"}, "no other site"),
        ({"X_Foldlab_Token": None}, "printed last"),
        ({"X_Foldlab_Token": "guessed"}, "printed last"),
        ({"X_Foldlab_Token": "gu\xe9ssed"}, "printed last"),
    ],
)
def test_others_are_refused(server, headers, says):
    status, content, _ = ask(server, "POST", "/api/echo", b"{}", **headers)
    assert status == 403 and says in json.loads(content)["error"]
    assert b"got" not in content


def test_the_page_itself_is_refused_under_another_name(server):
    assert ask(server, "GET", "/", Host="evil.example")[0] == 403
    assert ask(server, "GET", "/", Host=f"localhost:{server.server_port}")[0] == 200


@pytest.mark.parametrize(
    "body, headers, status",
    [
        (b"x" * (serving.LARGEST + 1), {}, 413),
        (b"{}", {"Content-Length": "99999999999999999999"}, 413),
        (b"{}", {"Content-Length": "-2"}, 411),
        (b"{}", {"Content-Length": "\xb2"}, 411),
        (b"{}", {"Content-Length": None, "Transfer_Encoding": "chunked"}, 411),
        (b"{}", {"Content_Type": "text/plain"}, 415),
        (b"{", {}, 400),
        (b"\xff", {}, 400),
        (b'{"a": NaN}', {}, 400),
        (b'{"a": -Infinity}', {}, 400),
        (b"[" * 9000, {}, 400),
    ],
)
def test_bodies_that_are_none_are_refused_and_the_connection_closed(server, body, headers, status):
    got, content, told = ask(server, "POST", "/api/echo", body, **headers)
    assert got == status and list(json.loads(content)) == ["error"]
    assert told["Connection"] == "close"


def test_what_is_wrong_is_one_sentence_and_what_broke_stays_here(server, capsys):
    status, content, _ = ask(server, "POST", "/api/refuse", b"{}")
    assert status == 400
    assert json.loads(content) == {"error": "h_s = -1; expected a finite number above 0"}
    status, content, _ = ask(server, "POST", "/api/broken", b"{}")
    assert status == 500 and b"secret" not in content
    assert "RuntimeError: /home/somebody/secret" in capsys.readouterr().err
    assert ask(server, "POST", "/api/none", b"{}")[0] == 404


@pytest.mark.parametrize("method", ["PUT", "DELETE", "OPTIONS", "TRACE"])
def test_nothing_else_is_done(server, method):
    assert ask(server, method, "/api/echo", b"{}")[0] == 501


def test_a_taken_port_is_said():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"can't serve on port {port} .* another --port"):
            serving.Server(port, {})


def test_the_verb_prints_an_address_that_answers_and_ends_when_told(foldlab_explore):
    out, answered = foldlab_explore
    assert out.startswith("http://127.0.0.1:") and "/#" in out
    assert answered == 200


@pytest.fixture
def foldlab_explore(monkeypatch, capfd):
    from foldlab.explore import live, verb

    monkeypatch.setattr(live.Live, "warm", lambda self: None)
    answered = []

    def look(self, *args, **kwargs):
        SAID.append(self.url)
        threading.Thread(target=lambda: answered.append(ask(self, "GET", "/")[0])).start()
        kept(self, *args, **kwargs)

    kept = serving.Server.serve_forever
    monkeypatch.setattr(serving.Server, "serve_forever", look)
    verb.explore(no_browser=True, seconds=0.5)
    return capfd.readouterr().out, answered[0]
