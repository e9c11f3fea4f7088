"""Parameters of which a sample is run each time, and the others with `pytest -m slow`."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def sampled(values: Iterable[Any], sample: Collection[Any]) -> list[Any]:
    """All values, those that are not in the sample marked slow. KeyError where the sample has one that there is not."""
    all_values = list(values)
    if missing := [each for each in sample if each not in all_values]:
        raise KeyError(missing)
    return [each if each in sample else pytest.param(each, marks=pytest.mark.slow) for each in all_values]
