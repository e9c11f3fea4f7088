"""Parts of a manifest that contain no entries of other modules: values, lamps, and cameras of a scene."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Word = Annotated[str, Field(max_length=500)]
Triple = tuple[float, float, float]
Width = Annotated[float, Field(ge=0)]


class ManifestPart(BaseModel):
    """An object in the manifest. Unknown keys are ignored on reading."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, hide_input_in_errors=True)


class PeriodEntry(ManifestPart):
    """The box of a periodic world: its low corner and its widths, which are 0 along axes that do not wrap."""

    low: Triple
    widths: tuple[Width, Width, Width]


class LampEntry(ManifestPart):
    """A lamp: the strength of its light, and the colour of the light (display values); None for warm white."""

    power: Annotated[float, Field(ge=0)]
    colour: Triple | None = None


class LensEntry(ManifestPart):
    """The lens of a camera. `focal`: in mm, for a sensor 36 mm wide. `focus`: a distance in scene units, or an agent."""

    focal: float | None = None
    f_stop: Annotated[float, Field(gt=0)] | None = None
    focus: Annotated[float, Field(gt=0)] | Word | None = None


class CameraEntry(LensEntry):
    """A camera, with points in scene units. `moves`: whether `static.npz` contains the camera for each frame."""

    at: Triple
    look_at: Triple
    up: Triple | None = None
    moves: bool = False


class FollowEntry(LensEntry):
    """A camera that follows an agent, either close up or at the displacement `by` (scene units).

    `smooth`: the time before and after a frame, in seconds, over which the motion of the agent is averaged."""

    follow: Word
    by: Triple | None = None
    smooth: float | None = None
