"""The forms in which a `scene.yaml` can define a camera, each as a pydantic model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Discriminator, Tag

from antdsl import limits
from antdsl.scene.notes.selectors import AgentName, parse_agent_name
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import (
    FilePath,
    PointValue,
    PositiveLength,
    PositiveTime,
    SceneName,
    ScenePart,
    SceneWord,
    make_value_error,
    parse_integer_between,
    parse_number_between,
    parse_one_of,
)

DEFAULT_CAMERA_NAME = "shot"  # the name of the camera that pictures have by default
F_STOP_RANGE = 0.1, 10_000.0
CAMERA_VIEWS = ("scene", "fit", "above", "top", "eye", "close")  # words of `render --camera` that name no camera of the scene


class CameraKey(ScenePart):
    """The camera at one frame. It moves evenly from one key to the next, and does not move before the first key and after the
    last."""

    at: PointValue | None = None
    look_at: PointValue | None = None
    focal: PositiveLength | None = None


FrameNumber = Annotated[int, BeforeValidator(parse_integer_between(-limits.MAX_FRAMES, limits.MAX_FRAMES * 1000))]


CameraKeys = dict[FrameNumber, CameraKey]


def _parse_single_agent(value: Any) -> AgentName:
    name = parse_agent_name(value)
    if name.first is None or name.last != name.first:
        raise make_value_error(f"`{name}` is not a single agent", f"write `{name.name}.{name.first or 0}`")
    return name


def _find_focus_tag(value: Any) -> str:
    return "focus-agent" if isinstance(value, str) and value[:1].isalpha() else "focus-distance"


_SingleAgent = Annotated[AgentName, BeforeValidator(_parse_single_agent)]
if TYPE_CHECKING:
    FocusValue = Quantity | AgentName
else:
    FocusValue = Annotated[
        Annotated[PositiveLength, Tag("focus-distance")] | Annotated[_SingleAgent, Tag("focus-agent")],
        Discriminator(_find_focus_tag),
    ]


class LensCamera(ScenePart):
    """The lens of a camera.

    `f_stop`: the focal length divided by the diameter of the lens. Without it, everything is sharp.
    `focus`: a distance, or an agent, that is sharp. By default, what the camera looks at is sharp."""

    focal: PositiveLength | None = None
    f_stop: Annotated[float, BeforeValidator(parse_number_between(*F_STOP_RANGE))] | None = None
    focus: FocusValue | None = None


class PlacedCamera(LensCamera):
    """A camera at a fixed or moving position that looks at a point. `keys`: the values that change, by frame."""

    at: PointValue
    look_at: PointValue
    keys: CameraKeys = {}


class UsdCamera(ScenePart):
    """A camera from a USD file, with its motion."""

    usd: FilePath
    prim: SceneWord


class FollowCamera(LensCamera):
    """A camera that moves along with one agent, but does not turn with it.

    `follow`: the agent, such as `guards.17`.
    `by`: the position of the camera relative to the agent. By default, `render` chooses it as for `--camera close`.
    `smooth`: the time before and after each frame over which the agent's motion is averaged."""

    follow: _SingleAgent
    by: PointValue | None = None
    smooth: PositiveTime | None = None


FitWord = Annotated[str, BeforeValidator(parse_one_of("fit"))]
CAMERA_MODEL_BY_TYPE_TAG: dict[str, type[ScenePart]] = {
    "camera-here": PlacedCamera, "usd-camera": UsdCamera, "follow-camera": FollowCamera,
}  # fmt: skip


def _find_camera_type_tag(value: Any) -> str:
    if isinstance(value, str):
        return "camera-word"
    return next((f"{key}-camera" for key in ("usd", "follow") if isinstance(value, dict) and key in value), "camera-here")


if TYPE_CHECKING:
    CameraValue = PlacedCamera | UsdCamera | FollowCamera | str
else:
    CameraValue = Annotated[
        Annotated[PlacedCamera, Tag("camera-here")]
        | Annotated[UsdCamera, Tag("usd-camera")]
        | Annotated[FollowCamera, Tag("follow-camera")]
        | Annotated[FitWord, Tag("camera-word")],
        Discriminator(_find_camera_type_tag),
    ]
Cameras = dict[SceneName, CameraValue]
