"""A scene that is simulated while it is written: edited files take over from the running ones, and time can be turned back."""

from antdsl.preview.compiling import Compiler
from antdsl.preview.live import Busy, Client, Live
from antdsl.preview.session import Outcome, Session
from antdsl.preview.watch import Watch

__all__ = ["Busy", "Client", "Compiler", "Live", "Outcome", "Session", "Watch"]
