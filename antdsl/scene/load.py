"""Reads a scene: converts bytes to a tree, and the tree to models. Each error has a location in the text, and says what to write
instead."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from antdsl import limits
from antdsl.diagnostics import Diagnostic, Fix, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.document import MappingNode, PathKey, ScalarNode, decode_source, find_span, read_document, to_plain_tree
from antdsl.scene.inheritance import merge_parents
from antdsl.scene.notes.note_lines import append_notes
from antdsl.scene.paths import PathRefused, Roots, read_user_file
from antdsl.scene.scene_values import replace_entries
from antdsl.source import Source, Span
from antdsl.syntax.mistakes.number_slips import COMMA_NUMBER_PATTERN, make_comma_diagnostic

if TYPE_CHECKING:
    from antdsl.scene.scene_model import SceneModel
    from antdsl.scene.values import ScenePart

# Keys that users look for in a scene although they belong elsewhere.
_MISPLACED_KEY_HELP = {
    "threads": "give `--threads N` on the command line",
    "chunk": "give `--chunk N` on the command line",
    "root": "give `--root NAME=FOLDER` on the command line",
    "roots": "give `--root NAME=FOLDER` on the command line",
    "out": "give `--out FOLDER` on the command line",
    "limits": "a scene cannot raise limits",
    "plugin": "a scene cannot load code",
    "plugins": "a scene cannot load code",
    "import": "a scene cannot load code",
    "include": "write `extends: base.yaml`, and the differences below it",
    "base": "write `extends: base.yaml`, and the differences below it",
}


# of tags in unions; no key of a scene ends so
_UNION_TAG_SUFFIXES = ("-thing", "-camera", "-here", "-selector", "-region", "-edit", "-draw", "-facing", "-start")


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A scene with typed values, as in the source. It has not been checked against a program.

    `added_notes`: how many of its last notes are not from its files but were added by the caller."""

    model: SceneModel
    document: MappingNode
    source: Source
    roots: Roots
    added_notes: int = 0

    def find_span(self, *path: PathKey, key: bool = False) -> Span:
        """Return the location of a value in the text, or of its nearest existing ancestor. If `key` is true, return the location
        of its key."""
        return find_span(self.document, path, key=key)[0]

    def replace_values(self, **values: object) -> Scene:
        """Return the same scene with new values for some keys. None leaves a key unchanged."""
        changes = {name: value for name, value in values.items() if value is not None}
        return replace(self, model=self.model.model_copy(update=changes)) if changes else self

    def hash_camera(self, name: str) -> str:
        """Return a hash of the definition of a camera in the source."""
        return hashlib.blake2b(repr(self.model.named_cameras[name]).encode(), digest_size=16).hexdigest()

    def compute_digest(self) -> str:
        """Return a digest of everything in the scene's files that affects results.

        The digest excludes the output, and cameras that no level of detail uses. For cameras that agents sense, use
        `hash_camera`. The digest also excludes the last frame and `until`, so that a cache can be continued past its end."""
        without = {"output", "frames", "until", "extends", "cameras"} | ({"camera"} if self.model.lod is None else set())
        relevant_keys = sorted(set(type(self.model).model_fields) - without)
        values = [(name, getattr(self.model, name)) for name in relevant_keys if name not in ("crowd", "notes")]
        notes = self.model.notes[: len(self.model.notes) - self.added_notes]
        values += [("notes", notes)] if notes else []
        drawn = {"name", "source", "body", "wear"}
        lines = [[getattr(line, key) for key in sorted(set(type(line).model_fields) - drawn)] for line in self.model.crowd]
        relevant = [*values, *lines, self.model.frames.first]
        return hashlib.blake2b(repr(relevant).encode(), digest_size=16).hexdigest()


def load_scene(
    path: Path, grants: Mapping[str, Path] | None = None, notes: Sequence[str] = (), values: Mapping[str, str] | None = None
) -> tuple[Scene | None, Report]:
    """Return the typed scene in a file, and a report. The scene is None if there are errors.

    Files that the scene names are not accessed. They must be in the scene's own folder or in `grants`.
    `notes`: lines with further notes. `values`: texts that replace values of the file (`scene_values.replace_entries`)."""
    try:
        data = read_user_file(path, limits.MAX_SCENE_BYTES)
    except PathRefused as error:
        report = Report()
        report.error(error.code, str(error), None, error.help)
        return None, report
    return load_scene_text(data, str(path), Roots(path.resolve().parent, dict(grants or {})), notes=notes, values=values)


