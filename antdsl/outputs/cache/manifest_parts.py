"""Objects of a manifest that depend on no other ones: values, lamps, and cameras of a scene."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Word = Annotated[str, Field(max_length=500)]
Triple = tuple[float, float, float]
Width = Annotated[float, Field(ge=0)]


class ManifestPart(BaseModel):
    """An object of the manifest. Unknown keys are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, hide_input_in_errors=True)


class PeriodEntry(ManifestPart):
    """The box of a periodic world: its low corner, and its widths, 0 along axes that do not wrap."""

    low: Triple
    widths: tuple[Width, Width, Width]


class LampEntry(ManifestPart):
    """The strength of a thing of the kind `lamp`, and the colour of its light (display values); None for warm white."""

    power: Annotated[float, Field(ge=0)]
    colour: Triple | None = None


class LensEntry(ManifestPart):
    """The lens of a camera. `focal`: in mm for a sensor 36 mm wide. `focus`: a distance in scene units, or an agent."""

    focal: float | None = None
    f_stop: Annotated[float, Field(gt=0)] | None = None
    focus: Annotated[float, Field(gt=0)] | Word | None = None


class CameraEntry(LensEntry):
    """A camera, with points in scene units. `moves`: whether `static.npz` has the camera at each frame."""

    at: Triple
    look_at: Triple
    up: Triple | None = None
    moves: bool = False


class FollowEntry(LensEntry):
    """A camera that follows an agent, at the displacement `by` in scene units, or close to it.

    `smooth`: the time in seconds over which the agent's motion is averaged, before and after a frame."""

    follow: Word
    by: Triple | None = None
    smooth: float | None = None
