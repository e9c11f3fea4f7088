"""The pages of docs/ that describe scenes, and those that describe the language."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_SCENE_NAMES = ("scene", "scene_world", "scene_crowd", "flows", "cameras", "walking", "contacts", "periodic")
_LANGUAGE_NAMES = ("files", "world", "species", "states", "wishes", "senses", "expressions", "step", "exact", "decisions")
SCENE_PAGES = [ROOT / "docs" / f"{name}.md" for name in _SCENE_NAMES]
SCENE_TEXT = "".join(page.read_text(encoding="utf-8") for page in SCENE_PAGES)
LANGUAGE_PAGES = [ROOT / "grammar" / "README.md", *(ROOT / "docs" / f"language_{name}.md" for name in _LANGUAGE_NAMES)]
