"""What of a scene's files is other than it was: which file, which lines."""

from __future__ import annotations

from pathlib import Path

from antdsl.pipeline import Shot
from antdsl.preview.speculative import sources

_NAMED = 3  # files that are told by name


def differing(old: Shot, new: Shot) -> str:
    """The files that two shots were made of, as far as they differ: `forager.ant line 34, scene.yaml lines 9–12`; empty where
    none does."""
    before, after = _texts(old), _texts(new)
    found = [_lines(name, before.get(name), text) for name, text in after.items() if before.get(name) != text]
    others = {name for name in old.inputs.keys() & new.inputs.keys() if old.inputs[name] != new.inputs[name]}
    found += sorted(name for name in others if name not in after and Path(name).suffix)  # meshes and such
    found += [f"{name} is gone" for name in before if name not in after]
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return ", ".join(found[:_NAMED]) + more


def _texts(shot: Shot) -> dict[str, str]:
    scenes = {Path(source.path).name: source.text for source in sources(shot.scene.document)}
    return {**scenes, **shot.loaded.texts}


def _lines(name: str, old: str | None, new: str) -> str:
    """A file with the lines of it that are other ones now, from the first to the last."""
    if old is None:
        return f"{name} is new"
    before, after = old.splitlines(), new.splitlines()
    start, most = 0, min(len(before), len(after))
    while start < most and before[start] == after[start]:
        start += 1
    end = 0
    while end < most - start and before[-1 - end] == after[-1 - end]:
        end += 1
    first, last = start + 1, len(after) - end
    if last < first:
        gone = len(before) - len(after)
        return f"{name}: {gone} {'line' if gone == 1 else 'lines'} gone after line {start}" if gone else name
    return f"{name} line {first}" if first == last else f"{name} lines {first}–{last}"
