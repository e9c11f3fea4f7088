"""Stores settings of a body in the extras of a glTF file: length, legs, gaits, idle clip and capsule. Lengths are in metres."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from antdsl.bodies.agents.definition import BodyError, Definition
from antdsl.bodies.files.gltf.gltf_clips import EXTRAS_KEY

CAPSULE_KEYS = ("length", "width", "height", "ahead")


def build_body_extras(body: Definition) -> dict[str, Any]:
    """Return the extras of a glTF file that store the settings of a body. The body is in metres."""
    settings: dict[str, Any] = {"length": body.length}
    if body.legs:
        settings["legs"] = [leg.to_entry() for leg in body.legs]
    if body.gaits:
        settings["gaits"] = [asdict(gait) for gait in body.gaits]
    if body.idle:
        settings["idle"] = body.idle
    if body.capsule is not None:
        settings["capsule"] = dict(zip(CAPSULE_KEYS, body.capsule, strict=True))
    return {EXTRAS_KEY: settings}


def apply_body_extras(body: Definition, extras: Any) -> Definition:
    """Return the body with the settings in the extras of its glTF file. Raises BodyError for wrong values.

    If the extras have no length, the result has the length 0, and the caller must measure it."""
    settings = extras.get(EXTRAS_KEY) if isinstance(extras, dict) else None
    if settings is None:
        return replace(body, length=0.0)
    from pydantic import ValidationError  # imported late, because most files have no such settings

    from antdsl.bodies.files.document_model import BodySettings
    from antdsl.bodies.files.documents import build_capsule, build_gaits, build_legs

    try:
        form = BodySettings.model_validate(settings)
    except ValidationError as problem:
        error = problem.errors(include_url=False, include_input=False)[0]
        path = "".join(f" at `{str(key)[:60]}`" for key in error["loc"])
        advice = "the extras may have the keys length, legs, gaits, idle and capsule; delete or correct the others"
        raise BodyError(f"has unknown extras `{EXTRAS_KEY}`{path}", advice) from None
    return replace(
        body, length=form.length or 0.0, legs=build_legs(form.legs), gaits=build_gaits(form.gaits), idle=form.idle or "",
        capsule=None if form.capsule is None else build_capsule(form.capsule),
    )  # fmt: skip
