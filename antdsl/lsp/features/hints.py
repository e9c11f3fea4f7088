"""Inlay hints: the rank of each layer, and the number of frames of each duration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import ceil

from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.tables.units import find_unit_measure
from antdsl.program.tables.vocabulary import TIME_DIMENSION
from antdsl.program.traverse import iterate_nodes
from antdsl.source import Span
from antdsl.syntax import nodes

_DEFAULT_FPS = Fraction(24)


@dataclass(frozen=True, slots=True)
class InlayHint:
    """A text that the editor displays next to a span. `is_before`: whether it is displayed before the span instead of after
    it."""

    span: Span  # the hint is displayed before the start of this span, or after its end
    is_before: bool
    text: str
    help: str


def find_hints(workspace: Workspace, document: OpenDocument) -> list[InlayHint]:
    """Return the hints of a program, in text order."""
    fps = find_frame_rate(workspace, document)
    all_hints = [hint for item in document.parsed[0].items for hint in _find_item_hints(item, fps)]
    return sorted(all_hints, key=lambda hint: document.find_start(hint.span))


def find_frame_rate(workspace: Workspace, document: OpenDocument) -> Fraction | None:
    """Return the frame rate of the scenes that use a program. Return None if no scene uses it, or if their rates differ."""
    rates = set()
    for path in workspace.list_files():
        if path.suffix == ".ant" or document.path not in workspace.find_linked_files(path):
            continue
        scene = workspace.find_document(path)
        if scene is not None:
            try:
                rates.add(Fraction(scene.scene.fps or "24"))
            except (ValueError, ZeroDivisionError):
                continue
    return rates.pop() if len(rates) == 1 else None


def _find_item_hints(item: object, fps: Fraction | None) -> Iterator[InlayHint]:
    for part, _ in iterate_nodes(item):
        if isinstance(part, nodes.Layers):
            yield from _find_rank_hints(part)
        elif isinstance(part, nodes.Quantity):
            hint = _make_frame_hint(part, fps)
            if hint is not None:
                yield hint


def _find_rank_hints(node: nodes.Layers) -> Iterator[InlayHint]:
    mode = node.mode.text if node.mode is not None else "budget"
    if mode == "sum":
        return  # all count equally
    rule = "only the first layer with a push counts" if mode == "first" else "uses the strength that the lines above leave"
    for rank, layer in enumerate(node.layers, 1):
        yield InlayHint(layer.span, True, f"{rank}.", f"layer {rank} of {len(node.layers)}: {rule}")


def _make_frame_hint(node: nodes.Quantity, fps: Fraction | None) -> InlayHint | None:
    """Return a hint with the number of frames that a duration takes, rounded up; None if there is nothing to show."""
    measure = find_unit_measure(node.unit)
    if measure is None or measure.dim != TIME_DIMENSION or measure.step:
        return None
    rate = fps or _DEFAULT_FPS
    exact = Fraction(str(node.value)) * Fraction(str(measure.factor)) * rate
    count = ceil(exact)
    frame_text = f"{count} frame{'' if count == 1 else 's'}"
    where = f"at {float(rate):g} fps" if fps is not None else "at 24 fps, because no scene sets another rate"
    return InlayHint(
        node.span,
        False,
        frame_text if fps is not None else f"{frame_text} at 24 fps",
        f"{node.span.text} is {frame_text} {where}",
    )
