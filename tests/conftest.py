"""Shared fixtures: the JIT variant under test, and the optional assets kept beside the checkout."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import pytest

# Before any test module imports torch, whose idle threads would spin and take Dr.Jit's cores; see `tnst_mi.__init__`.
import tnst_mi

if TYPE_CHECKING:
    from tnst_mi.network.googlenet import GoogLeNet

# Examples are the same in every run: a change fails the tests, or does not. `--hypothesis-profile=search` looks for new
# ones. How long one takes decides nothing: kernels may be compiled for it.
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None)
hypothesis.settings.register_profile("search", deadline=None)
hypothesis.settings.load_profile("repeatable")

#: Tests that take long to show in more ways what others show too, by the beginnings of their names: of a run of some
#: minutes they are a third. `pytest --slow` runs them as well.
SLOW = (
    "cluster/test_batch_systems.py",
    "cluster/test_cluster.py::test_after_one_was_refused_tasks_of_one_that_has_left_go_to_others",
    "cluster/test_cluster.py::test_a_frame_that_kills_its_workers_is_named",
    "cluster/test_cluster.py::test_the_bits_are_those_of_one_process[gradients]",
    "cluster/test_cluster.py::test_without_a_shared_folder_items_travel[keys2]",
    "cluster/test_cluster.py::test_workers_that_die_in_turn_blame_no_frame",
    "cluster/test_ways_in.py::test_python_and_batch_have_the_same_bits",
    "commands/test_show.py::test_blender_shows_the_same_panels",
    "compare/test_compare.py::test_a_broken_integrator_is_found[samples",
    "compare/test_compare.py::test_a_fault_of_the_quadrature_that_drives_a_stylization_is_found[steps",
    "compare/test_sides.py::test_two_path_tracers_agree_on_smoke_that_scatters",
    "integrations/blender/test_addon_environment.py::test_a_real_installation",
    "integrations/blender/test_addon_in_blender.py::test_a_volume_is_stylized_in_its_place",
    "integrations/blender/test_addon_in_blender.py::test_cancel_leaves_no_process_and_can_be_resumed",
    "integrations/blender/test_addon_in_blender.py::test_each_marker_is_a_shot",
    "integrations/blender/test_addon_in_blender.py::test_the_panel_is_drawn_and_what_is_bad_is_refused[bpy]",
    "integrations/blender/test_addon_in_blender.py::test_the_smoke_of_a_domain_is_seen_where_it_was",
    "integrations/blender/test_addon_runs.py",
    "integrations/blender/test_addon_window.py",
    "integrations/houdini/test_node.py::test_the_real_tnst_mi_gives_the_node_its_grids_back",
    "optimisation/test_host.py::test_a_run_whose_disk_was_full_goes_on_to_the_same_bits[3]",
    "optimisation/test_kill.py::test_killed_runs_end_with_the_same_bits[3-",
    "optimisation/test_mending.py::test_whatever_item_is_damaged_the_bits_are_the_same[3-11-",
    "optimisation/test_mending.py::test_whatever_item_is_damaged_the_bits_are_the_same[3-5-",
    "optimisation/test_regions.py::test_a_run_is_reproduced_and_resumed[3]",
    "optimisation/test_single_frame.py::test_semantic_transfer_with_compression",
    "optimisation/test_single_frame.py::test_style_distance_falls",
    "optimisation/test_style_losses.py::test_runs_come_nearer_to_the_picture_and_are_repeated[gram]",
    "optimisation/test_style_losses.py::test_runs_come_nearer_to_the_picture_and_are_repeated[histogram]",
    "optimisation/test_style_losses.py::test_runs_come_nearer_to_the_picture_and_are_repeated[nnfm]",
    "optimisation/test_style_losses.py::test_runs_come_nearer_to_the_picture_and_are_repeated[paper]",
    "optimisation/test_style_losses.py::test_runs_come_nearer_to_the_picture_and_are_repeated[swd]",
    "rendering/test_behind.py::test_an_object_inside_the_smoke_is_lit_through_it",
    "rendering/test_blender.py::test_blender_and_mitsuba_show_the_same",
    "rendering/test_blender.py::test_colours_are_those_of_mitsuba",
    "rendering/test_fit.py::test_a_run_says_what_is_cut_off_and_fits_if_asked[prbvolpath]",
    "rendering/test_fog.py::test_all_in_fog_that_the_sensor_names_is_what_volpath_shows[a lit wall]",
    "rendering/test_scattering.py::test_it_drives_a_stylization",
    "rendering/test_studio_cameras.py::test_fire_is_seen_through_the_camera_of_the_shot[orthographic]",
    "run/test_carry.py::test_a_copy_of_the_density_comes_back_as_the_result_bit_for_bit[3-",
    "run/test_going_on.py::test_a_kept_octave_is_gone_on_from_to_the_same_bits[3-",
    "run/test_going_on.py::test_draft_preview_and_final_are_one_run_in_three_parts[2-others3]",
    "run/test_going_on.py::test_draft_preview_and_final_are_one_run_in_three_parts[3-",
    "run/test_houdini_files.py::test_a_run_gives_back_what_houdini_wrote_moved[centres",
    "run/test_memory.py::test_a_run_takes_about_what_was_said",
    "run/test_memory.py::test_that_holds_where_octaves_are_coarser_than_the_frames[150]",
    "run/test_memory.py::test_that_holds_where_octaves_are_coarser_than_the_frames[480]",
    "run/test_proportions.py::test_random_proportions",
    "run/test_repeatability.py::test_ten_runs_of_a_small_grid_give_the_same_bits[shape0]",
    "run/test_shot_runs.py::test_compare_takes_the_view_of_a_stylization",
    "run/test_units.py::test_a_power_of_two_in_the_density_gives_the_same_bits[transport-3]",
    "scripts/test_measure_gpu.py::test_the_cpu_agrees_with_itself_and_a_part_that_fails_is_told",
    "scripts/test_open_in_blender.py::test_a_picture_shows_them",
    "scripts/test_quality_script.py::test_a_comparison_is_made_once_and_again_with_the_same_bits",
    "scripts/test_quality_script.py::test_of_several_styles_the_judge_finds_the_one_that_smoke_shows[cells]",
    "scripts/test_quality_script.py::test_of_several_styles_the_judge_finds_the_one_that_smoke_shows[flames]",
    "scripts/test_quality_script.py::test_of_several_styles_the_judge_finds_the_one_that_smoke_shows[net]",
    "scripts/test_train_patterns.py::test_an_interrupted_training_ends_as_an_uninterrupted_one",
    "studio/test_browser.py::test_smoke_takes_on_colours_on_the_page",
    "studio/test_browser.py::test_motifs_are_found_by_a_picture_and_shown",
    "studio/test_browser.py::test_regions_are_shaped_and_painted_in_the_view",
    "studio/test_page_keeps_up.py::test_a_frame_is_tried_again_and_again",
    "studio/test_browser.py::test_tries_are_gone_on_from_and_deleted",
    "studio/test_browser.py::test_a_render_outlives_the_page_and_the_studio",
    "studio/test_examples.py::test_pictures_are_made_once_and_are_those_of_an_atlas",
    "studio/test_tries.py::test_a_try_goes_on_from_a_kept_state_to_the_bits_of_the_command",
    "studio/test_tries.py::test_a_running_try_is_stopped_and_deleted_with_all_that_it_has",
    "studio/test_tries.py::test_a_render_on_a_cluster_outlives_the_studio_and_is_resumed",
    "studio/test_tries.py::test_a_try_that_runs_and_one_that_was_killed_are_gone_on_from",
    "studio/test_work.py::test_a_killed_run_is_found_again_by_another_studio",
    "studio/test_work.py::test_a_try_is_a_draft_whose_losses_are_seen_as_they_come",
    "studio/test_work.py::test_the_end_of_the_studio_pauses_tries_and_leaves_renders",
    "studio/test_work.py::test_what_cannot_be_done_is_told_in_one_line",
)

#: Fixtures that have a module of their own.
pytest_plugins = ["rendered_cloud"]

ASSETS = Path(__file__).resolve().parents[2] / "shared"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the flag --slow."""
    parser.addoption("--slow", action="store_true", help="run the tests that take long too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests that take long out, unless they are asked for: by --slow, or by their names."""
    if config.getoption("--slow") or any("::" in argument for argument in config.args):
        return
    slow = [item for item in items if item.nodeid.removeprefix("tests/").startswith(SLOW)]
    config.hook.pytest_deselected(items=slow)
    items[:] = [item for item in items if item not in slow]


@pytest.fixture(scope="session", autouse=True)
def variant() -> str:
    """Every test runs on llvm_ad_rgb unless TNST_MI_TEST_VARIANT names another variant."""
    return tnst_mi.activate(os.environ.get("TNST_MI_TEST_VARIANT", "llvm_ad_rgb"))


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a narrow GoogLeNet with random weights."""
    from networks import random_googlenet

    return random_googlenet(tmp_path_factory.mktemp("weights") / "random.safetensors", narrow=8)


@pytest.fixture(scope="session")
def network(weights: Path) -> GoogLeNet:
    """That network."""
    from tnst_mi.network.googlenet import GoogLeNet

    return GoogLeNet.load(weights)


def _asset(relative: str) -> Path:
    path = ASSETS / relative
    if not path.exists():
        pytest.skip(f"{relative} is not beside the checkout (looked for {path})")
    return path


@pytest.fixture(scope="session")
def bvlc_weights() -> Path:
    """The real BVLC GoogLeNet weights, or a skip where they are not at hand."""
    return _asset("weights/googlenet_bvlc.safetensors")


@pytest.fixture(scope="session")
def asset() -> object:
    """A function from a relative path to a real asset; skips where it is not at hand."""
    return _asset
