"""Typed values of a JSON tree: each method returns a value of the expected kind, or reports a finding with its place and a
correction."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.files.json_text import Node, number_place
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.source import Source, Span

_KINDS = {
    dict: "an object `{ … }`",
    list: "a list `[ … ]`",
    str: "a text",
    bool: "true or false",
    int: "a number",
    float: "a number",
}
_NAME_CHARACTERS = 1000


def kind_of(node: Node) -> str:
    """What a value is, in words."""
    return "nothing" if node.value is None else _KINDS[type(node.value)]


@dataclass(slots=True)
class Values:
    """The values of one text, and the findings about them."""

    source: Source
    report: Report = field(default_factory=Report)

    def span(self, node: Node) -> Span:
        return Span(self.source, node.start, node.end)

    def start_span(self, node: Node) -> Span:
        """Return the span of the first character of a value, for findings about the whole value."""
        return Span(self.source, node.start, node.start + 1)

    def key_span(self, node: Node, key: str) -> Span:
        return Span(self.source, *node.keys[key]) if key in node.keys else self.start_span(node)

    def report_wrong(self, node: Node, expectation: str, help: str | None) -> None:
        place = self.start_span(node) if isinstance(node.value, dict | list) else self.span(node)
        self.report.error("wrong-value", f"expected {expectation} here, not {kind_of(node)}", place, help)

    def object(
        self, node: Node, what: str, known: Iterable[str], needed: dict[str, str] | None = None, *, strict: bool = True
    ) -> dict[str, Node] | None:
        """Return the entries of an object. `needed`: required keys, with an example of what to write. An unknown key is an error,
        or a warning with `strict` False, where others may extend the form."""
        if not isinstance(node.value, dict):
            self.report_wrong(node, f"{what}, which is an object `{{ … }}`,", None)
            return None
        known, needed = list(known), needed or {}
        missing = [key for key in needed if key not in node.value]
        for key in node.value:
            if key in known:
                continue
            near = nearest_name(key, missing) or nearest_name(key, known)
            if near in missing:
                missing.remove(str(near))
            help = f'write `"{near}"`' if near else "known here: " + ", ".join(f"`{word}`" for word in known)
            say = self.report.error if strict or near in needed else self.report.warning
            say("unknown-key", f"`{key[:60]}` is not a key of {what}", self.key_span(node, key), help)
        for key in missing:
            self.report.error("missing-key", f"{what} has no `{key}`", self.start_span(node), f'add `"{key}": {needed[key]}`')
        return node.value

    def items(self, node: Node, what: str) -> list[Node]:
        """Return the nodes of a list; for anything else report a finding and return none."""
        if not isinstance(node.value, list):
            self.report_wrong(node, f"a list of {what}", "write `[ … ]`")
            return []
        if node.numbers:
            if node.value:
                self.report.error("wrong-value", f"expected {what} here, not numbers", self.start_span(node), None)
            return []
        return [each for each in node.value if isinstance(each, Node)]

    def text(self, node: Node | None, what: str, *, empty: bool = False) -> str | None:
        if node is None:
            return None
        if not isinstance(node.value, str):
            self.report_wrong(node, what, 'write `"…"`')
            return None
        if not node.value and not empty:
            self.report.error("wrong-value", f"expected {what} here, but the text is empty", self.span(node), None)
            return None
        if len(node.value) > _NAME_CHARACTERS or "\0" in node.value:
            self.report.error("wrong-value", f"{what} is too long, or contains an invisible character", self.span(node), None)
            return None
        return node.value

    def number(self, node: Node | None, what: str, least: float = -limits.LARGEST, most: float = limits.LARGEST) -> float | None:
        if node is None:
            return None
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            self.report_wrong(node, what, None)
            return None
        if not least <= node.value <= most:
            self._report_outside(self.span(node), what, node.value, least, most)
            return None
        return float(node.value)

    def _report_outside(self, place: Span, what: str, value: float, least: float, most: float) -> None:
        nearest = least if value < least else most
        open_above = most >= limits.LARGEST and value < least
        bounds = f"of at least {least:g}" if open_above else f"from {least:g} to {most:g}"
        words = f"{what} is a number {bounds}, not {place.text[:30]}"
        self.report.error("out-of-range", words, place, f"write `{nearest:g}`" if abs(nearest) < limits.LARGEST else None)

    def boolean(self, node: Node | None, what: str, otherwise: bool) -> bool:
        if node is None:
            return otherwise
        if not isinstance(node.value, bool):
            self.report_wrong(node, what, "write `true` or `false`")
            return otherwise
        return node.value

    def numbers(
        self, node: Node | None, what: str, count: int | None = None, least: float = -limits.LARGEST, most: float = limits.LARGEST
    ) -> NDArray[np.float64] | None:
        """Return an array of numbers; exactly `count` of them unless that is None."""
        if node is None:
            return None
        if not node.numbers:
            inner = next((each for each in self.nodes(node) if not self._is_number(each)), None)
            if inner is not None:
                self.report_wrong(inner, f"a number of {what}", None)
            else:
                self.report_wrong(node, what, "write `[0, 0, 0]`")
            return None
        values = node.value
        assert isinstance(values, list)
        if count is not None and len(values) != count:
            words = f"{what} is a list of {count} numbers, and these are {len(values)}"
            self.report.error("wrong-value", words, self.span(node), None)
            return None
        array = np.array(values, np.float64)
        bad = np.flatnonzero((array < least) | (array > most))
        if len(bad):
            self._report_outside(number_place(self.source, node, int(bad[0])), what, float(array[bad[0]]), least, most)
            return None
        return array

    @staticmethod
    def nodes(node: Node) -> Iterator[Node]:
        if isinstance(node.value, list) and not node.numbers:
            yield from (each for each in node.value if isinstance(each, Node))

    @staticmethod
    def _is_number(node: Node) -> bool:
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)

    def version(self, entries: dict[str, Node], key: str, expected_version: int) -> bool:
        """Return whether a form's version is the supported one."""
        node = entries.get(key)
        if node is None:
            return False
        if node.value != expected_version or isinstance(node.value, bool):
            words = f"`{key}` {self.span(node).text[:20]} is not supported"
            self.report.error("wrong-value", words, self.span(node), f"write `{expected_version}`, if the file is in that form")
            return False
        return True

    def report_repeated(self, node: Node, words: str, first: Span) -> None:
        self.report.error("duplicate-name", words, self.span(node), "keep one of them", labels=(Label(first, "here first"),))

    def report_unknown(self, place: Span, what: str, name: str, known: Iterable[str], *, warn: bool = False) -> None:
        """Report an unknown name, with a suggestion of the name that may have been meant."""
        near = nearest_name(name, known)
        say = self.report.warning if warn else self.report.error
        say("unknown-name", f"there is no {what} `{name[:60]}`", place, f'write `"{near}"`' if near else None)
