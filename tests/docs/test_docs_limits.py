"""The table of limits in docs/security.md says what `antdsl/limits.py` has."""

from __future__ import annotations

import re
from pathlib import Path

from antdsl import limits

PAGE = Path(__file__).resolve().parents[2] / "docs" / "security.md"
UNITS = {"": 1, "KiB": limits.KIB, "MiB": limits.MIB, "GiB": limits.GIB}


def test_the_limits_on_the_page_are_those_of_the_code() -> None:
    rows = re.findall(r"^\| [^|]+ \| ([0-9,]+) ?(\w*) \| `([A-Z_]+)` \|$", PAGE.read_text(encoding="utf-8"), re.M)
    assert len(rows) > 15
    for number, unit, name in rows:
        assert int(number.replace(",", "")) * UNITS[unit] == getattr(limits, name), name
