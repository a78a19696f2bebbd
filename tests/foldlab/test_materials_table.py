"""Materials by name."""

import numpy as np
import pytest

from foldlab.errors import InputError
from foldlab.materials import find_material, read_materials

HEAD = "name,role,E_low,E_high,rho_low,rho_high,contraction_low,contraction_high\n"


@pytest.mark.parametrize(
    "name, role, known",
    [
        ("PET", "passive", "polyester film"),
        ("pdms", "passive", "silicone rubber"),
        ("SMP", "active", "shape-memory polymer"),
        ("Shape memory  polymer", "active", "shape-memory polymer"),
        ("LCE", None, "liquid crystal elastomer"),
        ("paper", "passive", "paper"),
    ],
)
def test_materials_go_by_many_names(name, role, known):
    assert find_material(read_materials(), name, role) == known


def test_a_material_of_the_other_role_or_none_is_refused_with_those_there_are():
    table = read_materials()
    with pytest.raises(InputError, match=r"no active material 'PET'.*liquid crystal elastomer"):
        find_material(table, "PET", "active")
    with pytest.raises(InputError, match="no material ''"):
        find_material(table, "")


def test_shipped_materials_bear_something_and_say_what_they_rest_on():
    table = read_materials()
    assert (table["basis"] != "").all()
    low, high = table["strain_low"], table["strain_high"]
    assert ((low > 0) & (low < high)).all()
    assert np.isnan(table.loc["paper", "contraction_low"])


def test_a_table_of_ones_own_joins_and_replaces(tmp_path):
    own = tmp_path / "own.csv"
    own.write_text(HEAD + "slate,passive,1e10,1e10,2700,2700,,\npaper,passive,2e9,2e9,800,800,,\n")
    table = read_materials(own)
    assert find_material(table, "Slate", "passive") == "slate"
    assert table.loc["paper", "E_low"] == 2e9 and table.index.is_unique
    assert np.isnan(table.loc["slate", "strain_low"])
    assert find_material(table, "PET") == "polyester film"


def test_a_name_of_ones_own_wins_over_other_names_of_shipped_materials(tmp_path):
    own = tmp_path / "own.csv"
    own.write_text(HEAD + "Gel,active,1e6,1e6,1000,1000,0.1,0.1\n")
    table = read_materials(own)
    assert find_material(table, "gel") == "Gel"
    assert find_material(table, "PNIPAM") == "thermoresponsive hydrogel"
    with pytest.raises(InputError, match="no material ''"):
        find_material(table, "")


@pytest.mark.parametrize(
    "row, words",
    [
        ("slate,stone,1e10,1e10,2700,2700,,", "role 'stone'"),
        ("slate,passive,1e10,x,2700,2700,,", "slate has no interval above 0 for E"),
        ("gel,active,1e3,1e4,1000,1000,0.3,0.1", "for contraction"),
    ],
)
def test_broken_rows_are_named(tmp_path, row, words):
    own = tmp_path / "own.csv"
    own.write_text(HEAD + row + "\n")
    with pytest.raises(InputError, match=words):
        read_materials(own)


def test_a_strain_that_is_half_given_is_refused(tmp_path):
    own = tmp_path / "own.csv"
    own.write_text(HEAD.strip() + ",strain_low,strain_high\nslate,passive,1,2,3,4,,,0.1,\n")
    with pytest.raises(InputError, match="for strain"):
        read_materials(own)


def test_a_table_with_semicolons_says_which_columns_were_seen(tmp_path):
    own = tmp_path / "own.csv"
    own.write_text(HEAD.replace(",", ";") + "slate;passive;1;2;3;4;;\n")
    with pytest.raises(InputError, match=r"it has the columns name;role.*expected commas"):
        read_materials(own)
