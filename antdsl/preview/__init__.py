"""The preview: simulates a scene while its files are edited. Edited files replace the running ones, and time can go back."""

from antdsl.preview.compiling import Compiler
from antdsl.preview.file_watch import FileWatch
from antdsl.preview.live import Client, Live, QueueFull
from antdsl.preview.outcomes import Outcome
from antdsl.preview.session import Session

__all__ = ["Client", "Compiler", "FileWatch", "Live", "Outcome", "QueueFull", "Session"]
