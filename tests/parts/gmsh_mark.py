"""Skips a test where Gmsh can't be loaded: its wheel needs X libraries that bare machines lack."""

import pytest

from solver.mesh.gmsh_import import load_gmsh

try:
    load_gmsh()
    missing = ""
except ImportError as error:
    missing = str(error)

needs_gmsh = pytest.mark.skipif(bool(missing), reason=missing or "Gmsh can be loaded")