def load_scene_text(
    data: bytes,
    name: str,
    roots: Roots,
    unsaved_texts: Mapping[Path, bytes] | None = None,
    notes: Sequence[str] = (),
    values: Mapping[str, str] | None = None,
) -> tuple[Scene | None, Report]:
    """Return the typed scene in the bytes of a file, and a report, like `load_scene`. The scene is None if there are errors.

    `unsaved_texts`: contents that override the files of scenes that this scene extends. `notes`, `values`: as in `load_scene`."""
    source, report = decode_source(data, name)
    if not report.ok:
        return None, report
    document, report = read_document(source)
    if document is None:
        return None, report
    document = merge_parents(document, name, roots, report, unsaved_texts)
    if document is not None:
        document = replace_entries(document, values or {}, report)
    if document is not None:
        document = append_notes(document, notes, report)
    if document is None:
        return None, report
    from pydantic import ValidationError

    from antdsl.scene.scene_model import SceneModel

    try:
        model = SceneModel.model_validate(to_plain_tree(document))
    except ValidationError as problem:
        outside = _find_lines_at_wrong_level(document)
        for error in drop_cascading_errors(problem.errors(include_url=False, include_input=False)):
            path = tuple(error["loc"])
            if path[:1] and path[0] in outside and len(path) == 1:
                report.add(outside[path[0]])
            else:
                report_model_error(report, document, error)
        return None, report
    return Scene(model, document, source, roots, len(notes)), report


_KEYS_WITH_LINES = frozenset(("world", "set", "fields", "layers", "camera", "cameras", "lod", "output"))


def _find_lines_at_wrong_level(document: MappingNode) -> dict[PathKey, Diagnostic]:
    """Return errors about lines at the left edge that should be indented below an earlier key without a value.

    Each error is about the first of these lines. It is stored under the earlier key and under the key of each of these lines."""
    from antdsl.scene.scene_model import SceneModel

    known = {field.alias or name for name, field in SceneModel.model_fields.items()}
    diagnostics: dict[PathKey, Diagnostic] = {}
    names = list(document.entries)
    for number, name in enumerate(names):
        node = document.entries[name]
        inner = list(takewhile(lambda key: key not in known and not find_nearest_name(key, known), names[number + 1 :]))
        if name not in _KEYS_WITH_LINES or not inner or not isinstance(node, ScalarNode) or node.text or node.is_quoted:
            continue
        first, last = document.keys[inner[0]], document.entries[inner[-1]].span
        source = first.source
        text = source.text[first.start : last.end].replace("\n", "\n  ")
        diagnostic = Diagnostic(
            "scene-syntax", f"`{inner[0]}` is at the left edge, but nothing is below `{name}:`", first,
            help=f"begin the lines below `{name}:` with 2 spaces",
            fix=Fix(Span(source, first.start, last.end), f"  {text}"),
        )  # fmt: skip
        diagnostics |= dict.fromkeys((name, *inner), diagnostic)
    return diagnostics


def drop_cascading_errors(errors: list[Any]) -> list[Any]:
    """Return the errors, without consequential errors of a misspelled key.

    pydantic reports a misspelled key twice: as an unknown key, and as a missing key with the right name. Where any key is
    allowed, it instead reports a wrong type for the value."""
    missing = {tuple(error["loc"]) for error in errors if error["type"] == "missing"}
    errors_by_path: dict[tuple[PathKey, ...], Any] = {}
    meant: set[tuple[PathKey, ...]] = set()
    for error in errors:
        path = tuple(error["loc"])
        for length in range(len(path), 0, -1):
            above, key = path[: length - 1], path[length - 1]
            missing_names = [each[-1] for each in missing if each[:-1] == above and each != path and isinstance(each[-1], str)]
            near = find_nearest_name(key, missing_names) if isinstance(key, str) and key not in missing_names else None
            if near:
                meant.add((*above, near))
                error = {**error, "type": "extra_forbidden", "loc": path[:length], "meant": near}
                break
        errors_by_path.setdefault(tuple(error["loc"]), error)
    return [error for path, error in errors_by_path.items() if error["type"] != "missing" or path not in meant]


def report_model_error(
    report: Report, document: MappingNode, error: Any, models: Mapping[str, type[ScenePart]] | None = None
) -> None:
    """Add a pydantic error to a report, at its location in the text. `models`: further models. The key of a model is the last
    word of the paths that lead to it."""
    kind, path = error["type"], tuple(error["loc"])
    if kind == "extra_forbidden":
        _report_unknown_key(report, document, path, error.get("meant"), models or {})
        return
    if kind == "missing":
        span, walked = find_span(document, path[:-1], key=bool(path[:-1]))
        if isinstance(path[-1], int):
            report.error("wrong-value", "this list has too few values", span, "a point is `[x, y, z]`")
            return
        owner_text = f"`{walked[-1]}`" if walked and isinstance(walked[-1], str) else "the scene" if not walked else "this line"
        if not walked:
            span = Span(span.source, span.start, min(span.start + 1, span.end))
        value = "[0, 0, 0]" if path[-2:-1] == ("box-region",) else _EXAMPLE_VALUES.get(path[-1], "…")
        report.error("missing-key", f"{owner_text} has no `{path[-1]}`", span, f"add `{path[-1]}: {value}`")
        return
    bad_key = bool(path) and path[-1] == "[key]"
    span, _ = find_span(document, path[:-1] if bad_key else path, key=bad_key)
    number = COMMA_NUMBER_PATTERN.search(span.text) if kind == "too_long" else None
    if number is not None:  # `[0,4, 1, 2]`
        report.add(make_comma_diagnostic(Span(span.source, span.start + number.start(), span.start + number.end())))
        return
    if kind == "worded":
        context = error["ctx"]
        report.error(context.get("code", "wrong-value"), context["words"], span, context["help"] or None)
    else:
        report.error(
            "wrong-value",
            _describe_error(kind, error),
            span,
            _LIST_HELP.get(str(path[-1])) if path and kind in ("tuple_type", "too_short") else None,
        )


