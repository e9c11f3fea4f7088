"""The page of topics has all twelve that the document on agent primitives ends with, each with something that is run."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = (Path(__file__).parents[2] / "docs" / "crowd_topics.md").read_text(encoding="utf-8")
TOPICS = (
    "Basics", "Setup", "Agents", "States", "Triggers", "Caches", "Diversity", "Attaching cloth", "Foot planting", "Terrain",
    "Obstacles", "Crowd Procedural",
)  # fmt: skip


def test_each_topic_has_a_row_and_a_sample_that_is_run() -> None:
    assert re.findall(r"^\| (\w[^|]*) \|", PAGE, flags=re.M)[1:] == list(TOPICS)
    parts = dict(re.findall(r"^## ([^\n]*)\n(.*?)(?=^## |\Z)", PAGE, flags=re.M | re.S))
    assert tuple(parts) == TOPICS
    for topic, text in parts.items():
        assert re.search(r"^```(console run|ant )", text, flags=re.M), topic
