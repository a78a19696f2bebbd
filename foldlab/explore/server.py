"""The explorer's server: on 127.0.0.1 only, for its own page only, and of no file but its own.

A request is answered if it names this server as its host and no other page as its origin; what
computes also needs the token that the address of the page carries behind its #, where neither
another site nor a log sees it. Paths are looked up in tables and never joined to a folder.
"""

from __future__ import annotations

import hmac
import json
import secrets
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

from foldlab.errors import InputError
from foldlab.terminal import note, plain

ADDRESS = "127.0.0.1"
LARGEST = 16 * 1024  # bytes of a request's body
MOST_AT_ONCE = 32  # connections; a page uses six
# Plotly styles what it draws by rules it writes itself, and keeps pictures as data and blobs.
POLICY = (
    "default-src 'none'; script-src 'self'; connect-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
PAGE = (
    "index.html", "style.css", "icon.svg", "app.js", "controls.js", "map.js", "solve.js",
    "shape.js", "beside.js",
)  # fmt: skip

Route = Callable[[Any], dict[str, Any]]


class Refused(Exception):
    """A request that is not answered; ``status`` says why."""

    def __init__(self, status: HTTPStatus, text: str):
        super().__init__(text)
        self.status = status


class Server(ThreadingHTTPServer):
    """Serves the page and ``routes`` (path: function of a JSON object) on a port, 0: any free one.

    ``downloads``: paths that answer with (name, bytes). Raises :class:`InputError` where the port
    is not to be had.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(
        self,
        port: int,
        routes: Mapping[str, Route],
        downloads: Mapping[str, Callable] | None = None,
    ):
        self.routes, self.downloads = dict(routes), dict(downloads or {})
        self.token = secrets.token_urlsafe(24)
        self.free = threading.BoundedSemaphore(MOST_AT_ONCE)
        try:
            super().__init__((ADDRESS, port), Handler)
        except (OSError, OverflowError) as error:
            raise InputError(f"can't serve on port {port} ({error}); give another --port") from None
        self.hosts = {f"{name}:{self.server_port}" for name in (ADDRESS, "localhost")}

    @property
    def url(self) -> str:
        """The page's address, with the token."""
        return f"http://{ADDRESS}:{self.server_port}/#{self.token}"

    def process_request_thread(self, request, client_address) -> None:
        with self.free:
            super().process_request_thread(request, client_address)

    def handle_error(self, request, client_address) -> None:
        """A page that went away is no error."""


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    server: Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "foldlab", ""
    timeout = 30
    disable_nagle_algorithm = True

    def do_GET(self) -> None:
        self._answered(self._file)

    def do_POST(self) -> None:
        self._answered(self._called)

    def log_message(self, format: str, *args) -> None:
        """Nothing: every move of a slider is a request."""

    def _answered(self, respond: Callable[[], None]) -> None:
        try:
            self._same_site()
            respond()
        except Refused as error:
            self._refuse(error.status, str(error))
        except InputError as error:
            self._json(HTTPStatus.BAD_REQUEST, {"error": str(error)})
        except (ConnectionError, TimeoutError):
            self.close_connection = True
        except Exception as error:
            note(f"error: {self.path}: {type(error).__name__}: {error}")
            self._json(
                HTTPStatus.INTERNAL_SERVER_ERROR,
                {"error": "something is wrong in foldlab itself; its terminal says what"},
            )

    def _same_site(self) -> None:
        """Raises :class:`Refused` for a request from elsewhere than this server's own page."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if host not in self.server.hosts:
            raise Refused(HTTPStatus.FORBIDDEN, "this server answers to 127.0.0.1 only")
        if origin is not None and origin not in {f"http://{name}" for name in self.server.hosts}:
            raise Refused(HTTPStatus.FORBIDDEN, "no other site may ask this server")
        if self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise Refused(HTTPStatus.FORBIDDEN, "no other site may ask this server")

    def _file(self) -> None:
        name = urlsplit(self.path).path
        name = "index.html" if name == "/" else name.removeprefix("/")
        if name == "plotly.js":
            content = plotly()
        elif name in PAGE:
            content = (resources.files("foldlab.explore") / "static" / name).read_bytes()
        else:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such page")
        kind = KINDS[name.rpartition(".")[2]]
        self._send(HTTPStatus.OK, content, f"{kind}; charset=utf-8")

    def _called(self) -> None:
        request = self._body()
        if not hmac.compare_digest(
            self.headers.get("X-Foldlab-Token", "").encode(), self.server.token.encode()
        ):
            raise Refused(
                HTTPStatus.FORBIDDEN, "open the address that `foldlab explore` printed last"
            )
        if self.path in self.server.downloads:
            name, content = self.server.downloads[self.path](request)
            kind = {"Content-Disposition": f'attachment; filename="{name}"'}
            self._send(HTTPStatus.OK, content, "application/octet-stream", kind)
        elif self.path in self.server.routes:
            self._json(HTTPStatus.OK, self.server.routes[self.path](request))
        else:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such question")

    def _body(self) -> Any:
        """The JSON of a request; raises :class:`Refused` for any other body."""
        length = self.headers.get("Content-Length", "")
        if "Transfer-Encoding" in self.headers or not (length.isascii() and length.isdigit()):
            raise Refused(HTTPStatus.LENGTH_REQUIRED, "say how long the request is")
        if len(length) > 9 or int(length) > LARGEST:
            raise Refused(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request has at most {LARGEST} bytes"
            )
        if self.headers.get_content_type() != "application/json":
            raise Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a request is of application/json")
        raw = self.rfile.read(int(length))
        try:
            return json.loads(raw, parse_constant=_no_number)
        except (ValueError, RecursionError):
            raise Refused(HTTPStatus.BAD_REQUEST, "the request is no JSON of numbers") from None

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        # What is left of the body is not read, so nothing else can come on this connection.
        self.close_connection = True
        self._json(status, {"error": text}, {"Connection": "close"})

    def _json(self, status: HTTPStatus, answer: Mapping[str, Any], extra=None) -> None:
        # Escaped: a request may hold halves of characters, which have no bytes.
        text = json.dumps(plain(dict(answer)), allow_nan=False)
        self._send(status, text.encode(), "application/json", extra)

    def _send(self, status: HTTPStatus, content: bytes, kind: str, extra=None) -> None:
        self.send_response(status)
        headers = {**HEADERS, "Content-Type": kind, "Content-Length": len(content), **(extra or {})}
        for name, value in headers.items():
            self.send_header(name, str(value))
        self.end_headers()
        self.wfile.write(content)


def plotly() -> bytes:
    """plotly.js as pip's package holds it; :class:`InputError` where it is not installed."""
    try:
        return (resources.files("plotly") / "package_data" / "plotly.min.js").read_bytes()
    except (ImportError, OSError):
        raise InputError(
            "shapes in 3-D need plotly, which is not installed: pip install 'foldlab[explore]'"
        ) from None


def _no_number(text: str) -> float:
    raise ValueError(text)
