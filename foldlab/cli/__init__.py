"""The command line; the entry point is :func:`main`."""

from foldlab.cli.app import app, main

__all__ = ["app", "main"]
