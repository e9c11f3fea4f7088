"""Notes of a scene: what agents do in some frames, whatever their program says. One model for each verb.

The verb is the first key of a note, and names the agents. All notes that move agents act within the limits of speed and turn,
contacts and obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Union

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.crowds.casting_model import FacingDirection
from antdsl.scene.flow_mistakes import explain_joined_entry
from antdsl.scene.notes.look_targets import LookTargets as LookTargets
from antdsl.scene.notes.note_regions import CurveOrPoints, NoteRegion
from antdsl.scene.notes.note_values import DEFAULT_EASE_FRAMES, SetValue, SpeedShare, ThinShare
from antdsl.scene.notes.note_values import FrameCount as FrameCount
from antdsl.scene.notes.note_values import FrameNumber as FrameNumber
from antdsl.scene.notes.note_values import ShareValue as ShareValue
from antdsl.scene.notes.selectors import AgentConditions as AgentConditions
from antdsl.scene.notes.selectors import AgentName, AnySelector, NearTarget, Selector, SelectorKeys, combine_selector
from antdsl.scene.notes.stagger import Stagger, StaggerValue
from antdsl.scene.values import (
    FrameRangeValue,
    PointValue,
    PositiveLength,
    SceneName,
    ScenePart,
    SceneWord,
    describe_value,
    make_value_error,
    parse_one_of,
)

_EDITS_HELP = "`kill`, `move` and other verbs that change a finished cache are those of `antdsl edit`"
NOTE_TAG_SUFFIX = "-note"  # of the tag of a verb's model
Target = PointValue | AgentName | FacingDirection


class Note(ScenePart):
    """The keys of all notes. The verb is the first key, and its value names the agents. `off`: `yes` switches the note off."""

    verb: ClassVar[str]

    agents: Selector
    off: Annotated[str, BeforeValidator(parse_one_of("yes", "no"))] = "no"

    @property
    def selector(self) -> AnySelector:
        """Return the selector of the note's agents: the value after the verb, limited by the conditions in the note's keys."""
        return combine_selector(self.agents, self) if isinstance(self, SelectorKeys) else self.agents

    @property
    def ease_frames(self) -> int:
        """Return the number of frames over which the note fades in, and over which it fades out."""
        return 0

    @property
    def played_clip(self) -> str:
        """Return the clip that the agents play. It is empty if they play the clips of their states."""
        return ""

    @property
    def looks(self) -> Mapping[str, Target]:
        """Return the targets at which parts of bodies look, by transform group."""
        return {}

    @property
    def delay_rule(self) -> Stagger | None:
        """Return the rule by which the note is delayed for each agent, or None if its frames are equal for all."""
        return None

    @property
    def first_frame(self) -> float:
        """Return the first frame in which the note holds completely. It begins `ease` frames earlier."""
        return -inf

    @property
    def last_frame(self) -> float:
        """Return the last frame in which the note holds completely. It ends `ease` frames later."""
        return inf


class StaggeredNote(Note):
    """A note that holds in certain frames. `stagger`: delays these frames for some agents more than for others."""

    stagger: StaggerValue | None = None

    @property
    def delay_rule(self) -> Stagger | None:
        return self.stagger

    @model_validator(mode="after")
    def _check_stagger(self) -> StaggeredNote:
        if self.stagger is None or isfinite(self.first_frame if self.last_frame == inf else self.last_frame):
            return self
        raise make_value_error("`stagger` has no effect without `frames`", "add `frames: 100..150`")


class EasedNote(StaggeredNote):
    """A note that begins and ends smoothly. `ease`: the number of frames in which the note fades in, and in which it fades
    out."""

    ease: FrameCount = DEFAULT_EASE_FRAMES

    @property
    def ease_frames(self) -> int:
        return self.ease


class TimedNote(EasedNote):
    """A note that holds for a time. `frames`: the frames in which the note has its full effect; by default all."""

    frames: FrameRangeValue | None = None

    @property
    def first_frame(self) -> float:
        return -inf if self.frames is None else self.frames.first

    @property
    def last_frame(self) -> float:
        return inf if self.frames is None else self.frames.last


class PassingNote(TimedNote):
    """A note that can apply to a part of the world only. `inside`: the region in which the note has an effect; by default
    everywhere."""

    inside: NoteRegion | None = None


class HoldNote(TimedNote, SelectorKeys):
    """The agents stand still, with their feet in place. Contacts do not push them.

    `look_at`: for each part of the body, what it looks at. `play`: the clip that the agents play meanwhile."""

    verb = "hold"
    agents: Selector = Field(alias="hold")
    look_at: LookTargets = Field(default_factory=dict)
    play: SceneName | None = None

    @property
    def played_clip(self) -> str:
        return self.play or ""

    @property
    def looks(self) -> Mapping[str, Target]:
        return self.look_at


class LookNote(PassingNote, SelectorKeys):
    """The agents turn parts of their bodies towards points, items, agents, cameras or meshes, or in a direction."""

    verb = "look"
    agents: Selector = Field(alias="look")
    at: Annotated[LookTargets, Field(min_length=1)]

    @property
    def looks(self) -> Mapping[str, Target]:
        return self.at


class PlayNote(PassingNote, SelectorKeys):
    """The agents play this clip instead of the clips of their states."""

    verb = "play"
    agents: Selector = Field(alias="play")
    clip: SceneName

    @property
    def played_clip(self) -> str:
        return self.clip


class SetNote(PassingNote, SelectorKeys):
    """Attributes of the agents change to these values, numbers smoothly. They then stay until the program changes them."""

    verb = "set"
    agents: Selector = Field(alias="set")
    to: Annotated[dict[SceneName, SetValue], Field(min_length=1)]


class ChangeNote(StaggeredNote, SelectorKeys):
    """The agents change to this state in the frame `frame`. Their program decides when they leave it."""

    verb = "change"
    agents: Selector = Field(alias="change")
    to: SceneWord
    frame: FrameNumber

    @property
    def first_frame(self) -> float:
        return self.frame

    @property
    def last_frame(self) -> float:
        return self.frame


class RetimeNote(TimedNote, SelectorKeys):
    """The agents move at this percentage of their speed."""

    verb = "retime"
    agents: Selector = Field(alias="retime")
    speed: SpeedShare


class ReleaseNote(EasedNote, SelectorKeys):
    """The agents stand still until the frame `frame`, and then begin to move."""

    verb = "release"
    agents: Selector = Field(alias="release")
    frame: FrameNumber

    @property
    def last_frame(self) -> float:
        return self.frame - 1


class ReachNote(EasedNote, SelectorKeys):
    """The agents arrive at the target in this frame; they touch an item or agent. Each leaves as late as it can without
    haste.

    `along`: a curve instead of a `target`. The agents spread evenly over it, in their order along the curve."""

    verb = "reach"
    agents: Selector = Field(alias="reach")
    target: NearTarget | None = None
    along: CurveOrPoints | None = None
    frame: FrameNumber

    @model_validator(mode="after")
    def _check_target(self) -> ReachNote:
        if (self.target is None) == (self.along is None):
            raise make_value_error("`reach` needs either `target` or `along`", "add `target: [0, 0, 0]`, or remove one of them")
        return self

    @property
    def last_frame(self) -> float:
        return self.frame


class PathNote(EasedNote, SelectorKeys):
    """The agents walk along a curve or through points. They are at the beginning in the first frame, and at the end in the
    last.

    `apart`: the distance from each agent to the one before it, in the order of their ids."""

    verb = "path"
    agents: Selector = Field(alias="path")
    along: CurveOrPoints
    frames: FrameRangeValue
    spacing: PositiveLength | None = Field(None, alias="apart")

    @property
    def last_frame(self) -> float:
        return self.frames.last


class RegionNote(TimedNote):
    """A note about a part of the world.

    `in`: the region, which is a box, a ball, a band along a curve, or a view. A ball around an agent moves with it.
    `falloff`: the distance outside of the region over which the effect decreases to 0.
    `strength`: how much of what the agents want to do the note replaces, from 0 to 100 %.
    `painted`: a map with values from 0 to 1, by which the strength is multiplied."""

    region: NoteRegion | None = Field(None, alias="in")
    falloff: PositiveLength | None = None
    strength: ShareValue = 1.0
    painted: SceneName | None = None

    @model_validator(mode="after")
    def _check_falloff(self) -> RegionNote:
        if self.falloff is not None and self.region is None and not isinstance(self, LaneNote):
            raise make_value_error("`falloff` has no effect without `in`", "add `in: {around: [0, 0, 0], radius: 50 mm}`")
        return self


class SlowNote(RegionNote):
    """The agents move at this percentage of their speed while they are in a region."""

    verb = "slow"
    agents: Selector = Field(alias="slow")
    speed: SpeedShare = 0.5


class ForbidNote(RegionNote):
    """The agents do not enter a region. Agents inside the region leave it."""

    verb = "forbid"
    agents: Selector = Field(alias="forbid")
    region: NoteRegion = Field(alias="in")


class ConfineNote(RegionNote):
    """The agents do not leave a region. Agents outside the region walk into it."""

    verb = "confine"
    agents: Selector = Field(alias="confine")
    region: NoteRegion = Field(alias="in")


class AttractNote(RegionNote):
    """The agents walk towards points, items, cameras, meshes or other agents. Beyond half of `radius`, the effect fades out."""

    verb = "attract"
    agents: Selector = Field(alias="attract")
    target: NearTarget = Field(alias="to")
    radius: PositiveLength | None = None


class RepelNote(RegionNote):
    """The agents walk away from points, items, cameras, meshes or other agents. Beyond half of `radius`, the effect fades
    out."""

    verb = "repel"
    agents: Selector = Field(alias="repel")
    target: NearTarget = Field(alias="from")
    radius: PositiveLength


class LaneNote(RegionNote):
    """The agents walk along a curve, in a lane of this `width`. `falloff`: the width of the soft border outside of the lane."""

    verb = "lane"
    agents: Selector = Field(alias="lane")
    along: CurveOrPoints
    width: PositiveLength


class PartNote(TimedNote, SelectorKeys):
    """The agents make way for a mesh, an item, a camera or other agents. They keep this `distance` from its outline, seen
    from above, and from its path."""

    verb = "part"
    agents: Selector = Field(alias="part")
    thing: Selector = Field(alias="for")
    distance: PositiveLength


class WithoutNote(Note, SelectorKeys):
    """These agents do not exist in the run. Conditions about positions apply to the start of each agent."""

    verb = "without"
    without: ClassVar[None] = None  # type: ignore[misc]  # the key is the verb
    agents: Selector = Field(alias="without")


class ThinNote(Note, SelectorKeys):
    """Only a percentage of the selected agents exists in the run."""

    verb = "thin"
    agents: Selector = Field(alias="thin")
    to: ThinShare


NOTE_MODELS: dict[str, type[Note]] = {model.verb: model for model in (
    HoldNote, LookNote, PlayNote, SetNote, ChangeNote, RetimeNote, ReleaseNote, ReachNote, PathNote, SlowNote, ForbidNote,
    ConfineNote, AttractNote, RepelNote, LaneNote, PartNote, WithoutNote, ThinNote,
)}  # fmt: skip


GOAL_VERBS = frozenset((ReachNote.verb, PathNote.verb))  # agents may be too far away to do as these say


def make_note_tag(verb: str) -> str:
    """Return the tag by which pydantic selects the model for a verb. pydantic puts this tag last in the location of an error."""
    return f"{verb}{NOTE_TAG_SUFFIX}"


def _find_note_tag(value: Any) -> str:
    return make_note_tag(next(iter(value))) if isinstance(value, dict) and value else make_note_tag(HoldNote.verb)


def _check_verb(value: Any) -> Any:
    """Return a value unchanged. Raises an error if its first key is not a verb."""
    if not isinstance(value, dict):
        joined = explain_joined_entry(value) if isinstance(value, str) else None
        words = f"{describe_value(value)} is not a note" if joined is None else joined[0]
        raise make_value_error(words, "write `{hold: guards, frames: 10..20}`" if joined is None else joined[1])
    verb = next(iter(value), "")
    if verb in NOTE_MODELS:
        return value
    known = next((key for key in value if key in NOTE_MODELS), None)
    if known is not None:
        raise make_value_error(f"`{verb}` comes before the verb of this note", f"write `{{{known}: {value[known]}, {verb}: …}}`")
    near, listed = find_nearest_name(str(verb), NOTE_MODELS), ", ".join(f"`{each}`" for each in NOTE_MODELS)
    help = f"did you mean `{near}`?" if near else f"write one of {listed}; {_EDITS_HELP}"
    raise make_value_error(f"`{verb}` is not a verb of notes", help)


if TYPE_CHECKING:
    AnyNote = Note
else:
    _FORMS = tuple(Annotated[model, Tag(make_note_tag(verb))] for verb, model in NOTE_MODELS.items())
    AnyNote = Annotated[Union[(*_FORMS,)], Discriminator(_find_note_tag), BeforeValidator(_check_verb)]
