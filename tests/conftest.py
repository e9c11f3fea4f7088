"""`pytest --update` writes golden files anew instead of comparing with them; the difference is for a person to read."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update", action="store_true", default=False, help="write golden files anew")
