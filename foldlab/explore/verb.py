"""The verb ``explore``."""

from __future__ import annotations

import threading
from typing import Annotated

import typer

from foldlab.terminal import note


def explore(
    *,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port on this machine; 0: any free one.")
    ] = 0,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address, and open no browser.")
    ] = False,
    seconds: Annotated[
        float | None, typer.Option(min=0, help="End by itself after so many seconds.")
    ] = None,
) -> None:
    """Set a unit by hand on a page of this machine: verdict at once, map, shapes, files."""
    from foldlab.explore.server import Server, plotly

    plotly()
    from foldlab.explore.jobs import Jobs
    from foldlab.explore.live import Live

    live, jobs = Live(), Jobs()
    routes = {
        "/api/facts": live.facts, "/api/answer": live.answer, "/api/map": live.map,
        "/api/ranges": live.ranges,
        "/api/start": jobs.start, "/api/job": jobs.state, "/api/cancel": jobs.cancel,
    }  # fmt: skip
    server = Server(port, routes, {"/api/file": jobs.file})
    threading.Thread(target=live.warm, daemon=True).start()
    serving = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1})
    serving.start()
    try:
        print(server.url, flush=True)
        note("open this address in a browser of this machine; Ctrl-C ends it")
        if not no_browser:
            import webbrowser

            webbrowser.open(server.url)
        serving.join(seconds)
    except KeyboardInterrupt:
        note("ended")
    finally:
        server.shutdown()
        serving.join()
        server.server_close()
        jobs.close()
