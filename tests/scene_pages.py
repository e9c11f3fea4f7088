"""The pages of docs/ that describe scenes."""

from __future__ import annotations

from pathlib import Path

_DOCS = Path(__file__).resolve().parents[1] / "docs"
_NAMES = ("scene", "scene_world", "scene_crowd", "flows", "cameras", "walking", "contacts", "periodic")
SCENE_PAGES = [_DOCS / f"{name}.md" for name in _NAMES]
SCENE_TEXT = "".join(page.read_text(encoding="utf-8") for page in SCENE_PAGES)
