"""A search for the known name that is most similar to an unknown one, for `did you mean …`."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def find_nearest_name(word: str, candidates: Iterable[str]) -> str | None:
    """Return the candidate most similar to `word`, or None if none is similar enough to be a typing error.

    Ties go to the first name in sort order, so that the result does not depend on the order of the candidates."""
    names = sorted(set(candidates) - {word})
    lowered = word.lower()
    for name in names:
        if name.lower().replace("_", "") == lowered.replace("_", ""):
            return name
    for name in names:  # two letters swapped
        if sorted(name.lower()) == sorted(lowered):
            return name
    # in a word of fewer than four letters, one wrong letter is a large part, so a larger difference is allowed
    cutoff = 0.5 if len(word) <= 3 else 0.65
    matches = get_close_matches(word[:64], names, n=1, cutoff=cutoff)
    return matches[0] if matches else None
