"""The values of notes that say what parts of bodies look at: targets or directions, by transform group."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Tag

from antdsl.scene.crowds.casting_model import FacingDirection
from antdsl.scene.notes.selectors import NearTarget
from antdsl.scene.values import SceneName, describe_value, make_value_error

_Direction = Annotated[FacingDirection, Tag("direction")]
_NearTarget = Annotated[NearTarget, Tag("near")]
_LookTarget = Annotated[_Direction | _NearTarget, Discriminator(lambda value: "direction" if isinstance(value, dict) else "near")]


def _require_parts(value: Any) -> Any:
    if isinstance(value, str | list):
        text = value if isinstance(value, str) else "[0, 100, 0]"
        raise make_value_error(
            f"{describe_value(value)} does not say which part of the body looks", f"write `{{head: {text[:40]}}}`"
        )
    return value


LookTargets = Annotated[dict[SceneName, _LookTarget], BeforeValidator(_require_parts)]
