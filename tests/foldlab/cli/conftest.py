"""The entry point as a function."""

import sys

import pytest

from foldlab.cli import app as cli


@pytest.fixture
def foldlab(tmp_path, monkeypatch, capsys):
    """Call the entry point in a fresh folder; returns (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)

    def call(line, *more):
        monkeypatch.setattr(sys, "argv", ["foldlab", *line.split(), *more])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out = capsys.readouterr()
        return end.value.code, out.out, out.err

    return call
