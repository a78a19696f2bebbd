"""Docstrings name things by the roles of Sphinx, as in :class:`Label`: the pages show the name."""

import re

ROLE = re.compile(r":(?:class|func|meth|data|attr|mod|exc):(?=<code>)")


def on_page_content(html: str, **_) -> str:
    """Called by MkDocs with the HTML of each page."""
    return ROLE.sub("", html)
