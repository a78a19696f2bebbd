"""The command line; the entry point is :func:`main`."""


def main() -> None:
    """See :func:`foldlab.cli.app.main`; imported when called, since workers import this module."""
    from foldlab.cli.app import main

    main()
