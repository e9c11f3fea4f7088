"""Pydantic types for the values in a body's JSON documents: texts, numbers in a range, units, axes, colours, lists.

Texts, numbers and booleans are strict: other types are not converted. A wrong value raises an error with a message and a
correction.
"""

import re
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, FailFast, Field, PlainValidator, Strict, TypeAdapter, ValidationInfo

from antdsl import limits
from antdsl.scene.scene_model import UNIT_MM
from antdsl.scene.values import make_value_error

AXIS_BY_WORD = {
    f"{sign}{letter}": tuple(float(f"{sign}{each == letter:d}") for each in "xyz") for letter in "xyz" for sign in "+-"
}
_UNIT_PATTERN = re.compile(rf"(?:(\d{{1,6}}(?:\.\d{{1,9}})?) )?({'|'.join(UNIT_MM)})")
_MAX_NAME_CHARACTERS = 1000
_MIN_SCALE, _MAX_SCALE = 0.1, 10.0  # scale factors relative to the rest pose


def _check_text(value: str) -> str:
    """Return the text. Raises an error if it is too long or contains a null character."""
    if len(value) > _MAX_NAME_CHARACTERS:
        raise make_value_error(f"this text has {len(value):,} characters, more than {_MAX_NAME_CHARACTERS:,}")
    if "\0" in value:
        raise make_value_error("this text contains the invisible character U+0000")
    return value


def _check_nonempty(value: str) -> str:
    """Return the text. Raises an error if it is empty, too long, or contains a null character."""
    if not value:
        raise make_value_error("this text is empty")
    return _check_text(value)


def require_one_of(*words: str) -> BeforeValidator:
    """Return a validator that accepts one of the given words."""

    def check_word(value: Any) -> Any:
        if value not in words:
            raise make_value_error(f"this must be one of `{'`, `'.join(words)}`", f'write `"{words[0]}"`')
        return value

    return BeforeValidator(check_word)


def require_version(number: int) -> BeforeValidator:
    """Return a validator that accepts only the version `number` of a form."""

    def check_version(value: Any) -> int:
        if value != number or isinstance(value, bool):
            raise make_value_error(
                f"antdsl reads only version {number} of this file format", f"write `{number}` if the file has this format"
            )
        return number

    return BeforeValidator(check_version)


def limit_entries(limit_name: str, entry_noun: str, owner: str = "a body") -> BeforeValidator:
    """Return a validator that limits the number of entries. `limit_name`: the name of the limit in `antdsl.limits`."""

    def check_count(entries: Any) -> Any:
        most = getattr(limits, limit_name)
        if isinstance(entries, list | dict) and len(entries) > most:
            raise make_value_error(f"{owner} has at most {most:,} {entry_noun}", code="too-large")
        return entries

    return BeforeValidator(check_count)


def _reject_number_array(entries: Any) -> Any:
    """Return the entries unchanged. Raises a single error for an array of numbers, which could otherwise cause millions of
    errors, one for each number."""
    if isinstance(entries, list) and entries and all(type(entry) in (int, float) for entry in entries):
        raise make_value_error("this list must have names or entries `{ … }`, not numbers")
    return entries


