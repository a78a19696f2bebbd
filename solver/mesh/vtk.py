"""What VTK says where something fails: it raises nothing, and prints many lines."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def vtk_silenced() -> Iterator[Callable[[], str]]:
    """VTK prints nothing inside; gives a function that returns its first complaint, or ''.

    Those after the first follow from it.
    """
    from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow

    said, before = vtkStringOutputWindow(), vtkOutputWindow.GetInstance()
    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkOutputWindow.SetInstance(said)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)

    def complaint() -> str:
        first = re.search(r"\): (.+)", said.GetOutput())
        return first[1] if first else ""

    try:
        yield complaint
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
        vtkOutputWindow.SetInstance(before)
