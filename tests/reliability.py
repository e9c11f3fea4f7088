"""The list of bad inputs (117 rows) and the tests that give the verdict on each.

`python tests/reliability.py` runs them and prints a line for each row; `python tests/reliability.py M6 W2` runs these rows only.
It exits with 0 if every row passed. Other arguments go to pytest: `-m ''` includes slow tests.
Rows of `tests/cases/hostile` are found by their names, which begin with the row's id."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
VERDICTS = "cli/test_hostile.py::test_hostile_files_give_the_expected_result"


@dataclass(frozen=True)
class Row:
    """What goes in, what is expected, and the tests that show it: `FILE::FUNCTION` below `tests`; `[ID]` names one parameter."""

    bad_input: str
    expected: str
    tests: tuple[str, ...] = ()


ROWS = {
    # programs
    "A1": Row("an empty program", "an error"),
    "A2": Row("a program that is not UTF-8", "an error with the byte's number"),
    "A3": Row("control characters, hidden text direction", "an error, in comments too"),
    "A4": Row("letters and digits of other scripts", "an error with the letter to type"),
    "A5": Row("line ends, tabs, very long lines", "accepted, or an error for the line"),
    "A6": Row("a large program, a pipe, a folder, a device", "an error before it is read", ("syntax/test_syntax_reading.py",)),
    "A7": Row("deep nesting", "an error at level 65"),
    "A8": Row(
        "very long expressions",
        "accepted, or an error from a limit",
        ("plan/test_plan_rules.py::test_chains_of_lets_do_not_go_deep_or_grow",),
    ),
    "A9": Row("thousands of mistakes", "50 are shown", ("diagnostics/test_diagnostics.py",)),
    "A10": Row("text, a bracket or a block without an end", "an error at its beginning"),
    "A11": Row("numbers that cannot be represented", "an error"),
    "A12": Row("NaN and infinity", "an error"),
    "A13": Row("a wrong, unknown or missing unit", "an error with the text to write"),
    "A14": Row("a constant beyond float32", "an error"),
    "A15": Row("names of Python and JavaScript", "an error, or an ordinary name"),
    "A16": Row("code of other languages", "a syntax error"),
    "A17": Row("format strings in names", "printed as they are"),
    "A18": Row(
        "escapes for terminals and build servers",
        "an error, or escaped",
        ("diagnostics/test_diagnostics.py::test_github_escapes_what_ends_a_command",),
    ),
    "A19": Row(
        "files that use each other in a circle, other kinds of files",
        "an error with the circle",
        ("scene/test_scene_files.py::test_files_that_use_each_other_in_a_circle_are_reported",),
    ),
    "A20": Row(
        "paths out of the project",
        "an error before the disk is touched",
        ("scene/test_scene_files.py::test_paths_are_refused_before_the_disk_is_touched",),
    ),
    "A21": Row(
        "links out of the project",
        "an error",
        ("scene/test_scene_files.py::test_links_pipes_folders_and_neighbours_are_refused",),
    ),
    "A22": Row("names that differ by case", "an error on every system"),
    "A23": Row("behaviours that double", "an error from the cost"),
    "A24": Row("definitions in a circle", "an error with the circle"),
    "A25": Row("changes of state that always fire", "a warning"),
    "A26": Row("states and changes without effect", "a warning", ("program/test_program_cases.py",)),
    "A27": Row("two machines that write one attribute", "an error"),
    "A28": Row("fields and solids that are not there", "an error or a warning"),
    "A29": Row("division by 0, empty ranges", "an error if constant, otherwise a value or a fault"),
    "A30": Row("a chance that is no rate", "an error"),
    "A31": Row("durations that cannot be", "an error or a warning"),
    "A32": Row("a radius that finds everybody", "an error or a warning from the cost"),
    "A33": Row(
        "too many states, layers, attributes",
        "an error from a limit",
        ("program/test_program.py::test_caps_on_what_a_species_declares",),
    ),
    "A34": Row("merge conflicts, typographic signs, Markdown", "an error with a hint"),
    "A35": Row("another edition", "an error or a warning"),
    "A36": Row("another kind of file by the name of a program", "an error that names the kind"),
    # scenes
    "Y1": Row("aliases and merges", "an error"),
    "Y2": Row("tags and directives", "an error"),
    "Y3": Row("deep nesting", "an error at level 33"),
    "Y4": Row("keys that are equal, empty or no words", "an error", ("scene/test_scene.py",)),
    "Y5": Row("values that YAML reads as something else", "text until a setting gives it a type"),
    "Y6": Row("seeds out of range", "an error; none is 0"),
    "Y7": Row("no mapping, two documents", "an error"),
    "Y8": Row("unknown and misplaced keys", "an error with a suggestion"),
    "Y9": Row("numbers of agents and frames out of range", "an error; no agents are accepted"),
    "Y10": Row(
        "impossible bounds and voxels",
        "an error with the number of voxels",
        (
            f"{VERDICTS}[volumes: V5 voxels of 0]",
            f"{VERDICTS}[volumes: V5 voxels of 1e-9 mm]",
            "ground/test_solids_volume.py::test_a_voxel_that_cannot_be_is_refused_before_memory_is_taken",
            "scene/test_scene_files.py::test_a_request_for_a_billion_cells_allocates_nothing",
        ),
    ),
    "Y11": Row(
        "paths of meshes and outputs",
        "an error",
        ("scene/test_scene_files.py::test_strangers_scenes_run_nothing_and_open_nothing_outside",),
    ),
    "Y12": Row("variables and wildcards in paths", "an error; nothing is expanded"),
    "Y13": Row("very large scenes", "an error from a limit"),
    "Y14": Row("tabs, byte order marks, other encodings", "an error with the line"),
    "Y15": Row("other values for params", "an error; only literals are read", ("scene/test_scene_set_fields.py",)),
    "Y16": Row("limits, threads, code", "an error: not a setting of a scene"),
    "Y17": Row("numbers at the limits", "read exactly, or an error"),
    "Y18": Row("transforms that cannot be", "an error or a warning"),
    # meshes
    "M1": Row("empty meshes, points only", "an error; one triangle is accepted"),
    "M2": Row("STL with a wrong size or header", "an error"),
    "M3": Row("PLY with wrong counts", "an error before memory is allocated"),
    "M4": Row("indices that are not there", "an error with the line"),
    "M5": Row("coordinates that are not finite, faces without area", "an error; faces without area are left out and counted"),
    "M6": Row(
        "open, inverted and nested solids",
        "an error or a warning",
        (
            f"{VERDICTS}[volumes: V5 a solid that is open]",
            f"{VERDICTS}[volumes: V5 a solid turned inside out]",
            "scene/test_scene_closed.py",
        ),
    ),
    "M7": Row("files that name other files", "not opened outside the project"),
    "M8": Row("archives", "limits; nothing is extracted by name"),
    "M9": Row("very large and compressed meshes", "an error before it is read"),
    "M10": Row(
        "units and places that do not fit",
        "a warning",
        ("scene/test_scene_files.py::test_what_is_odd_about_a_mesh_is_a_warning",),
    ),
    "M11": Row("another kind of file by the name of a mesh", "an error that names the kind"),
    "M12": Row("a file that brings down a library", "an error; the process goes on", ("scene/test_usd.py",)),
    "M13": Row(
        "a mesh that is replaced during a run",
        "read once it is complete",
        (
            "preview/test_watch.py::test_a_file_that_is_still_being_written_is_waited_for",
            "preview/test_preview_files.py::test_a_mesh_that_is_gone_is_taken_away",
        ),
    ),
    # volumes and fields
    "V1": Row("NPY headers that lie", "an error before memory is allocated"),
    "V2": Row("NPZ archives that lie", "an error"),
    "V3": Row("OpenVDB files", "an error: not read"),
    "V4": Row(
        "images with wrong sizes",
        "an error before they are decoded",
        (
            "scene/test_heights.py::test_a_large_image_is_refused_by_its_header",
            "scene/test_heights.py::test_what_is_no_height_is_reported_at_its_place",
        ),
    ),
    "V5": Row("values and solids that cannot be", "an error or a repair that is reported"),
    "V6": Row("flows without a direction", "no direction; an error for NaN"),
    "V7": Row("grids and agents beside the ground", "an error or a warning"),
    "V8": Row(
        "diffusion that is not stable",
        "an error with the largest value",
        ("fields/test_fields.py::test_the_stability_limit_depends_only_on_the_cell_size", "program/test_program_cases.py"),
    ),
    "V9": Row(
        "digging without limits",
        "limits for each frame",
        ("ground/test_solids_volume.py::test_balls_without_sense_and_far_away_dig_nothing_and_great_ones_everything",),
    ),
    "V10": Row("pheromone beyond its range", "saturates", ("fields/test_fields.py",)),
    # caches and outputs
    "C1": Row(
        "damaged caches",
        "an error; never partial data",
        (
            "outputs/test_cache.py::test_damage_in_a_cache_is_reported_and_repaired",
            "outputs/test_cache.py::test_every_flipped_byte_of_the_values_is_seen",
        ),
    ),
    "C2": Row(
        "a cache of somebody else",
        "read as data only",
        (
            "outputs/test_cache.py::test_strange_files_are_refused",
            "outputs/test_cache.py::test_strange_headers_are_refused",
            "outputs/test_cache.py::test_a_forged_checkpoint_is_refused_and_reads_no_other_memory",
        ),
    ),
    "C3": Row(
        "two runs, full disks, read-only folders",
        "an error with the command that goes on",
        (
            "outputs/test_cache.py::test_two_runs_do_not_write_to_one_folder",
            "outputs/test_cache.py::test_a_full_disk_ends_in_words_and_the_run_goes_on_later",
        ),
    ),
    "C4": Row(
        "a cache of other inputs",
        "an error that names them",
        ("outputs/test_cache.py::test_other_inputs_are_named_and_not_continued",),
    ),
    "C5": Row(
        "a file under another name",
        "an error",
        (
            "outputs/test_cache.py::test_only_the_written_form_of_a_name_is_a_frame",
            "machine_code/test_object_cache.py::test_the_code_of_another_program_is_not_loaded",
        ),
    ),
    "C6": Row(
        "outputs that overwrite other files",
        "an error without `--force`",
        (
            "outputs/test_cache.py::test_a_foreign_folder_is_left_alone",
            "outputs/test_cache.py::test_a_folder_in_the_place_of_a_file_is_reported_before_anything_is_removed",
        ),
    ),
    "C7": Row(
        "the end of the process at any moment",
        "the next start is consistent",
        (
            "outputs/test_cache.py::test_a_run_killed_at_any_instant_ends_with_the_same_hashes",
            "outputs/test_cache.py::test_ctrl_c_leaves_a_cache_that_goes_on",
        ),
    ),
    # numbers and simulation
    "N1": Row("operations without a value", "defined values; state is finite"),
    "N2": Row("NaN in conditions and sets", "false; a defined rule"),
    "N3": Row("places that are not finite", "outside"),
    "N4": Row(
        "worlds far from the origin",
        "precise, or a warning",
        ("runtime/test_runtime_ground.py::test_far_from_the_origin_nothing_is_coarse",),
    ),
    "N5": Row("numbers beyond their range", "saturate"),
    "N6": Row(
        "all agents in one place",
        "a limited number of neighbours",
        ("runtime/test_backends.py::test_a_crowd_on_one_spot_has_a_capped_number_of_neighbours",),
    ),
    "N7": Row("time steps that cannot be", "an error or a warning"),
    "N8": Row("a branch that is not taken", "not evaluated"),
    "N9": Row("numbers that are too small", "become 0"),
    "N10": Row(
        "no agents, very many births",
        "normal; births have a limit",
        ("runtime/test_meaning_world.py::test_a_spawn_in_each_step_stops_at_the_cap",),
    ),
    "N11": Row(
        "two agents that claim one item",
        "one winner",
        ("runtime/test_meaning_states.py::test_crumbs_are_conserved_and_each_has_one_winner",),
    ),
    "N12": Row("other processors and threads", "the same bits", ("house/test_same_bits.py", "house/test_processors.py")),
    "N13": Row(
        "other versions of NumPy and Python",
        "differences are reported",
        ("specs/test_saved_failures.py::test_a_golden_run_of_states_hashed_differently_is_reported_and_rewritten",),
    ),
    # processes and tools
    "R1": Row(
        "more than memory holds",
        "an error before memory is allocated",
        (
            "runtime/test_moving_world.py::test_more_frames_than_memory_are_refused_before_they_are_read",
            "scene/test_scene_files.py::test_too_many_agents_are_refused",
        ),
    ),
    "R2": Row(
        "very many changes of files",
        "one rebuild",
        ("cli/test_hostile_runs.py::test_r2_a_storm_of_changes_is_reported_once", "preview/test_watch.py"),
    ),
    "R3": Row(
        "a file that is saved with mistakes",
        "the last good program runs",
        ("preview/test_preview_survives.py::test_whatever_is_saved_the_last_good_program_runs_on",),
    ),
    "R4": Row(
        "folders of what is no file",
        "an error each; the others are checked",
        ("cli/test_hostile_runs.py::test_r4_a_folder_of_what_is_no_file_is_checked",),
    ),
    "R5": Row(
        "closed outputs, narrow terminals",
        "no traceback",
        (
            "cli/test_hostile_runs.py::test_r5_a_reader_that_stops_ends_a_command_without_a_traceback",
            "cli/test_hostile_runs.py::test_r5_words_fit_a_terminal_that_knows_ascii_alone_and_is_narrow",
        ),
    ),
    "R6": Row(
        "other languages, clocks, hash seeds",
        "the same bytes",
        ("cli/test_hostile_runs.py::test_r6_language_clock_and_hash_seed_change_no_bit",),
    ),
    "R7": Row(
        "a warning in every frame",
        "once, with a count",
        ("cli/test_hostile_runs.py::test_r7_a_value_that_is_wrong_everywhere_is_reported_once",),
    ),
    "R8": Row("scenes and programs that ask for code", "an error: no code is loaded"),
    # the preview's server
    "W1": Row(
        "pages of other sites",
        "rejected",
        (
            "preview/test_preview_server.py::test_pages_of_others_are_refused_though_they_have_the_token",
            "preview/test_preview_server.py::test_only_this_machine_is_heard",
        ),
    ),
    "W2": Row(
        "other names of the host", "rejected", ("preview/test_preview_server.py::test_other_names_of_the_host_are_refused",)
    ),
    "W3": Row(
        "requests without an origin",
        "rejected without the token",
        (
            "preview/test_preview_server.py::test_pages_of_others_are_refused_though_they_have_the_token",
            "preview/test_preview_server.py::test_a_wrong_token_is_reported_and_nothing_else",
        ),
    ),
    "W4": Row("paths out of the page", "404", ("preview/test_preview_server.py::test_there_are_no_other_paths",)),
    "W5": Row(
        "frames and connections without limits",
        "limits",
        (
            "preview/test_preview_server.py::test_frames_out_of_order_end_their_own_connection_only",
            "preview/test_preview_server.py::test_ten_thousand_silent_connections_keep_no_page_out",
            "preview/test_preview_server.py::test_a_request_that_takes_for_ever_is_cut_off",
            "preview/test_preview_server.py::test_compression_is_refused",
            "preview/test_preview_server.py::test_sixteen_pages_look_on_and_the_next_has_to_wait",
        ),
    ),
    "W6": Row(
        "messages that are not understood",
        "an error; the connection stays",
        ("preview/test_preview_server.py::test_messages_that_mean_nothing_are_refused_in_words_and_the_page_stays",),
    ),
    "W7": Row(
        "markup in names",
        "shown as text",
        (
            "preview/test_preview_server.py::test_markup_in_a_name_is_a_name",
            "preview/test_preview_server.py::test_the_page_is_served_with_a_policy_and_is_not_cached",
        ),
    ),
    "W8": Row(
        "requests to write files",
        "not offered",
        (
            "preview/test_preview_server.py::test_a_page_can_only_be_got",
            "preview/test_preview_server.py::test_messages_that_mean_nothing_are_refused_in_words_and_the_page_stays",
        ),
    ),
    "W9": Row(
        "slow pages",
        "the latest frame only",
        ("preview/test_preview_server.py::test_a_slow_page_gets_the_latest_packet_of_each_slot_and_every_message",),
    ),
    "W10": Row(
        "ports in use, other addresses",
        "the next port; others only with a flag",
        (
            "preview/test_preview_mailbox.py::test_a_port_that_is_taken_leads_to_the_next",
            "preview/test_preview_command.py::test_others_are_let_in_only_where_it_is_said_and_only_with_the_token",
        ),
    ),
    "W11": Row(
        "an old page",
        "not cached; it loads itself again",
        (
            "preview/test_preview_server.py::test_the_page_is_served_with_a_policy_and_is_not_cached",
            "preview/test_preview_coming_back.py::test_a_page_of_another_build_loads_itself_again_and_only_once",
        ),
    ),
    "W12": Row(
        "a server that is gone and comes back",
        "the page connects again",
        ("preview/test_preview_coming_back.py::test_a_page_comes_back_to_a_server_that_is_started_again_on_its_port",),
    ),
}


class Outcomes:
    """A plugin that keeps only the tests of some rows and notes how each ended."""

    def __init__(self, rows: list[str]) -> None:
        self.tests = {id: (*ROWS[id].tests, VERDICTS) for id in rows}
        self.ends: dict[str, dict[str, str]] = defaultdict(dict)
        self._rows: dict[str, list[str]] = {}

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        left = [item for item in items if self._rows_of(item)]
        config.hook.pytest_deselected(items=[item for item in items if item not in left])
        items[:] = left

    def _rows_of(self, item: pytest.Item) -> list[str]:
        node = item.nodeid.removeprefix("tests/")
        function = node.partition("[")[0]
        file = node.partition("::")[0]
        matching_rows = []
        for row, tests in self.tests.items():
            named = function == VERDICTS and f": {row} " in node
            if named or any(test != VERDICTS and test in (node, function, file) for test in tests):
                matching_rows.append(row)
        self._rows[item.nodeid] = matching_rows
        return matching_rows

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or not report.passed:
            for row in self._rows.get(report.nodeid, []):
                self.ends[row].setdefault(report.nodeid, report.outcome)
                if report.failed:
                    self.ends[row][report.nodeid] = "failed"


def verdicts(rows: list[str], arguments: list[str]) -> int:
    """Run the tests of some rows and print what came of each. Gives 0 if all passed, otherwise 1."""
    os.chdir(TESTS.parent)
    began = time.monotonic()
    outcomes = Outcomes(rows)
    files = sorted({f"tests/{test.partition('::')[0]}" for tests in outcomes.tests.values() for test in tests})
    with tempfile.TemporaryDirectory() as folder:
        pytest.main(["-q", "--no-header", "-p", "no:cacheprovider", f"--basetemp={folder}/tests", *arguments, *files], [outcomes])
    bad = 0
    for row in rows:
        ends = outcomes.ends[row]
        count = {end: sum(each == end for each in ends.values()) for end in ("passed", "failed", "skipped")}
        word = "failed" if count["failed"] else "passed" if count["passed"] else "no test"
        bad += word != "passed"
        skipped = f", {count['skipped']} skipped" if count["skipped"] else ""
        print(f"{row:4} {word:7} {count['passed']:4} tests{skipped}  {ROWS[row].bad_input}: {ROWS[row].expected}")
        for test, end in ends.items():
            if end == "failed":
                print(f"       {test}")
    print(f"{len(rows) - bad} passed, {bad} failed of {len(rows)} rows in {time.monotonic() - began:.0f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    chosen = [word for word in sys.argv[1:] if word in ROWS]
    sys.exit(verdicts(chosen or list(ROWS), [word for word in sys.argv[1:] if word not in ROWS]))
