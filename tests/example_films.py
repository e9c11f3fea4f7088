"""Makes a film of five seconds of each example: `python tests/example_films.py FOLDER [NAME…]`.

Films are for a person to look at. They need the extra `[video]` and are not in the repository. `--stills` makes two stills
instead, of the first and the last frame of the film."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import yaml

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SECONDS, WIDTH, HEIGHT = 5, 1280, 720


class Film(NamedTuple):
    """A film of a scene: its path below `examples`, the first frame, and more words for `antdsl render`."""

    scene: str
    first: int = 1
    words: tuple[str, ...] = ()


FILMS = {
    "anthill": Film("anthill/scene.yaml", 240),
    "anthill_inside": Film("anthill/scene.yaml", 600, ("--camera", "section", "--cut", "z > 1.5")),
    "arena": Film("arena/scene.yaml", 24),
    "battle": Film("battle/scene.yaml", 96),
    "bridge": Film("bridge/scene.yaml", 240),
    "evacuation": Film("evacuation/scene.yaml", 120),
    "flow": Film("flow/scene.yaml", 240),
    "foraging": Film("foraging/scene.yaml", 480),
    "foraging_many": Film("foraging/many.yaml", 120),
    "minimal": Film("minimal/scene.yaml"),
    "roaches": Film("roaches/scene.yaml", 120),
    "thesis": Film("thesis/tunnel_and_can.yaml", 240),
}


def main() -> None:
    from commands import run

    words = [word for word in sys.argv[1:] if word != "--stills"]
    if not words:
        raise SystemExit(__doc__)
    folder, names = Path(words[0]).resolve(), words[1:] or list(FILMS)
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        film, scene = FILMS[name], EXAMPLES / FILMS[name].scene
        fps = int(yaml.safe_load(scene.read_text(encoding="utf-8")).get("fps", 24))
        last = film.first + SECONDS * fps - 1
        with tempfile.TemporaryDirectory() as work:
            pictures = ["--every", str(last - film.first)] if "--stills" in sys.argv else ["--film"]
            shot = ["--frames", f"{film.first}..{last}", "--width", str(WIDTH), "--height", str(HEIGHT), "--legend", "none"]
            for command in (
                ["run", str(scene), "--frames", f"1..{last}", "--out", "cache", "--quiet"],
                ["render", "cache", *shot, *pictures, *film.words, "--out", "pictures"],
            ):
                result = run(*command, cwd=Path(work))
                assert result.returncode == 0, result.stderr
            for path in sorted(Path(work, "pictures").iterdir()):
                (folder / f"{name}{path.suffix if path.suffix == '.mp4' else f'_{path.name}'}").write_bytes(path.read_bytes())
        print(name, flush=True)


if __name__ == "__main__":
    main()
