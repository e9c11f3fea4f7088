"""Messages for a page, as a server tells them: a small program with one species, its text and how the run stands."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.preview.binary_packets import pack_arrays
from antdsl.preview.viewing.directing_messages import make_form_entries

TEXT = """ant 1
# 🐜 a comment with a letter of two units
species ant {
  param pace = 10 mm/s in 0 mm/s .. 40 mm/s "How fast"
  start walk
  state walk amber { when pase > 3 -> rest }
  state rest teal  { when after 2 s -> walk }
}
"""
WALK, REST = [0.9, 0.7, 0.1], [0.1, 0.5, 0.5]


def scene(**other: Any) -> dict[str, Any]:
    param = {
        "name": "ant.pace", "value": "10 mm/s", "number": 10, "unit": "mm/s", "low": 0, "high": 40, "help": "How fast",
        "file": "ant.ant", "line": 4, "written": "10 mm/s",
    }  # fmt: skip
    free = {
        **param,
        "name": "ant.size",
        "value": "3 mm",
        "number": 3,
        "unit": "mm",
        "low": None,
        "high": None,
        "help": "",
        "written": "3 mm",
    }
    species = {
        "name": "ant", "bodies": ["ant"], "attributes": [{"name": "load", "unit": "mg"}], "feelers": [],
        "machines": [{"name": "main", "states": ["walk", "rest"], "colours": [WALK, REST]}],
        "layers": [{"text": "wander()", "file": "ant.ant", "line": 6, "on": True}],
    }  # fmt: skip
    box = {"kind": "state", "details": "", "width": 120.0, "height": 40.0}
    chart = {
        "species": "ant", "machine": "main", "title": "ant", "width": 300.0, "height": 200.0,
        "boxes": [
            {**box, "key": "s0", "name": "walk", "label": "walk", "colour": WALK, "centre": [80.0, 40.0]},
            {**box, "key": "s1", "name": "rest", "label": "rest", "colour": REST, "centre": [220.0, 160.0]},
        ],
        "arrows": [{
            "source": "s0", "target": "s1", "lines": ["pace > 3"], "interrupt": False, "details": "",
            "points": [[80.0, 60.0], [80.0, 160.0], [160.0, 160.0]],
            "words": {"centre": [80.0, 110.0], "width": 60.0, "height": 14.0},
        }],
    }  # fmt: skip
    return {
        "op": "scene", "name": "walk.yaml", "fps": 24, "unit_mm": 1, "up": [0, 1, 0], "low": [0, 0, 0], "high": [100, 10, 100],
        "last": 240,
        "species": [species], "params": [param, free], "flows": [], "curves": [], "solids": [], "items": [],
        "fields": [{"name": "trail", "unit": "", "colour": [1, 0.5, 0], "on": True, "full": 1}],
        "specs": ["all is well"], "charts": [chart], "charts_need": "", "camera": None, **other,
    }  # fmt: skip


def status(frame: int = 20, **other: Any) -> dict[str, Any]:
    return {
        "op": "status", "frame": frame, "first": 1, "head": 100, "playing": False, "speed": 1, "rate": 24.0, "edited": False,
        "fault": None, "paused_by": None, "paused_agents": None, "hash": f"{frame:032x}", "agents": 3, "light": False,
        "transitions": {}, **other,
    }  # fmt: skip


def texts(text: str = TEXT) -> dict[str, Any]:
    written = {"file": "walk.yaml", "text": "antdsl: 1\n", "kind": "yaml"}
    return {"op": "texts", "texts": [written, {"file": "ant.ant", "text": text, "kind": "ant"}]}


def problems(text: str = TEXT, word: str = "pase") -> dict[str, Any]:
    """One error, at a word of the text; offsets in units of UTF-16, as pages count."""
    prefix = text[: text.index(word)]
    start = len(prefix.encode("utf-16-le")) // 2
    return {"op": "problems", "problems": [{
        "code": "unknown-name", "severity": "error", "message": f"no `{word}` is known here", "help": "did you mean `pace`?",
        "file": "ant.ant", "start": start, "end": start + len(word), "line": prefix.count("\n") + 1, "column": 1,
    }]}  # fmt: skip


def frame(states: list[int], number: int = 20) -> bytes:
    count = len(states)
    rows = np.zeros((count, 3), np.float32)
    turn = np.zeros((count, 3), np.int8)
    arrays = {
        "ant/id": np.arange(10, 10 + count, dtype=np.int32), "ant/position": rows, "ant/heading": turn, "ant/up": turn,
        "ant/size": np.ones(count, np.float32), "ant/speed": np.zeros(count, np.float32), "ant/born": np.zeros(count, np.int32),
        "ant/state/main": np.array(states, np.uint8),
    }  # fmt: skip
    return pack_arrays("frame", arrays, frame=number, light=False)


def curves(frames: list[int], walk: list[float], **other: Any) -> dict[str, Any]:
    values = {"ant": [3.0] * len(walk), "ant.main.walk": walk, "spec: all is well": [1.0] * len(walk)}
    return {"op": "curves", "reset": False, "frames": frames, "values": values, "branches": None, **other}


def verbs(line: str = "guards", item: str = "leaf") -> dict[str, Any]:
    """The verbs of notes and edits, for a crowd of the agents 10 to 14 in a line."""
    names = {"part": ["head"], "target": [item, line], "clip": ["walk"], "state": ["rest"], "cache": ["other_cache"]}
    lines = [{"name": line, "species": "ant", "ranges": [[0, 5]]}]
    return {"op": "verbs", **make_form_entries(names), "lines": lines, "origin": [0, 0, 0]}


def notes(*lines: str, problem: str = "", op: str = "notes", **other: Any) -> dict[str, Any]:
    """The notes of a run, or its edits. The last one is off if there is a problem."""
    listed = [{"key": k, "line": line, "on": not problem or k < len(lines) - 1, "problem": ""} for k, line in enumerate(lines)]
    if problem:
        listed[-1]["problem"] = problem
    return {"op": op, "lines": listed, "problem": "", "file": "walk.yaml" if op == "notes" else "edits.yaml", **other}


def directed(
    line: str, *problems: tuple[str, str], applied: bool = False, listed: str = "notes", **choices: list[str]
) -> dict[str, Any]:
    """The answer to a draft. `problems`: keys with messages."""
    findings = [{"key": key, "severity": "error", "message": message, "help": ""} for key, message in problems]
    answer = {"op": "directed", "list": listed, "line": line, "ok": not problems, "applied": applied, "problems": findings}
    return answer | {"choices": choices}
