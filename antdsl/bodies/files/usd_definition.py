"""Reads a USD file as an agent definition: sends a request to the reader's process and checks the answer."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from typing import Any

from antdsl.bodies.agents.definition import BodyError, Definition
from antdsl.bodies.agents.packed import ARRAY_NAMES, unpack_definition
from antdsl.bodies.files.gltf.gltf_clips import apply_settings, read_settings
from antdsl.reader.protocol import ProtocolError, ReaderMessage, RefusalError, clean_for_display
from antdsl.scene.geometry.usd import UsdError, open_stage
from antdsl.scene.paths import Roots

_MAX_OMISSION_SENTENCES = 10_000


def read_usd(roots: Roots, text: str, prim: str, name: str, rate: float) -> tuple[Definition, list[str]]:
    """Return the definition at and below a prim of a file, and sentences about parts that are not read. `rate`: samples per
    second of animations; 0 means the stage's own rate. Raises UsdError or BodyError if there is no definition."""
    stage = open_stage(roots, text, prim, up="y", frames=range(1), fps=Fraction(24))
    try:
        answer = stage.send_request("usd-body", {"name": name, "rate": rate})
        left_out = [clean_for_display(sentence) for sentence in answer.require_texts("left_out", _MAX_OMISSION_SENTENCES)]
        settings = _read_clip_settings(answer)
        if set(answer.arrays) != set(ARRAY_NAMES):
            raise ProtocolError("a part of the body is missing")
    except UsdError:
        raise
    except RefusalError as error:
        raise BodyError(str(error), error.help, error.code) from None
    except ProtocolError as error:
        raise stage.make_answer_error(error) from None
    definition = unpack_definition(answer.arrays)
    known = {name: each for name, each in settings.items() if name in definition.clips}
    clips = {
        name: apply_settings(definition.clips[name], read_settings(each, "customData", name)) for name, each in known.items()
    }
    return replace(definition, clips={**definition.clips, **clips}), left_out


def _read_clip_settings(answer: ReaderMessage) -> dict[str, Any]:
    """Return the custom data of each animation, by clip name."""
    try:
        settings = json.loads(answer.document["settings"])
    except (KeyError, TypeError, ValueError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise ProtocolError("the settings of clips are missing")
    return settings
