"""Runs what stands in pages of text: commands of foldlab, and blocks of Python."""

import re
import shlex
import sys

import pytest

from foldlab.cli import app


def blocks(text: str) -> list[tuple[str, str, str]]:
    """Language, title ("" for none) and text of each fenced block of a page."""
    pattern = r'```(\w*)(?: title="([^"]+)")?\n(.*?)```'
    return re.findall(pattern, text, re.DOTALL)


def run_command(line: str, monkeypatch, capsys) -> list[str]:
    """Run one line of a shell in this process, which must be foldlab's; its words."""
    command = shlex.split(line, comments=True)
    if not command or command[0] == "make":
        return []
    assert command[0] == "foldlab", line
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        app.main()
    assert not end.value.code, f"{line}: {capsys.readouterr().err}"
    return command
