"""The classes of findings. A `Diagnostic` is one finding with its location; a `Report` is a list of findings."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from antdsl.source import Span

Severity = Literal["error", "warning"]


def replace_unprintable(text: str, allowed_characters: str = "") -> str:
    """Return the text with every non-printing character, such as NUL or ESC, replaced by U+FFFD. `allowed_characters`:
    characters that are not replaced."""
    return "".join(c if c.isprintable() or c in allowed_characters else "\ufffd" for c in text)


_MAX_QUOTED_CHARACTERS = 160  # characters of a quoted value: one or two terminal lines
_MAX_LINE_CHARACTERS = 1500
_LONG_VALUE_PATTERN = re.compile(f"`([^`]{{{_MAX_QUOTED_CHARACTERS}}})[^`]+`")


def shorten_values(text: str) -> str:
    """Return the text with long quoted values shortened. If the result is still too long, it is cut."""
    text = _LONG_VALUE_PATTERN.sub(r"`\1…`", text)
    return text if len(text) <= _MAX_LINE_CHARACTERS else text[: _MAX_LINE_CHARACTERS - 1] + "…"


@dataclass(frozen=True, slots=True)
class Label:
    """A further location that a finding refers to, with a text that explains its role."""

    span: Span
    text: str


@dataclass(frozen=True, slots=True)
class Fix:
    """A correction that an editor can apply: a span, and the text that replaces it."""

    span: Span
    text: str


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """A finding.

    `code`: its stable code. `message`: one line in lower case that can be understood without context. `span`: its location.
    `help`: what to write instead. `labels`: further locations. `fix`: a correction that an editor can apply."""

    code: str
    message: str
    span: Span | None
    severity: Severity = "error"
    help: str | None = None
    labels: tuple[Label, ...] = ()
    fix: Fix | None = None

    def __post_init__(self) -> None:
        # Messages may quote untrusted files; control characters or long texts must not reach a terminal.
        for name in ("message", "help"):
            text = getattr(self, name)
            if text is None:
                continue
            if not text.isprintable():
                object.__setattr__(self, name, text := replace_unprintable(text, allowed_characters="\n"))
            if len(text) > _MAX_QUOTED_CHARACTERS:
                object.__setattr__(self, name, shorten_values(text))


def _make_diagnostic_key(diagnostic: Diagnostic) -> tuple[str | int, ...]:
    """Return a key that is equal for duplicate findings. The key contains the file's name instead of its text, because a shared
    file is read once per scene."""
    span = diagnostic.span
    if span is None:
        return (diagnostic.code, diagnostic.message)
    return (diagnostic.code, span.source.path, span.source.part_number, span.start, span.end)


_REPLACEMENT_PATTERN = re.compile("(?:did you mean|write) `([^`…]+)`\\??")


def find_fix(message: str, span: Span | None, help: str | None) -> Fix | None:
    """Return a fix if the help consists only of a replacement for the text that the message names. Return None if the help says
    more, or if the span covers something else."""
    match = _REPLACEMENT_PATTERN.fullmatch(help or "")
    return Fix(span, match[1]) if match and span is not None and f"`{span.text}`" in message else None


@dataclass(slots=True)
class Report:
    """A list of the findings of one or more stages. Findings with the same code at the same location are stored once.

    `dropped_warnings`: warnings about a program that do not apply to the scene. They appear in no output."""

    diagnostics: list[Diagnostic] = field(default_factory=list)
    dropped_warnings: list[Diagnostic] = field(default_factory=list)
    _known_keys: set[tuple[str | int, ...]] = field(init=False, repr=False, compare=False, default_factory=set)

    def __post_init__(self) -> None:
        self._known_keys.update(_make_diagnostic_key(d) for d in self.diagnostics)

    def add(self, diagnostic: Diagnostic) -> None:
        """Add a finding, unless the report already has an equal one."""
        key = _make_diagnostic_key(diagnostic)
        if key not in self._known_keys:
            self._known_keys.add(key)
            self.diagnostics.append(diagnostic)

    def drop_warnings(self, diagnostics: Iterable[Diagnostic]) -> None:
        """Remove warnings from the report. If they are added later, they are ignored."""
        warnings = list(diagnostics)
        keys = {_make_diagnostic_key(d) for d in warnings}
        self.dropped_warnings += warnings
        self.diagnostics = [d for d in self.diagnostics if _make_diagnostic_key(d) not in keys]
        self._known_keys |= keys

    def error(self, code: str, message: str, span: Span | None, help: str | None = None, **details: object) -> None:
        """Add an error. `details`: further fields of the Diagnostic."""
        self._add_finding("error", code, message, span, help, details)

    def warning(self, code: str, message: str, span: Span | None, help: str | None = None, **details: object) -> None:
        """Add a warning. `details`: further fields of the Diagnostic."""
        self._add_finding("warning", code, message, span, help, details)

    def _add_finding(
        self, severity: Severity, code: str, message: str, span: Span | None, help: str | None, details: dict[str, object]
    ) -> None:
        if details.get("fix") is None:
            details["fix"] = find_fix(message, span, help)
        self.add(Diagnostic(code, message, span, severity, help, **details))  # type: ignore[arg-type]

    def extend(self, others: Report | Iterable[Diagnostic]) -> None:
        """Add the findings of other reports. Warnings that those reports have dropped are dropped here, too."""
        if isinstance(others, Report) and others.dropped_warnings:
            self.drop_warnings(others.dropped_warnings)
        for diagnostic in others.diagnostics if isinstance(others, Report) else others:
            self.add(diagnostic)

    @property
    def errors(self) -> list[Diagnostic]:
        """Return all findings that are errors."""
        return [d for d in self.diagnostics if d.severity == "error"]

    @property
    def ok(self) -> bool:
        """Return whether there are no errors."""
        return not any(d.severity == "error" for d in self.diagnostics)

    def sort_by_place(self) -> list[Diagnostic]:
        """Return the findings ordered by file and position. Findings without a location come last."""

        def make_sort_key(d: Diagnostic) -> tuple[int, str, int]:
            return (1, "", 0) if d.span is None else (0, d.span.source.path, d.span.start)

        return sorted(self.diagnostics, key=make_sort_key)
