"""Reads one part of a definition from bytes, as a definition file that names it does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from antdsl.bodies.agents.definition import Rig
from antdsl.bodies.files.clip_document import build_clip
from antdsl.bodies.files.document_errors import read_form
from antdsl.bodies.files.document_model import ClipForm, Form, GroupForm, LayerForm, RigForm
from antdsl.bodies.files.documents import build_group, build_layer, build_rig, read_metadata
from antdsl.bodies.files.json_text import JsonNode, read_tree
from antdsl.diagnostics import Report

Reader = Callable[[JsonNode, Report], Any]


def reader(form: type[Form], build: Callable[[Any, JsonNode, Report], Any]) -> Reader:
    def read(root: JsonNode, report: Report) -> Any:
        model = read_form(form, root, report)
        return None if model is None else build(model, root, report)

    return read


def clip_reader(rig: Rig | None = None) -> Reader:
    return reader(ClipForm, lambda form, root, report: build_clip(form, root, report, rig))


READERS: dict[str, Reader] = {
    "rig": reader(RigForm, build_rig),
    "layer": reader(LayerForm, lambda form, root, report: build_layer(form)),
    "group": reader(GroupForm, lambda form, root, report: build_group(form)),
    "metadata": read_metadata,
    "clip": clip_reader(),
}


def read_part(data: bytes, read: Reader, name: str = "x.json") -> tuple[Any, Report]:
    """Return a part, or None if one of the findings is an error."""
    root, report = read_tree(data, name, "a part")
    part = None if root is None else read(root, report)
    return (part if report.ok else None), report
