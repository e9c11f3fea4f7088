"""Settling of edited frames: the agents that edits affect are simulated again. The work is done in short parts between
requests."""

from __future__ import annotations

from collections.abc import Iterator
from time import monotonic

from antdsl.bodies.agents.definition import BodyError
from antdsl.explain import ExplainError
from antdsl.outputs.cache.cache_reader import CacheError
from antdsl.outputs.edits.edit_layer import NotEditable
from antdsl.outputs.edits.side_effects import SideEffects
from antdsl.preview.directing.hand_edits import EditedRunView
from antdsl.preview.observing.explainer import StretchHistory
from antdsl.settling.resimulation import NOTHING_TO_SETTLE, EditSettling, SettlingError

_MAX_SECONDS = 0.02  # after this time, settling gives way to requests and steps
_CHANGED_TEXT = "the edits or the frames have changed: settle again"


class HandSettling:
    """The settling of a session's edited frames: agents that edits affect are simulated again.

    `is_running`: whether there is work left. `report`: lines of text for pages about the progress or the result."""

    def __init__(self, edited: EditedRunView) -> None:
        self.edited = edited
        self._report: tuple[str, ...] = ()
        self._work: Iterator[str] | None = None
        self._inputs: object = None  # of the frames for which the report and the work are

    @property
    def is_running(self) -> bool:
        return self._work is not None

    @property
    def report(self) -> tuple[str, ...]:
        """Return lines of text about the progress or the result; none after the edits or the frames have changed."""
        is_outdated = bool(self._report) and self._inputs != self.edited.describe_inputs()
        return (_CHANGED_TEXT,) if is_outdated else self._report

    def start(self) -> None:
        """Start to settle the frames that exist now."""
        self.stop()
        self._inputs, self._work, self._report = self.edited.describe_inputs(), self._run(), ("settling",)

    def stop(self) -> None:
        """Stop settling, and remove the settled agents."""
        self.edited.store_settled_frames(None, None)
        self._work, self._report = None, ()

    def advance(self) -> None:
        """Do the next part of the work."""
        end = monotonic() + _MAX_SECONDS
        while self._work is not None and monotonic() < end:
            if self._inputs != self.edited.describe_inputs():
                self._work = None
                return
            try:
                self._report = (f"settling: {next(self._work)}",)
            except StopIteration:
                self._work = None
            except (SettlingError, ExplainError) as why:
                self._work, self._report = None, tuple(text for text in (f"not settled: {why}", why.help) if text)
            except (NotEditable, BodyError, CacheError) as why:
                self._work, self._report = None, (f"not settled: {why}",)

    def _run(self) -> Iterator[str]:
        """Settle the frames, display the result and set the report. After each frame, yield a text about the progress."""
        frames, next_ids, attributes = self.edited.open_frames_to_settle()
        settling = EditSettling(frames, self._open_history, next_ids, attributes)
        yield from settling.run_rounds()
        settlement = settling.settlement
        self.edited.store_settled_frames(self._inputs, None if settlement is None else settlement.frames)
        side_effects = SideEffects(self.edited.find_view() or frames)
        for number in side_effects.examine():
            yield f"frame {number} is examined"
        text = NOTHING_TO_SETTLE if settlement is None else settlement.describe_result()
        self._report = (text, *(f"warning: {message}" for message in side_effects.messages))

    def _open_history(self, frame: int) -> StretchHistory:
        """Return the history that contains `frame` and all later frames. Raises SettlingError if several programs simulated
        them."""
        stretch = self.edited.session.timeline.stretches[-1]
        if stretch.first > frame:
            raise SettlingError(
                f"edits affect agents from frame {frame} on, and another program or other notes simulated the frames before "
                f"{stretch.first}",
                "simulate again from the first frame, then settle",
            )
        return StretchHistory(self.edited.session, stretch)
