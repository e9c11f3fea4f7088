"""The picture of `docs/editors.md`: `python tests/highlight_shot.py` draws the foraging example in colours."""

from __future__ import annotations

from pathlib import Path

from pygments import highlight
from pygments.formatters import ImageFormatter

from antdsl.highlighting.lexer import AntLexer

ROOT = Path(__file__).resolve().parents[1]
LOOK = {
    "style": "one-dark",
    "font_name": "DejaVu Sans Mono",
    "font_size": 15,
    "line_number_bg": "#282c34",
    "line_number_fg": "#5c6370",
    "line_number_separator": False,
    "image_pad": 14,
    "line_pad": 3,
}


def picture(text: str) -> bytes:
    """A PNG of a text in colours. The font must be installed."""
    return highlight(text, AntLexer(), ImageFormatter(**LOOK))


if __name__ == "__main__":
    program = (ROOT / "examples" / "foraging" / "forager.ant").read_text(encoding="utf-8")
    (ROOT / "docs" / "images" / "highlighted.png").write_bytes(picture(program.split("\nspec ")[0]))
