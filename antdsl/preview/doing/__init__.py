"""What is done for each thing that a page asks: one function each, called by the live thread between two steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from antdsl.preview import asks
from antdsl.preview.doing import asking, costs, edits, looking, time

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live

# By the kind of ask. A handler may raise Refusal; whatever else it raises is told as a bug and ends nothing.
HANDLERS: Mapping[type[Any], Callable[[Live, Any, Client], None]] = {
    asks.Play: time.play,
    asks.Pause: time.pause,
    asks.Step: time.step,
    asks.Speed: time.speed,
    asks.Seek: time.seek,
    asks.Restart: time.restart,
    asks.Set: edits.set_value,
    asks.Layer: edits.layer,
    asks.Field_: edits.field,
    asks.Reload: edits.reload,
    asks.Look: looking.look,
    asks.Explain: asking.explain,
    asks.Breaks: asking.breaks,
    asks.Profile: costs.profile,
}
WITHOUT_SESSION = frozenset([asks.Look, asks.Reload, asks.Speed])  # what can be asked while the scene has errors
