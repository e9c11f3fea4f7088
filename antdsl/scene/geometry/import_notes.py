"""What reading a mesh file left out, cut up or joined: a report for the person who imports it."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class Skipped:
    """Something in a file that is not read: how often, and the line of the first, where the file has lines."""

    what: str
    count: int = 0
    line: int | None = None


@dataclass(slots=True)
class ImportNotes:
    """Notes on one mesh file, in the order of its reading. `cut` polygons had more than three corners, `concave` of them needed more
    than a fan; `crossing` cut or cover themselves, the first of them is the face `crossing_face`."""

    form: str = ""
    vertices: int = 0
    triangles: int = 0
    cut: int = 0
    concave: int = 0
    crossing: int = 0
    crossing_face: int = 0
    skipped: dict[str, Skipped] = field(default_factory=dict)

    def skip(self, what: str, count: int = 1, line: int | None = None) -> None:
        """Count something that is not read."""
        if not count:
            return
        if what not in self.skipped:
            if len(self.skipped) >= 100:
                what = "other content"
            self.skipped.setdefault(what, Skipped(what, 0, line))
        self.skipped[what].count += count

    def skipped_words(self) -> list[str]:
        """Phrases such as `3 × `l` (line 8)`."""
        return [
            (f"{each.count:,} × " if each.count > 1 else "") + each.what + ("" if each.line is None else f" (line {each.line:,})")
            for each in self.skipped.values()
        ]
