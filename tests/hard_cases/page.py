"""Writes docs/hard_cases.md from the docstrings of the tests in this folder.

``python tests/hard_cases/page.py``; a test fails while the page differs from what this makes.
"""

import ast
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parent.parent / "docs" / "hard_cases.md"

# What a user may fear: the tests that answer it.
QUESTIONS = {
    "stiffness ratio 1e-3 and 1e3": ["active_layer_a_thousand_times_softer",
        "active_layer_a_thousand_times_stiffer", "corners_of_the_reduced_space"],
    "slenderness 1e-3 and 1e-1": ["a_sheet_a_thousandth_as_thick_as_long",
        "a_sheet_a_tenth_as_thick_as_long"],
    "h_i/h_s of 0.1 and 10": ["active_layer_a_tenth_as_thick", "active_layer_ten_times_as_thick"],
    "contraction 0.6": ["contraction_of_sixty_percent_bends_as_the_section",
        "contraction_of_sixty_percent_in_two_directions"],
    "ν = 0.499": ["bilayer_of_nearly_incompressible_layers",
        "nearly_incompressible_cylinder_under_pressure"],
    "weight from crushing (Γ = 1e-3) to none": ["a_column_is_crushed_by_its_own_weight",
        "a_crushing_weight_ends_in_words_or_in_an_audited_state",
        "a_lighter_unit_never_lifts_its_edge_less",
        "a_weightless_scene_is_the_limit_of_a_vanishing_weight"],
    "touching and leaving the ground repeatedly": ["a_strip_lifts_off_and_lands_three_times",
        "a_block_pressed_down_and_lifted_gives_all_its_work_back"],
    "a sheet dropped at a slope": ["a_sheet_dropped_at_a_slope_comes_to_lie_flat"],
    "snap-through": ["a_cycle_of_load_snaps_there_and_back_and_loses_what_the_loop_encloses",
        "a_solid_arch_lands_on_the_far_branch_of_its_own_path"],
    "snap-back": ["snap_back_behind_a_spring_ten_thousand_times_softer"],
    "a looping path": ["a_path_that_crosses_itself_is_walked_twice_round",
        "every_point_of_a_looping_path_is_what_it_says"],
    "two branch points close together": ["two_branch_points_a_hundred_thousandth_apart",
        "two_branch_points_that_coincide", "a_square_column_buckles_both_ways_at_once"],
    "a symmetric branch point hit exactly": ["a_symmetric_branch_point_hit_exactly",
        "a_fall_that_starts_exactly_on_the_saddle"],
    "curling that changes its axis": ["curling_that_turns_its_axis_by_a_right_angle"],
    "toppling": ["a_tall_block_falls_where_its_weight_passes_its_edge",
        "a_unit_that_is_let_go_ends_on_its_side_or_in_words",
        "toppling_is_told_whatever_the_model_has_left_of_its_symmetry"],
    "element inversion on the first step": ["a_first_step_that_inverts_elements_is_shortened",
        "a_body_pressed_through_itself_ends_in_words"],
    "slivers": ["slivers_of_hexahedra_carry_uniform_growth_without_stress",
        "slivers_of_tetrahedra_carry_a_homogeneous_strain",
        "a_sliver_in_a_cantilever_changes_nothing"],
    "a load that reverses": ["a_load_that_reverses_retraces_its_path"],
    "growth from a field with a jump": [
        "growth_that_jumps_along_the_axis_it_acts_on_leaves_no_stress",
        "curvature_that_jumps_inside_an_element",
        "growth_that_jumps_in_time_is_followed_to_the_same_end"],
    "restart in the middle of a path": [
        "a_restart_from_a_file_in_a_new_scene_is_the_same_path",
        "a_restart_just_before_a_snap_snaps_alike"],
    "one and two threads": ["one_and_two_threads_fold_alike"],
    "seeds of noise": ["noise_of_a_seed_reproduces_and_its_answer_does_not_depend_on_it",
        "noise_of_one_seed_buckles_a_solid_column_the_same_way_each_time"],
    "absent effects": ["a_weightless_unit_never_hears_of_weight_or_ground",
        "each_absent_effect_of_a_block_stays_silent",
        "a_weightless_unit_is_the_scene_that_never_heard_of_weight"],
    "random designs": ["random_designs_end_in_audited_states_or_in_words"],
}  # fmt: skip


def cases() -> dict[str, list[tuple[str, str]]]:
    """Per theme (first line of a file's docstring) its tests: name without "test_", docstring."""
    found = {}
    for path in sorted(HERE.glob("test_hard_*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        theme = (ast.get_docstring(tree) or "").splitlines()[0]
        found[theme] = [
            (node.name.removeprefix("test_"), " ".join((ast.get_docstring(node) or "").split()))
            for node in tree.body
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
        ]
    return {theme: tests for theme, tests in found.items() if tests}


def page() -> str:
    """The page as text."""
    groups = cases()
    total = sum(map(len, groups.values()))
    lines = [
        "# Hard cases",
        "",
        f"{total} cases at the edges of what the solver must survive, all in `pytest`, each with a",
        "closed form, a reference or a property that can be proven. This page is made from their",
        "docstrings by `python tests/hard_cases/page.py`; a test fails while it differs.",
        "",
        "| you have … | cases |",
        "|---|---|",
    ]
    for question, names in QUESTIONS.items():
        lines.append(f"| {question} | {'; '.join(n.replace('_', ' ') for n in names)} |")
    for theme, tests in groups.items():
        lines += ["", f"## {theme}", "", "| case | what it proves |", "|---|---|"]
        for name, proves in tests:
            lines.append(f"| {name.replace('_', ' ')} | {proves.replace('|', chr(92) + '|')} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
