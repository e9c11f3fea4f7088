"""One edit of a cache: a view of the cache below it, in which the selected agents are changed."""

from __future__ import annotations

from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

from numpy.typing import NDArray
from pydantic import BeforeValidator, model_validator

from antdsl.outputs.cache.cache_reader import Arrays, Cache, CacheError, CacheView, make_frame_path, select_arrays
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.edits.cache_selection import Selection
from antdsl.outputs.edits.verbs.terrain import Ground
from antdsl.scene.notes.selectors import AnySelector, Selector, SelectorKeys, combine_selector, needs_frame
from antdsl.scene.values import FrameRangeValue, ScenePart, make_value_error, parse_one_of


class EditLine(ScenePart):
    """One line of `edits:`. The verb is the first key.

    `frames`: the frames in which the edit applies; all by default.
    `off`: the line has no effect."""

    verb: ClassVar[str]
    frames: FrameRangeValue | None = None
    off: Annotated[str, BeforeValidator(parse_one_of("yes", "no"))] = "no"

    def list_files(self, manifest: Manifest) -> tuple[EditFile, ...]:
        """Return the files that the line names and that the cache does not contain."""
        return ()

    def list_items(self) -> tuple[tuple[tuple[str, ...], str], ...]:
        """Return the names of items in the line outside selectors, as (keys that lead to the name, name)."""
        return ()


class EditFile(NamedTuple):
    """A file that a line names as the value of `key`. `kind`: whether it is a mesh, a body or a cache."""

    key: str
    path: str
    kind: Literal["mesh", "body", "cache"]


class AgentsLine(EditLine, SelectorKeys):
    """A line that changes some agents. `agents`: the value of the verb; the keys of selectors select fewer of them.

    `ever`: agents that meet the conditions in any of these frames, instead of the first frame of the line."""

    agents: Selector
    ever: FrameRangeValue | None = None

    @model_validator(mode="after")
    def _check_ever(self) -> AgentsLine:
        if self.ever is not None and not needs_frame(self.selector):
            raise make_value_error(
                "`ever` has no effect without a condition on places or states",
                ("add such a condition, for example `in_view: shot`"),
            )
        return self

    @property
    def selector(self) -> AnySelector:
        """Return the selector of the agents that the line changes."""
        return combine_selector(self.agents, self)


@dataclass(frozen=True, slots=True, eq=False)
class EditInputs:
    """The inputs of edits other than their lines and the cache.

    `ground`: the ground of the cache. `arrays`: meshes and bodies from files. `caches`: other caches, by their paths in the text.
    `next_ids`: by species, the first id that no agent of the run has."""

    ground: Ground | None = None
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    caches: Mapping[str, Cache] = field(default_factory=dict)
    next_ids: Mapping[str, int] = field(default_factory=dict)


class NotEditable(Exception):
    """Error for a cache that cannot be edited. The message is a complete explanation."""


@dataclass(frozen=True, eq=False)
class EditLayer(CacheView):
    """A view of a cache with one edit. Subclasses define how the edit changes frames.

    `required_arrays`: arrays that frames must contain. `stored_frames`: the number of frames of the cache below that are cached
    in memory, for edits that read several frames to change one."""

    line: Any
    inputs: EditInputs
    required_arrays: ClassVar[tuple[str, ...]] = ("id", "P")
    stored_frames: ClassVar[int] = 0

    @classmethod
    def of(cls, source: Cache, *values: Any) -> Self:
        """Return a view of a cache. `values`: the line of the edit, and its inputs.

        Raises NotEditable if frames lack a required array, or if the edit is not possible for the cache."""
        line, inputs = values
        for name in cls.required_arrays:
            if name not in source.manifest.attributes:
                raise NotEditable(f"the cache has no attribute `{name}`, which edits such as `{line.verb}` need")
        below = StoredFrames.of(source, cls.stored_frames) if cls.stored_frames else source
        return cls(source.folder, cls.change_manifest(source.manifest, line, inputs), below, line, inputs)

    @classmethod
    def change_manifest(cls, manifest: Manifest, line: Any, inputs: EditInputs) -> Manifest:
        """Return the manifest of the cache with the edit. Raises NotEditable if the edit is not possible for the cache."""
        return manifest

    def pass_inputs(self) -> EditInputs:
        """Return the inputs for the next edit, which reads this view."""
        return self.inputs

    @cached_property
    def first_frame(self) -> int:
        """Return the first frame of the edit. Selectors read positions and states in this frame."""
        frames = self.source.frames()
        return max(self.line.frames.first, self.manifest.first) if self.line.frames else min(frames, default=self.manifest.first)

    @cached_property
    def selection(self) -> Selection:
        """Return the selection of the agents that the edit changes."""
        ever = self.line.ever
        last = self.first_frame if ever is None else ever.last
        return Selection(self.line.selector, self.source, self.first_frame if ever is None else ever.first, last)

    def is_active(self, number: int) -> bool:
        """Return whether the edit changes frame `number`."""
        frames = self.line.frames
        return frames is None or frames.first <= number <= frames.last

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame with the edit. `names`: the arrays to return; None for all."""
        if not self.is_active(number):
            return self.source.frame(number, names)
        arrays = self.source.frame(number)
        for name in self.required_arrays:
            if name not in arrays or len(arrays[name]) != len(arrays["id"]):
                raise CacheError(f"`{make_frame_path(self.folder, number)}` has no `{name}` of each agent, which edits need")
        return select_arrays(self.change_frame(number, arrays), names)

    @abstractmethod
    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return the arrays of a frame with the edit. `arrays`: the arrays of the frame without it, which must not be changed in
        place."""


@dataclass(frozen=True, eq=False)
class StoredFrames(CacheView):
    """A view of a cache that stores the most recently read `capacity` frames in memory."""

    capacity: int
    _frames: OrderedDict[int, Arrays] = field(default_factory=OrderedDict, init=False)

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame. `names`: the names to return; None for all."""
        if number in self._frames:
            self._frames.move_to_end(number)
        else:
            self._frames[number] = self.source.frame(number)
            if len(self._frames) > self.capacity:
                self._frames.popitem(last=False)
        return select_arrays(self._frames[number], names)
