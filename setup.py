"""What pyproject.toml has no words for: a wheel has ``experiments/`` as ``foldlab._experiments``.

As ``experiments`` beside other packages it would clash with anybody's folder of that name.
"""

from setuptools import find_packages, setup

HOME = "foldlab._experiments"

setup(
    packages=[
        *find_packages(include=["foldlab*", "solver*"]),
        HOME,
        *(f"{HOME}.{name}" for name in find_packages("experiments")),
    ],
    package_dir={HOME: "experiments"},
)
