"""The folders that the user grants. Paths in calls are converted to absolute paths below one of these folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_MAX_PATH_CHARACTERS = 1000


class PathOutsideFolders(Exception):
    """Error for a path that is not below a granted folder. Its text is the message for the client."""


@dataclass(frozen=True, slots=True)
class GrantedFolders:
    """The folders that calls may read and write. `folders`: at least one absolute path without links."""

    folders: tuple[Path, ...]

    @staticmethod
    def open(paths: Sequence[Path]) -> GrantedFolders:
        """Return the granted folders for `paths`. Raises NotADirectoryError if one is not a folder."""
        for path in paths:
            if not path.is_dir():
                raise NotADirectoryError(f"there is no folder `{path}`")
        return GrantedFolders(tuple(dict.fromkeys(path.resolve() for path in paths)))

    def locate(self, text: str) -> Path:
        """Return the absolute path, with links resolved, of a path in a call.

        A relative path starts at the first granted folder that contains such a file, or else at the first granted folder. Raises
        PathOutsideFolders if the path leads out of the granted folders."""
        if not text or "\0" in text or len(text) > _MAX_PATH_CHARACTERS:
            raise PathOutsideFolders(f"a path has 1 to {_MAX_PATH_CHARACTERS} characters; write one such as `scene.yaml`")
        choices = [(folder / text).resolve() for folder in self.folders]
        allowed = [path for path in choices if any(path.is_relative_to(folder) for folder in self.folders)]
        if not allowed:
            names = ", ".join(f"`{folder}`" for folder in self.folders)
            raise PathOutsideFolders(f"`{text}` is outside the granted folders: write a path below {names}")
        return next((path for path in allowed if path.exists()), allowed[0])
