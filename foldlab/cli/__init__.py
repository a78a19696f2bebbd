"""The command line; the entry point is :func:`main`."""

from foldlab.cli.app import main

__all__ = ["main"]
