"""What all figures share: symbols, numbers, and files that are whole."""

import os

import numpy as np
import pytest
from matplotlib.figure import Figure

from foldlab.design import FULL
from foldlab.plots import SYMBOLS, number, save_figure, symbol


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1, "1"), (10.0, "10^{1}"), (1e-3, "10^{-3}"), (10**-2.75, "10^{-2.75}"),
        (10**0.45, "10^{0.45}"), (10**0.46, "2.88"), (0.05, "0.05"), (3.14159, "3.14"),
        (0.0, "0"), (-10.0, "-10"),
    ],
)  # fmt: skip
def test_a_number_is_a_power_of_ten_where_it_is_a_plain_one(value, text):
    assert number(value) == text


def test_every_group_has_its_symbol_and_other_names_stay():
    assert set(FULL.names) <= set(SYMBOLS)
    assert symbol("h_ratio") == "$h_i/h_s$" and symbol("seconds") == "seconds"
    # Γ = E_s h_s²/(ρ_s g l_s³)
    assert symbol("stiffness_to_weight") == r"$E_s h_s^2/(\rho_s g\, l_s^3)$"


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o027, 0o640)])
def test_a_figure_is_as_readable_as_any_other_new_file(tmp_path, umask, mode):
    figure = Figure()
    figure.subplots().plot(np.arange(3))
    before = os.umask(umask)
    try:
        path = save_figure(figure, tmp_path / "a.PNG")
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == mode and list(tmp_path.iterdir()) == [path]
