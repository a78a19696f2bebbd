"""A slow label source that misbehaves on demand, and a campaign as a script that can be killed.

``python campaign_sources.py STORE N SECONDS pool|threads`` labels N designs.
"""

import ctypes
import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pandas as pd

from foldlab.campaign.campaign import run_campaign
from foldlab.labels.label import Label

FOLDS, NOT, UNKNOWN, RAISES, NONE, EXITS, KILLED, UNPICKLABLE, NAN, SYS_EXIT, OTHER = range(11)


def designs(kinds):
    return pd.DataFrame({"x": range(len(kinds)), "kind": kinds}).astype(float)


class Unpicklable(Exception):
    def __init__(self, message):
        super().__init__(message, lambda: None)

    def __str__(self):
        return "held a lambda"


class Slow:
    """Answers as the design's ``kind`` says, after ``seconds``; logs its calls in a file."""

    name = "slow"
    version = "1"

    def __init__(self, log=None, seconds=0.0):
        self.log = log
        self.seconds = seconds
        self.calls = 0

    def label(self, design):
        kind = int(design["kind"])
        self.calls += 1
        if self.log:
            with open(self.log, "a") as file:
                file.write(f"{design['x']:.0f} {os.getpid()}\n")
        time.sleep(self.seconds)
        if kind == RAISES:
            raise ValueError(f"no state\nat {design['x']:.0f} %")
        if kind == NONE:
            return None
        if kind == EXITS:
            os._exit(int(design.get("code", 7)))
        if kind == KILLED:
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == UNPICKLABLE:
            raise Unpicklable("x")
        if kind == SYS_EXIT:
            sys.exit("enough")
        if kind == OTHER:
            design = {**design, "x": -1.0}
        evidence = {"angle": float("nan") if kind == NAN else design["x"] / 7, "calls": self.calls}
        answer = {FOLDS: True, NOT: False, UNKNOWN: None}.get(kind, True)
        return Label(design, answer, f"answered {answer}", {"seconds": time.time(), **evidence})


class Hangs(Slow):
    """As Slow, but never answers for NOT, and says that its labels take ``timeout`` at most.

    In compiled code that never gives Python its turn, asleep or ``busy``.
    """

    timeout = 0.1

    def __init__(self, busy=False, **options):
        super().__init__(**options)
        self.busy = busy

    def label(self, design):
        if design["kind"] == NOT:
            sum(range(10**12)) if self.busy else ctypes.PyDLL(None).sleep(60)
        return super().label(design)


class Threads(Slow):
    """Says how many threads the numerical libraries would use."""

    def label(self, design):
        import numpy as np
        import threadpoolctl

        np.ones((2, 2)) @ np.ones((2, 2))
        threads = max(library["num_threads"] for library in threadpoolctl.threadpool_info())
        self.calls += 1
        return Label(design, True, "", {"threads": threads, "calls": self.calls})


class Counted(Slow):
    """Counts how often it is pickled."""

    pickled = 0

    def __getstate__(self):
        self.pickled += 1
        return self.__dict__


class Timed:
    """A source of the reduced space with settings, as the command line gives them."""

    name = "timed"

    def __init__(self, space, accuracy: float, growth: str = "isotropic", timeout: float = 60.0):
        self.accuracy, self.timeout = accuracy, timeout
        self.version = f"{accuracy!r}-{growth}-{timeout!r}"

    def label(self, design):
        time.sleep(0.01)
        answer = None if design["E_ratio"] > 100 else bool(design["h_ratio"] > 1)
        name = "timeout" if answer is None else "folds" if answer else "flat"
        return Label(design, answer, f"{name} at {design['E_ratio']:.3f}", {"outcome": name})


if __name__ == "__main__":
    path, count, seconds, how = sys.argv[1:]
    table = designs([k % 3 for k in range(int(count))])
    print("begun", flush=True)
    with ThreadPoolExecutor(2) as threads:
        executor = threads if how == "threads" else None
        source = Slow(path + ".log", float(seconds))
        run_campaign(table, source, path, executor=executor, workers=2, progress=False)
