"""The messages about a session, apart from the scene message. They contain texts and states, but no arrays."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from antdsl import __version__
from antdsl.diagnostics import Report
from antdsl.diagnostics.render import choose_visible_diagnostics
from antdsl.preview.outcomes import EditOutcome
from antdsl.preview.viewing.file_names import is_library_file, read_file_text

if TYPE_CHECKING:
    from antdsl.preview.live import LiveSimulation

JsonMessage = dict[str, Any]


def make_hello(live: LiveSimulation) -> JsonMessage:
    """Return the message `hello`. Its `build` is empty, because the server fills it in."""
    return {"op": "hello", "version": __version__, "build": "", "scene": find_scene_name(live)}


def find_scene_name(live: LiveSimulation) -> str:
    """Return the name under which pages show the scene file."""
    return live.screen.names.get_short_name(live.compiler.scene)


def make_texts_message(live: LiveSimulation) -> JsonMessage:
    """Return the message with the texts of all program and scene files on disk."""
    entries, known_paths = [], set()
    for each in live.compiler.get_watched_files():
        path = Path(os.path.realpath(each))
        if path in known_paths or path.suffix not in (".ant", ".yaml", ".yml"):
            continue
        if (text := read_file_text(each, live.compiler.open_file)) is not None:
            known_paths.add(path)
            kind = "library" if is_library_file(path) else "ant" if path.suffix == ".ant" else "yaml"
            entries.append({"file": live.screen.names.get_short_name(path), "text": text, "kind": kind})
    return {"op": "texts", "texts": entries}


def make_problems_message(live: LiveSimulation) -> JsonMessage:
    """Return the message with the errors and warnings from the last attempt to open the files."""
    return {"op": "problems", "problems": _make_problem_messages(live, live.report)}


def _make_problem_messages(live: LiveSimulation, report: Report) -> list[JsonMessage]:
    """Return one message per finding, up to the limit, and one that gives the number of omitted findings."""
    selected = choose_visible_diagnostics(report)
    entries, omitted_count = (
        [live.screen.names.make_problem_message(each) for each in selected],
        len(report.diagnostics) - len(selected),
    )
    if omitted_count:
        entries.append(
            {**entries[-1], "message": f"… and {omitted_count:,} more", "help": "", "file": None, "start": 0, "end": 0}
        )
    return entries


def make_outcome_message(live: LiveSimulation, operation: str, result: EditOutcome, file: str = "") -> JsonMessage:
    """Return the message with the outcome of a change. `operation`: the op of the request. `file`: the file into which the
    outcome's text should be written."""
    entries = _make_problem_messages(live, result.report)
    details = {"did": result.description, "line": result.line, "text": result.text, "file": file}
    return {"op": "outcome", "of": operation, "ok": result.is_successful, **details, "problems": entries}


def make_stops_message(live: LiveSimulation) -> JsonMessage:
    """Return the message with the frames at which play was stopped, and the reason for each."""
    return {"op": "stops", "stops": [{"frame": frame, "line": why} for frame, why in live.session.timeline.stop_reasons.items()]}


def make_status_message(live: LiveSimulation, rate: float, hash: str | None) -> JsonMessage:
    """Return the message with the state of the session. Its values are empty while the scene has errors."""
    fields: JsonMessage = {
        "op": "status", "frame": 0, "first": 0, "head": 0, "playing": False, "speed": live.speed, "rate": round(rate, 1),
        "edited": False, "fault": None, "paused_by": None, "paused_agents": None, "hash": hash, "agents": 0, "transitions": {},
        "light": False,
    }  # fmt: skip
    if not live.is_open:
        return fields
    session, why = live.session, live.pause_reason
    fields |= {
        "frame": session.frame if live.displayed_frame is None else live.displayed_frame, "first": session.first_frame,
        "head": session.last_frame,
        "playing": session.playing, "edited": session.is_edited, "fault": session.fault_text, "agents": len(session.world),
        "transitions": dict(session.world.transitions), "light": live.displayed_frame is not None,
    }  # fmt: skip
    if why is not None:
        fields["paused_by"] = why.line
        if why.agents:
            fields["paused_agents"] = {"species": why.species, "agents": list(why.agents)}
    return fields
