"""A folder of its own for each test that writes, and a tracker that keeps what it is told."""

import pytest


class Tracker:
    """In place of a tracked run: tables, figures and models by name, and metrics."""

    def __init__(self):
        self.tables, self.figures, self.models, self.told = {}, {}, {}, {}

    def table(self, name, frame):
        self.tables[name] = frame

    def figure(self, name, figure):
        self.figures[name] = figure

    def model(self, name, model, _example):
        self.models[name] = model

    def metrics(self, values, prefix=""):
        self.told |= {prefix + name: value for name, value in values.items()}


@pytest.fixture
def tracker(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Tracker()