def _check_names(entries: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the entries. Raises an error if two entries have the same name."""
    first: dict[str, int] = {}
    for number, entry in enumerate(entries):
        if entry.name in first:
            words, place = f"there are two entries called `{entry.name}`", (number, "name")
            raise make_value_error(words, "keep one of them", code="duplicate-name", at=place, first=(first[entry.name], "name"))
        first[entry.name] = number
    return entries


def parse_unit_mm(text: object) -> float:
    """Return a length unit such as `mm` or `6 mm` in millimetres, or 0 if the text is not a unit."""
    match = _UNIT_PATTERN.fullmatch(text) if isinstance(text, str) else None
    return float(match[1] or 1) * UNIT_MM[match[2]] if match else 0.0


def _read_unit(value: Any) -> float:
    """Return a length unit in millimetres. Raises an error if the value is not a unit."""
    unit = parse_unit_mm(value)
    if not unit:
        known = ", ".join(f"`{word}`" for word in UNIT_MM)
        raise make_value_error(
            f"the unit of length must be one of {known}, or a number of such units", 'write `"mm"`, or `"6 mm"`'
        )
    return unit


def _read_axis(value: Any, info: ValidationInfo) -> Any:
    """Return the unit vector of an axis such as `+x`. Raises an error if the value is not an axis."""
    if not isinstance(value, str) or value not in AXIS_BY_WORD:
        letter = value if isinstance(value, str) and f"+{value}" in AXIS_BY_WORD else "z" if info.field_name == "front" else "y"
        raise make_value_error(
            f"`{info.field_name}` must be one of the axes `+x` `-x` `+y` `-y` `+z` `-z`", f'write `"+{letter}"`'
        )
    return AXIS_BY_WORD[value]


def format_axis(axis: tuple[float, float, float]) -> str:
    """Return the word for an axis, such as `+x`."""
    return next(word for word, each in AXIS_BY_WORD.items() if each == axis)


Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict(), AfterValidator(_check_nonempty)]
AnyText = Annotated[str, Strict(), AfterValidator(_check_text)]  # may be empty
Number = Annotated[float, Strict(), Field(ge=-limits.MAX_NUMBER, le=limits.MAX_NUMBER)]
NonNegativeNumber = Annotated[float, Strict(), Field(ge=0.0, le=limits.MAX_NUMBER)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
SampleRate = Annotated[float, Strict(), Field(ge=0.001, le=100_000.0)]
ReadRate = Annotated[float, Strict(), Field(ge=1.0, le=1000.0)]
Length = Annotated[float, Strict(), Field(ge=1e-9, le=limits.MAX_NUMBER)]
PositiveLength = Annotated[float, Strict(), Field(ge=limits.MIN_STRIDE, le=limits.MAX_NUMBER)]
Duty = Annotated[float, Strict(), Field(ge=limits.DUTY_FACTOR_RANGE[0], le=limits.DUTY_FACTOR_RANGE[1])]
Scale = Annotated[float, Strict(), Field(ge=_MIN_SCALE, le=_MAX_SCALE)]
RgbColour = tuple[Share, Share, Share]
EntryList = BeforeValidator(_reject_number_array)
Texts = Annotated[tuple[Text, ...], EntryList]
Unit = Annotated[float, BeforeValidator(_read_unit)]
Axis = Annotated[tuple[float, float, float], BeforeValidator(_read_axis)]
MatrixRow = tuple[Number, Number, Number, Number]
UniqueNames = AfterValidator(_check_names)


def _check_matrix(rows: tuple[MatrixRow, MatrixRow, MatrixRow, MatrixRow]) -> tuple[MatrixRow, MatrixRow, MatrixRow, MatrixRow]:
    """Return the matrix, which is for column vectors. Raises an error if its last row is not 0 0 0 1."""
    if rows[3] != (0, 0, 0, 1):
        is_transposed = all(row[3] == 0 for row in rows[:3])
        help = "write the translation into the last column" if is_transposed else "write `[0, 0, 0, 1]`"
        raise make_value_error("the last row of a rest pose must be `[0, 0, 0, 1]`", help)
    return rows


def _check_joints(joints: dict[str, Texts]) -> dict[str, Texts]:
    """Return the joints of a rig. Raises an error if there are none."""
    if not joints:
        raise make_value_error("a rig needs at least one joint", 'write `{"root": []}`', code="bad-rig")
    return joints


Matrix = Annotated[tuple[MatrixRow, MatrixRow, MatrixRow, MatrixRow], AfterValidator(_check_matrix), EntryList]
Joints = Annotated[dict[Text, Texts], AfterValidator(_check_joints)]


def _reject_deformer(value: str) -> str:
    """Return the deformer of a static shape. Raises an error if it is not empty."""
    if value:
        words = f"a static shape cannot have a deformer, but this one has `{value[:60]}`"
        raise make_value_error(words, 'move the shape to `deforming`, or write `""` as its deformer')
    return value


def _check_colours(colours: tuple[RgbColour, ...]) -> tuple[RgbColour, ...]:
    """Return the colours of a varied material. Raises an error if there are fewer than two, or too many."""
    if not 2 <= len(colours) <= limits.MAX_BODY_PARTS:
        words = f"a material needs at least two colours to vary between, but this one has {len(colours)}"
        raise make_value_error(words, "write at least two colours", code="wrong-count")
    return colours


def _check_path_pair(paths: Any) -> Any:
    """Return the two paths of an included library. Raises an error if there are not exactly two."""
    if isinstance(paths, list) and len(paths) != 2:
        words, help = f"a library needs two paths, but this list has {len(paths)}", 'write `["$HIP/lib.glb", "/…/lib.glb"]`'
        raise make_value_error(words, help, complete=True)
    return paths


CHANNELS_EXAMPLE = '{"JOINT:tx": [0, 1]}'
_NUMBERS_ADAPTER = TypeAdapter(Annotated[list[Number], FailFast()])


def _read_samples(value: Any) -> NDArray[np.float64]:
    """Return the samples of a channel as an array. A single number becomes a constant channel."""
    return np.array(_NUMBERS_ADAPTER.validate_python(value if isinstance(value, list | dict) else [value]), np.float64)


Samples = Annotated[Any, PlainValidator(_read_samples)]


def _check_channels(channels: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Return the channels of a clip. Raises an error if there are no channels or samples, or if the numbers of samples differ."""
    if not channels:
        raise make_value_error("a clip needs at least one channel", f"write `{CHANNELS_EXAMPLE}`")
    longest, first = 1, ""
    for name, samples in channels.items():
        if not len(samples):
            raise make_value_error(f"`{name[:60]}` has no samples", "delete the channel", at=(name,), complete=True)
        if len(samples) > 1 and longest > 1 and len(samples) != longest:
            words = f"`{name[:60]}` has {len(samples):,} samples, but `{first[:60]}` has {longest:,}"
            raise make_value_error(
                words, "give all channels the same number of samples, or a single sample", at=(name,), key=True
            )
        if len(samples) > longest:
            longest, first = len(samples), name
    return channels


NoDeformer = Annotated[AnyText, AfterValidator(_reject_deformer)]
Colours = Annotated[tuple[RgbColour, ...], AfterValidator(_check_colours), EntryList]
Channels = Annotated[dict[str, Samples], AfterValidator(_check_channels)]
PathPair = Annotated[tuple[AnyText, AnyText], BeforeValidator(_check_path_pair)]
