"""`antdsl preview` of a copy of an example, and its page in a browser as a person sees it."""

from __future__ import annotations

import re
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import meshes
from forked import Forked

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
SIZE = {"width": 1280, "height": 720}
PATIENCE = 90.0  # seconds that are waited at least before something is said not to come


def copied(example: str, place: Path) -> Path:
    """An example's folder, to be edited."""
    shutil.copytree(EXAMPLES / example, place / example, ignore=shutil.ignore_patterns("out"))
    return place / example


@cache
def coarse(name: str, every: int) -> bytes:
    """The .ply file of a square sheet of an example, with one of so many of its lines each way."""
    import trimesh

    mesh = trimesh.load(EXAMPLES / name, process=False)
    side = round(len(mesh.vertices) ** 0.5)
    vertices = mesh.vertices.reshape(side, side, 3)[::every, ::every]
    _, faces = meshes.grid(1.0, len(vertices) - 1)
    return bytes(trimesh.Trimesh(vertices.reshape(-1, 3), faces, process=False).export(file_type="ply"))


def few(place: Path, count: int) -> Path:
    """The scene of a copy of the foraging ants, with fewer of them, on ground of fewer triangles, which is soon ready."""
    scene = copied("foraging", place) / "scene.yaml"
    scene.with_name("terrain.ply").write_bytes(coarse("foraging/terrain.ply", 5))
    scene.write_text(scene.read_text().replace("count: 500", f"count: {count}"))
    return scene


@contextmanager
def previewed(scene: Path, *flags: str) -> Iterator[str]:
    """The address of a preview of a scene. It must exit normally on request."""
    words = ("preview", str(scene), "--no-open", "--port", "0", "--threads", "1", *flags)
    process = Forked(*words, cwd=scene.parent)
    try:
        while (address_match := re.search(r"http://127\.0\.0\.1:\d+/#\S+(?=\n)", process.text)) is None:
            assert not process.over, process.text
            time.sleep(0.02)
        yield address_match[0]
    finally:
        process.signal(signal.SIGINT)
        code, said = process.ended(60)
    assert code == 0, said
    assert "Traceback" not in said, said


class PreviewPage:
    """A page, and what it complained of."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.complaints: list[str] = []
        page.on("console", lambda message: self.complaints.append(message.text) if message.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def find(self, name: str) -> Any:
        return self.page.get_by_test_id(name)

    def now(self, what: str, *values: Any) -> Any:
        """A value of `window.antdsl`, or what a call of it gives."""
        return self.page.evaluate(f"(values) => window.antdsl.{what}" + ("(...values)" if values else ""), list(values))

    def until(self, condition: str, seconds: float = 60.0, argument: Any = None) -> None:
        """Wait for a condition in the page's own language, with `a` for `window.antdsl` and `it` for the argument."""
        seconds = max(seconds, PATIENCE)  # a machine may be busy
        self.page.wait_for_function(
            f"(it) => {{ const a = window.antdsl; return a && ({condition}); }}", arg=argument, timeout=1000 * seconds, polling=50
        )

    def press(self, name: str) -> None:
        self.find(name).click()


@contextmanager
def opened(browser: Browser, address: str, **context: Any) -> Iterator[PreviewPage]:
    """The page of a preview with agents in it. It must not have complained by the time it is closed."""
    browser_context = browser.new_context(viewport=SIZE, **context)
    try:
        page = browser_context.new_page()
        preview = PreviewPage(page)
        page.goto(address)
        preview.until("a.agents > 0 && a.pictures > 0", 40)
        yield preview
        assert not [each for each in preview.complaints if "GPU stall" not in each and "WebGL" not in each], preview.complaints
    finally:
        browser_context.close()
