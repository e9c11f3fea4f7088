"""The regions of notes: boxes, balls, bands along curves, and views of cameras."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag

from antdsl import limits
from antdsl.scene.notes.selectors import AgentConditions as AgentConditions
from antdsl.scene.notes.selectors import Box, NearTarget, Selector, View, require_region
from antdsl.scene.values import PointValue, PositiveLength, SceneName, ScenePart, describe_value, make_value_error


def _find_curve_tag(value: Any) -> str:
    return "points" if isinstance(value, list) else "curve-name"


def _require_curve(value: Any) -> Any:
    """Return a value unchanged. Raises an error, which pydantic reports, for a list without points."""
    if isinstance(value, dict) or (isinstance(value, list) and not all(isinstance(each, list) for each in value)):
        raise make_value_error(f"{describe_value(value)} is not a curve", "write its name, or points: `[[0, 0, 0], [50, 0, 0]]`")
    return value


def _require_line(value: Any) -> Any:
    """Return a value unchanged. Raises an error, which pydantic reports, for a single point."""
    names = [str(each)[:1].isalpha() for each in value] if isinstance(value, list) else []
    return value if any(names) else _require_curve(value)


CurveOrPoints = Annotated[
    Annotated[tuple[PointValue, ...], Field(min_length=2, max_length=limits.MAX_NOTE_POINTS), Tag("points")]
    | Annotated[SceneName, Tag("curve-name")],
    Discriminator(_find_curve_tag),
    BeforeValidator(_require_curve),
]


_CurveOrTargets = Annotated[
    Annotated[tuple[NearTarget, ...], Field(min_length=2, max_length=limits.MAX_NOTE_POINTS), Tag("points")]
    | Annotated[SceneName, Tag("curve-name")],
    Discriminator(_find_curve_tag),
    BeforeValidator(_require_line),
]


def _find_centre_tag(value: Any) -> str:
    """Return the kind of a centre. A list of names means agents; any other list is a point."""
    is_point = isinstance(value, list) and not all(isinstance(each, dict) or str(each)[:1].isalpha() for each in value)
    return "point" if is_point else "agents-or-item"


_RegionCentre = Annotated[
    Annotated[PointValue, Tag("point")] | Annotated[Selector, Tag("agents-or-item")], Discriminator(_find_centre_tag)
]


class NoteBall(ScenePart):
    """All points within the distance `radius` of a point, an item, the nearest of several items, a camera, a mesh, or agents.
    The ball moves with what it surrounds."""

    around: _RegionCentre
    radius: PositiveLength


class Band(ScenePart):
    """All points that are at most half of `width` away from a curve, or from a line through points, items, agents, cameras
    and meshes."""

    along: _CurveOrTargets
    width: PositiveLength


_REGION_KINDS = {"along": "band", "width": "band", "around": "ball", "radius": "ball", "in_view": "view"}  # by key


def _find_region_tag(value: Any) -> str:
    keys = value if isinstance(value, dict) else ()
    return next((f"{kind}-region" for key, kind in _REGION_KINDS.items() if key in keys), "box-region")


NoteRegion = Annotated[
    Annotated[Box, Tag("box-region")]
    | Annotated[NoteBall, Tag("ball-region")]
    | Annotated[Band, Tag("band-region")]
    | Annotated[View, Tag("view-region")],
    Discriminator(_find_region_tag),
    BeforeValidator(require_region),
]
