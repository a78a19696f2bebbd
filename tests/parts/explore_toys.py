"""Processes that stand for the explorer's solver."""

import os
import time


def serve(pipe):
    """Answers what it was asked for; "wait" takes for ever, "die" ends the process."""
    while True:
        try:
            kind, request = pipe.recv()
        except EOFError:
            return
        toy = request["toy"]
        pipe.send(("said", f"at {toy}"))
        if toy == "wait":
            time.sleep(600)
        if toy == "die":
            os._exit(1)
        if toy == "refuse":
            pipe.send(("error", "the design is no folding unit"))
        else:
            pipe.send(("done", {"kind": kind, "toy": toy, "process": os.getpid()}))
