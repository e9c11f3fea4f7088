"""Makes the pictures of docs/gallery.md by the commands of the page: `python tests/gallery_pictures.py [NAME…]`."""

from __future__ import annotations

import re
import shlex
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "gallery.md"


def sections() -> list[tuple[Path, list[list[str]]]]:
    """For each example of the page its picture, and the words of its commands."""
    pattern = re.compile(r"^!\[[^\]]*\]\(([^)]*)\)\n\n```text\n(.*?)^```", re.MULTILINE | re.DOTALL)
    matches = pattern.findall(PAGE.read_text(encoding="utf-8"))
    return [(PAGE.parent / picture, [shlex.split(line) for line in text.splitlines()]) for picture, text in matches]


def main() -> None:
    from commands import run
    from PIL import Image

    for picture, lines in sections():
        if picture.parent.name != "gallery" or (sys.argv[1:] and picture.stem not in sys.argv[1:]):
            continue
        with tempfile.TemporaryDirectory() as folder:
            for words in lines:
                result = run(*words[1:], cwd=Path(folder))
                assert result.returncode == 0, result.stderr
            [still] = Path(folder).rglob("picture.*.png")
            picture.parent.mkdir(exist_ok=True)
            Image.open(still).convert("RGB").save(picture, quality=75, method=6)
        print(f"{picture.name}: {picture.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