# Typical values for required keys.
_EXAMPLE_VALUES = {
    "antdsl": "1",
    "count": "100",
    "species": "NAME",
    "from": "FILE.ant",
    "at": "[0, 0, 0]",
    "mesh": "FILE.ply",
    "any": "[LAYER, none]",
}
_MESSAGE_BY_TYPE_ERROR = {
    "tuple_type": "expected a list here",
    "dict_type": "expected a mapping here",
    "model_type": "expected a mapping here",
    "model_attributes_type": "expected a mapping here",
    "too_long": "this list has too many values",
    "string_type": "expected a word here",
    "too_short": "this list has too few values",
}

_LIST_HELP = {"wear": "write `wear: [LAYER]`", "any": "write `{any: [LAYER, LAYER, none]}`"}  # examples of lists, by their key


def _describe_error(kind: str, error: Any) -> str:
    return _MESSAGE_BY_TYPE_ERROR.get(kind) or str(error["msg"]).rstrip(".").replace("Input should be", "this should be").lower()


def _report_unknown_key(
    report: Report,
    document: MappingNode,
    path: tuple[PathKey, ...],
    suggestion: str | None,
    models: Mapping[str, type[ScenePart]],
) -> None:
    key = str(path[-1])
    span, _ = find_span(document, path, key=True)
    allowed = sorted(_list_allowed_keys(path, models))
    near = suggestion or find_nearest_name(key, allowed)
    if len(path) == 1 and key in _MISPLACED_KEY_HELP:
        report.error("unknown-key", f"`{key}` is not a scene setting", span, _MISPLACED_KEY_HELP[key])
        return
    help = f"did you mean `{near}`?" if near else "known here: " + ", ".join(f"`{word}`" for word in allowed)
    report.error("unknown-key", f"`{key[:60]}` is not a key of {_format_path(path)}", span, help)


def _format_path(path: tuple[PathKey, ...]) -> str:
    from antdsl.scene.notes.notes_model import NOTE_TAG_SUFFIX

    above = [part for part in path[:-1] if isinstance(part, str) and not part.endswith(_UNION_TAG_SUFFIXES)]
    return f"`{above[-1].removesuffix(NOTE_TAG_SUFFIX)}`" if above else "a scene"


def _list_allowed_keys(path: tuple[PathKey, ...], further_models: Mapping[str, type[ScenePart]]) -> list[str]:
    """Return the keys that the model at a path allows. `further_models`: models in addition to the scene's, by the last word of
    the path."""
    from antdsl.scene import scene_model
    from antdsl.scene.camera_models import CAMERA_MODEL_BY_TYPE_TAG, CameraKey
    from antdsl.scene.crowds.casting_model import RANDOM_VALUE_MODELS
    from antdsl.scene.crowds.crowd_model import LayerChoice
    from antdsl.scene.notes.note_regions import Band
    from antdsl.scene.notes.notes_model import NOTE_MODELS, make_note_tag
    from antdsl.scene.notes.selectors import AgentConditions, Ball, Box, View
    from antdsl.scene.notes.stagger import Stagger

    # the last word of the path identifies the model that raised the error; tags of the schema are among the words
    models: dict[str, type[ScenePart]] = {
        **further_models,
        **{scene_model.make_thing_type_tag(head): each for head, each in scene_model.THING_MODELS.items()},
        **CAMERA_MODEL_BY_TYPE_TAG,
        "keys": CameraKey if "camera-here" in path else scene_model.PositionKey,
        "wear": LayerChoice,
        "mapping-selector": AgentConditions,
        "box-region": Box,
        "ball-region": Ball,
        "band-region": Band,
        "view-region": View,
        "stagger": Stagger,
        **{f"{key}-draw": each for key, each in RANDOM_VALUE_MODELS.items()},
        "fields": scene_model.FieldStart,
        **scene_model.FIELD_START_MODELS,
        **{make_note_tag(verb): model for verb, model in NOTE_MODELS.items()},
        **scene_model.MODEL_BY_PATH,
    }
    for part in reversed(path[:-1]):
        if part in models:
            model_class = models[str(part)]
            break
    else:
        model_class = scene_model.SceneModel
    return [field.alias or name for name, field in model_class.model_fields.items()]
