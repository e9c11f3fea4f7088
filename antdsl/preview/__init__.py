"""The preview: it simulates a scene while its files are edited. Edited files replace the loaded ones, and the user can go back
in time."""

from antdsl.preview.compiling import SceneCompiler
from antdsl.preview.file_watch import FileWatch
from antdsl.preview.live import Client, LiveSimulation, QueueFullError
from antdsl.preview.outcomes import EditOutcome
from antdsl.preview.session import PreviewSession

__all__ = ["Client", "EditOutcome", "FileWatch", "LiveSimulation", "PreviewSession", "QueueFullError", "SceneCompiler"]
