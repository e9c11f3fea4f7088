"""The verbs of notes and edits, and their keys with kind, unit, default and help. They are derived from the models of notes and
edits."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from types import NoneType, UnionType
from typing import Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from pydantic.fields import FieldInfo

from antdsl.outputs.edits.edit_values import Factor, FrameOffset, Speed
from antdsl.outputs.edits.verb_table import VERB_BY_WORD
from antdsl.outputs.edits.verbs.smoothing import Window
from antdsl.scene.crowds.crowd_model import BodyText
from antdsl.scene.notes.note_regions import CurveOrPoints, NoteRegion
from antdsl.scene.notes.note_values import FrameCount, FrameNumber, ShareRange, ShareValue, SpeedShare, ThinShare
from antdsl.scene.notes.notes_model import NOTE_MODELS, LookTargets
from antdsl.scene.notes.selectors import AgentConditions, NearTarget, Region, SelectorKeys, SelectorRegion
from antdsl.scene.notes.stagger import StaggerValue
from antdsl.scene.values import (
    Angle,
    FrameRangeValue,
    Length,
    PointOrName,
    PointValue,
    PositiveLength,
    PositiveSpeed,
    ScenePart,
    SceneWord,
)


class KeyKind(NamedTuple):
    """The kind of value that a key expects. `name`: its name for pages. `unit`: the unit of numbers. `example`: a value as
    written in a scene. `help`: the help text for keys without one of their own."""

    name: str
    unit: str = ""
    example: str = ""
    help: str = ""


class VerbKey(NamedTuple):
    """A key of a verb. `default`: the default value as written in a scene; "" if there is none. `is_selector`: whether the key
    selects agents."""

    name: str
    kind: KeyKind
    is_required: bool
    default: str
    help: str
    is_selector: bool


class VerbForm(NamedTuple):
    """A verb with its keys, in the order in which a line lists them. `value`: the kind of value that follows the verb itself."""

    verb: str
    help: str
    keys: tuple[VerbKey, ...]
    value: KeyKind

    def find_key(self, name: str) -> VerbKey | None:
        """Return the key called `name`, or None if the verb has no such key."""
        return next((key for key in self.keys if key.name == name), None)


_AGENTS_KIND = KeyKind("agents", "", "guards.17", "a crowd line, a species, or a selector")
_CACHE_KIND = KeyKind("cache", "", "other_cache", "the folder of a cache, in the folder of the scene or below it")
_TEXT_KIND = KeyKind("text")  # of keys without a kind: pages show a plain field
_CLIP_KIND = KeyKind("clip", "", "walk", "a clip of the body")
_STATE_KIND = KeyKind("state", "", "rest", "a state of the program")
_MAP_KIND = KeyKind("map", "", "damp", "a painted map of the world")
_THING_KIND = KeyKind("thing", "", "foot", "a mesh, an item, items, a camera or agents")
_CAMERA_KIND = KeyKind("camera", "", "shot", "a camera of the scene")
_LOOKS_KIND = KeyKind(
    "looks", "", "{head: leaf}", "a part of the body, and a point, item, agent, camera, mesh or `{direction: [0, 1, 0]}`"
)
_KINDS: tuple[tuple[Any, KeyKind], ...] = (
    (FrameRangeValue, KeyKind("frames", "", "120..143", "the first and the last frame, both included")),
    (FrameNumber, KeyKind("frame", "", "120", "the frame")),
    (FrameCount, KeyKind("count", "frames", "6", "a number of frames")),
    (ShareRange, KeyKind("part", "", "[0 %, 33 %]", "a part of the picture")),
    (ShareValue, KeyKind("share", "", "50 %", "a share from 0 % to 100 %")),
    (ThinShare, KeyKind("share", "", "50 %", "the share of agents that stay")),
    (SpeedShare, KeyKind("share", "", "50 %", "a share of the speed")),
    (PositiveLength, KeyKind("length", "mm", "50 mm", "a length")),
    (NearTarget, KeyKind("target", "", "[0, 0, 0]", "a point, an item, a camera or agents")),
    (NoteRegion, KeyKind("region", "", "{around: [0, 0, 0], radius: 50 mm}", "a box, a ball, a band along a curve, or a view")),
    (SelectorRegion, KeyKind("region", "", "{around: [0, 0, 0], radius: 50 mm}", "a box, a ball or a view")),
    (Region, KeyKind("region", "", "{around: [0, 0, 0], radius: 50 mm}", "a box or a ball")),
    (CurveOrPoints, KeyKind("path", "", "[[0, 0, 0], [50, 0, 0]]", "a curve of the world, or points")),
    (LookTargets, _LOOKS_KIND),
    (StaggerValue, KeyKind("stagger", "", "{from: [0, 0, 0], speed: 40 mm/s}", "how much later the frames of each agent are")),
    (SceneWord, _STATE_KIND),
    (PointValue, KeyKind("displacement", "", "[40 mm, 0, 0]", "a displacement along the scene's axes")),
    (PointOrName, KeyKind("place", "", "[0, 0, 0]", "a point or an item")),
    (tuple[PointValue, ...], KeyKind("points", "", "[[0, 0, 0], [80 mm, 0, 0]]", "the points of a curve")),
    (Length, KeyKind("length", "mm", "20 mm", "a coordinate")),
    (Angle, KeyKind("angle", "", "30 deg", "an angle")),
    (tuple[Angle, Angle, Angle], KeyKind("angles", "", "[0, 30 deg, 0]", "angles about ahead, up and right")),
    (Factor, KeyKind("factor", "", "150 %", "a factor")),
    (Speed, KeyKind("factor", "", "50 %", "the speed at which time passes")),
    (PositiveSpeed, KeyKind("speed", "", "20 mm/s", "a speed along the curve")),
    (FrameOffset, KeyKind("offset", "frames", "7", "by how many frames later; earlier below 0")),
    (Window, KeyKind("count", "frames", "9", "an odd number of frames")),
    (BodyText, KeyKind("body", "", "ant", "another body, by its word")),
)
_KIND_BY_ONLY_KEY: Mapping[str, KeyKind] = {  # of keys that only one verb has
    "joint": KeyKind("joint", "", "head", "a joint of the body"),
    "onto": KeyKind("mesh", "", "ground", "a mesh"),
    "colour": KeyKind("colour", "", "red", "a colour, by its word or `[r, g, b]` from 0 to 1"),
    "wear": KeyKind("layers", "", "[pack]", "the layers of the body that agents wear"),
    "count": KeyKind("count", "", "1", "the number of copies"),
    "ground": KeyKind("ground", "", "free", "`follow` keeps agents on the ground, `free` moves them rigidly"),
    "axis": KeyKind("axis", "", "x", "the axis perpendicular to the plane"),
}
_KIND_BY_KEY: Mapping[str, KeyKind] = {
    "play": _CLIP_KIND, "clip": _CLIP_KIND, "painted": _MAP_KIND, "for": _THING_KIND, "in_view": _CAMERA_KIND,
    "to": KeyKind("values", "", "{size: 6 mm}", "attributes with their values"), "at": _LOOKS_KIND,
    "share": KeyKind("share", "", "30 %"), "seed": KeyKind("count", "", "4", "the number from which `share` draws"),
    "without": _AGENTS_KIND, "most": KeyKind("count", "", "3"), "farthest": KeyKind("count", "", "3"),
}  # fmt: skip
_FIRST_KEYS, _LAST_KEYS = ("frames",), ("ease",)  # of the keys that are not required
_UNFILLED_KEYS = frozenset(("off",))  # the page has a place for it
_HELP_PATTERN = re.compile(r"`(\w+)`(?:, `(\w+)`)?: (.*?)(?=\s+`\w+`(?:, `\w+`)?: |\Z)", re.DOTALL)


@cache
def list_note_forms() -> tuple[VerbForm, ...]:
    """Return the verbs of notes."""
    return tuple(_make_form(verb, model) for verb, model in NOTE_MODELS.items())


@cache
def list_edit_forms() -> tuple[VerbForm, ...]:
    """Return the verbs of edits."""
    return tuple(_make_form(verb, row.line) for verb, row in VERB_BY_WORD.items())


FORMS_BY_LIST: Mapping[str, Callable[[], tuple[VerbForm, ...]]] = {"notes": list_note_forms, "edits": list_edit_forms}


def find_form(listed: str, verb: str) -> VerbForm | None:
    """Return the form of a verb, or None if the verb is unknown. `listed`: `notes` or `edits`."""
    return next((form for form in FORMS_BY_LIST[listed]() if form.verb == verb), None)


def _make_form(verb: str, model: type[ScenePart]) -> VerbForm:
    names = {"AgentConditions": AgentConditions}
    types, helps = get_type_hints(model, localns=names, include_extras=True), dict(_iterate_helps(model))
    keys = [
        _make_key(field.alias or name, name, field, types[name], helps, model)
        for name, field in model.model_fields.items()
        if name not in _UNFILLED_KEYS and field.alias != verb
    ]
    own = {model.model_fields[name].alias or name for name in model.__annotations__ if name in model.model_fields}
    keys.sort(
        key=lambda k: (k.is_selector, not k.is_required, k.name not in _FIRST_KEYS, k.name in _LAST_KEYS, k.name not in own)
    )
    is_about_agents = "agents" in model.model_fields
    help = _shorten_text(_HELP_PATTERN.sub("", model.__doc__ or ""))
    return VerbForm(verb, help, tuple(keys), _AGENTS_KIND if is_about_agents else _CACHE_KIND)


def _make_key(
    key: str, field_name: str, field: FieldInfo, value_type: Any, helps: Mapping[str, str], model: type[ScenePart]
) -> VerbKey:
    kind = _find_kind(key, value_type)
    is_selector_key = field_name in SelectorKeys.model_fields and issubclass(model, SelectorKeys)
    help = helps.get(key) or helps.get(field_name) or kind.help
    return VerbKey(key, kind, field.is_required(), _format_default(field.default, kind), help, is_selector_key)


def _find_kind(key: str, value_type: Any) -> KeyKind:
    """Return the kind of a key. The type of its values decides; if several kinds share this type, the name of the key decides."""
    if key in _KIND_BY_ONLY_KEY:
        return _KIND_BY_ONLY_KEY[key]
    is_union = get_origin(value_type) in (Union, UnionType)
    options = [part for part in get_args(value_type) if part is not NoneType] if is_union else [value_type]
    own = options[0] if len(options) == 1 else value_type
    for known, kind in _KINDS:
        if known in (own, *get_args(own)[:1]):  # the type, or one with further checks
            return kind
    return _KIND_BY_KEY.get(key, _TEXT_KIND)


def _format_default(value: Any, kind: KeyKind) -> str:
    """Return a default value as text; "" if there is none."""
    if isinstance(value, float):
        return f"{100 * value:g} %"
    return str(value) if isinstance(value, int | str) else ""


def _iterate_helps(model: type[ScenePart]) -> Iterator[tuple[str, str]]:
    """Yield the name and the help text of each key, from the docstrings of a model and its base classes, bases first."""
    for each in reversed(model.__mro__):
        for first, second, text in _HELP_PATTERN.findall(each.__dict__.get("__doc__") or ""):
            yield first, _shorten_text(text)
            if second:
                yield second, _shorten_text(text)


def _shorten_text(text: str) -> str:
    """Return a text on one line, without its final full stop."""
    return " ".join(text.split()).rstrip(".")
