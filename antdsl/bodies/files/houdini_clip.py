"""Parses Houdini's text clips (`.clip`) into the tree of a clip document, and writes text clips.

The format is that of the Public Domain Clip Library (Side Effects Software): a clip in braces with `rate`, `start`, `tracklength`
and `tracks`, and each track in braces with `name` and `data`. Newer files write `data_rle`, in which `@3 0.5` is 0.5 three times.
The bytes of `.bclip` files have no published form."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import groupby
from math import isfinite
from typing import NoReturn

from antdsl import limits
from antdsl.bodies.agents.transforms import ROTATION_ORDERS
from antdsl.bodies.files.json_text import JsonNode
from antdsl.diagnostics import Report
from antdsl.scene.document import decode_source
from antdsl.source import Source, Span

_WORD_PATTERN = re.compile(r'"[^"\n]*"|[{}=]|[^\s{}="]+')
_MAX_VALUES = limits.MAX_CLIP_BYTES // 104  # samples of all tracks; a sample of a joint takes 104 bytes later
_ROTATION_ORDER_KEYS = ("rOrd", "xOrd", "pOrd")  # orders of rotations and transforms, which are no animation


def read_clip_text(data: bytes, name: str) -> tuple[JsonNode | None, Report]:
    """Return the bytes of a `.clip` file as the tree of a clip document, and a report. After an error, the tree is None."""
    source, report = decode_source(data, name, "a clip")
    if not report.ok:
        return None, report
    reader = _ClipReader(source, report)
    try:
        return reader.read_clip(), report
    except _ClipMistake:
        return None, report


def write_clip_text(channels: Mapping[str, Sequence[float]], rate: float) -> str:
    """Return a text clip with these channels, which must all have the same length. Angles are in degrees, applied about x, then
    y, then z.

    `rate`: samples per second. A run of equal samples is written once, with its length."""
    length = max(map(len, channels.values()), default=1)
    joints = dict.fromkeys(name.rpartition(":")[0] for name in channels if name.endswith(":rx"))
    tracks = {**channels, **{f"{joint}:rOrd": [ROTATION_ORDERS.index("xyz")] * length for joint in joints}}
    lines = ["{", f"   rate = {rate:.17g}", "   start = 0", f"   tracklength = {length}", f"   tracks = {len(tracks)}"]
    for name, samples in tracks.items():
        runs = [(value, len(list(group))) for value, group in groupby(samples)]
        words = [f"@{count} {value:.9g}" if count > 1 else f"{value:.9g}" for value, count in runs]
        lines += ["   {", f"      name = {name}", f"      data_rle = {' '.join(words)}", "   }"]
    return "\n".join([*lines, "}"]) + "\n"


class _ClipMistake(Exception):
    """Error that ends the parsing of a text. The finding is already in the report."""


class _ClipReader:
    """Parser of one text clip, which is a sequence of words."""

    def __init__(self, source: Source, report: Report) -> None:
        self._source, self._report, self._value_count = source, report, 0
        self._words = [(each.group().strip('"'), each.start(), each.end()) for each in _WORD_PATTERN.finditer(source.text)]
        self._place = 0

    def _fail(self, message: str, place: int, help: str = "save the clip again in Houdini, as .clip") -> NoReturn:
        """Report an error at the word with the index `place`, and end the parsing."""
        end = len(self._source.text)
        start, end = self._words[place][1:] if place < len(self._words) else (end, end)
        offset = len(self._source.text[:start].encode())
        self._report.error("wrong-value", f"{message} (byte {offset:,})", Span(self._source, start, end), help)
        raise _ClipMistake

    def _peek(self) -> str:
        """Return the next word, or an empty text at the end."""
        return self._words[self._place][0] if self._place < len(self._words) else ""

    def _take_word(self, expected: str = "") -> str:
        """Return the next word and advance past it. `expected`: the word that must follow; "" allows any word. Reports an error
        for another word."""
        word = self._peek()
        if not word or (expected and word != expected):
            self._fail(
                f"expected {f'`{expected}`' if expected else 'a value'}, not {f'`{word[:40]}`' if word else 'the end'}",
                self._place,
            )
        self._place += 1
        return word

    def _read_values(self) -> list[str]:
        """Return all words before the next key, the next bracket or the end."""
        values = []
        while self._peek() not in ("", "{", "}") and not self._is_key():
            values.append(self._take_word())
        return values

    def _is_key(self) -> bool:
        """Return whether the next word is a key: a word before an equals sign."""
        return self._place + 1 < len(self._words) and self._words[self._place + 1][0] == "="

    def _read_number(self, word: str, place: int) -> float:
        """Return a word as a number. Reports an error if it is not a number."""
        try:
            number = float(word)
        except ValueError:
            number = float("nan")
        if not isfinite(number):
            self._fail(f"`{word[:40]}` is not a number", place)
        return number

    def read_clip(self) -> JsonNode:
        """Return the tree of the clip document."""
        entries: dict[str, tuple[list[str], int]] = {}
        tracks: dict[str, tuple[list[float], int]] = {}
        self._take_word("{")
        while self._peek() != "}":
            if self._peek() == "{":
                name, samples, place = self._read_track(self._read_length(entries))
                if name in tracks:
                    self._fail(f"there are two tracks `{name[:60]}`", place)
                tracks[name] = samples, place
            else:
                place, key = self._place, self._read_key()
                entries[key] = self._read_values(), place
        rate = self._read_entry(entries, "rate")
        channels = {name: each for name, each in tracks.items() if name.rpartition(":")[2] not in _ROTATION_ORDER_KEYS}
        order = self._find_rotation_order(entries, tracks)
        values = {
            "antdsl_clip": self._make_node(1, 0),
            "name": self._make_node(re.split(r"[/\\]", self._source.path)[-1].rpartition(".")[0] or "clip", 0),
            "rate": self._make_node(rate, entries["rate"][1]),
            "rotation_order": self._make_node(order, 0),
            "angles": self._make_node("degrees", 0),
            "channels": JsonNode(
                self._source, {name: self._make_node(samples, place) for name, (samples, place) in channels.items()}, 0,
                len(self._source.text), {name: self._words[place][1:] for name, (_, place) in channels.items()},
            ),
        }  # fmt: skip
        return JsonNode(self._source, values, 0, len(self._source.text))

    def _find_rotation_order(self, entries: dict[str, tuple[list[str], int]], tracks: dict[str, tuple[list[float], int]]) -> str:
        """Return the rotation order that all joints share. It is taken from the tracks `JOINT:rOrd` or, without such tracks,
        from the entry `quaternions`."""
        numbers = {number for name, (samples, _) in tracks.items() if name.endswith(":rOrd") for number in samples}
        if not numbers:
            return (entries.get("quaternions", ([], 0))[0] or ["xyz"])[0]
        number = min(numbers)
        if len(numbers) > 1 or number not in range(len(ROTATION_ORDERS)):
            place = next(place for name, (_, place) in tracks.items() if name.endswith(":rOrd"))
            self._fail(
                "the joints do not share one constant order of rotations",
                place,
                "write the same constant `rOrd` for all joints, a number from 0 to 5",
            )
        return ROTATION_ORDERS[int(number)]

    def _make_node(self, value: list[float] | str | float, place: int) -> JsonNode:
        """Return a node for a value. Its location is that of the word with the index `place`."""
        start, end = self._words[place][1:]
        return JsonNode(self._source, value, start, end, has_plain_numbers=isinstance(value, list))

    def _read_key(self) -> str:
        """Return a key, and skip the equals sign after it."""
        key = self._take_word()
        self._take_word("=")
        return key

    def _read_entry(self, entries: dict[str, tuple[list[str], int]], key: str) -> float:
        """Return the number that the clip stores under `key`."""
        words, place = entries.get(key, ([], self._place))
        if len(words) != 1:
            self._fail(f"the clip needs one number for `{key}`", place)
        return self._read_number(words[0], place)

    def _read_length(self, entries: dict[str, tuple[list[str], int]]) -> int:
        """Return the number of samples of each track."""
        length = self._read_entry(entries, "tracklength")
        if not 1 <= length <= limits.MAX_CLIP_SAMPLES or length != int(length):
            message = f"`tracklength` is `{length:g}`, not a whole number from 1 to {limits.MAX_CLIP_SAMPLES:,}"
            self._fail(message, entries["tracklength"][1])
        return int(length)

    def _read_track(self, length: int) -> tuple[str, list[float], int]:
        """Read a track. Return its name, its samples, and the index of the word with its name."""
        start = self._place
        self._take_word("{")
        name, place, samples = "", start, list[float]()
        while self._peek() != "}":
            key = self._read_key()
            if key in ("data", "data_rle"):
                samples = self._read_samples(length)
            elif key == "name":
                place, name = self._place, " ".join(self._read_values())
            else:
                self._read_values()
        self._take_word("}")
        if not name:
            self._fail("a track has no `name`", start)
        if len(samples) != length:
            self._fail(f"the track `{name[:60]}` has {len(samples):,} samples, not {length:,}", place)
        return name.rpartition("/")[2], samples, place

    def _read_samples(self, length: int) -> list[float]:
        """Return the samples of a track, with repeated values in full."""
        samples: list[float] = []
        self._value_count += length
        if self._value_count > _MAX_VALUES:
            self._fail(
                f"the tracks of the clip have more than {_MAX_VALUES:,} samples", self._place, "use fewer samples per second"
            )
        while self._peek() not in ("", "{", "}") and not self._is_key():
            place, word, count = self._place, self._take_word(), 1
            if word.startswith("@"):
                count = int(min(self._read_number(word[1:], place), length))
                place, word = self._place, self._take_word()
            samples += [self._read_number(word, place)] * count
            if len(samples) > length:
                self._fail(f"the track has more than {length:,} samples", place)
        return samples
