"""Editions of the language. The first line of a file names the file's edition, which determines the defaults."""

from __future__ import annotations

EDITIONS = (1, 2)
NEWEST_EDITION = EDITIONS[-1]  # the edition of a file that names none
FIRST_LINE = f"ant {NEWEST_EDITION}"
FIRST_LINE_ADVICE = f"write `{FIRST_LINE}` as the first line"
UNKNOWN_EDITION_ADVICE = f"write `{FIRST_LINE}`, or install a newer antdsl"
