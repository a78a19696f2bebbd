"""foldlab: which self-folding units fold, why, how sure we are, and what to build instead."""

from foldlab.datasets import load_dataset
from foldlab.design import FULL, REDUCED, DesignSpace, Parameter
from foldlab.errors import InputError

__version__ = "0.1.0"
__all__ = ["FULL", "REDUCED", "DesignSpace", "InputError", "Parameter", "load_dataset"]
