"""Structures of many hinges: pattern files, laws from labels, answers and pictures."""

from foldlab.packaged import check_solver

check_solver()
