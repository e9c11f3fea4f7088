"""The table of fuzz targets: a row has its seeds, its mutators, and what feeds one input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzz import feeds, feeds_cache, feeds_servers, seeds
from fuzz.mutation import BINARY, TEXT, Mutator, insert_words
from fuzz.oracle import Feed

KIB = 1024
CORPUS = Path(__file__).parent / "corpus"


@dataclass(frozen=True)
class Target:
    """`start` prepares a folder and returns the function that feeds one input; `allowed` are audit events that the target may
    cause, such as starting the reader process; `cap` is the greatest length of an input in bytes."""

    name: str
    initial: Callable[[], Sequence[bytes]]
    mutators: tuple[Mutator, ...]
    start: Callable[[Path], Feed]
    cap: int = 64 * KIB
    allowed: tuple[str, ...] = ()

    def open(self, folder: Path) -> Feed:
        return self.start(folder)

    def regressions(self) -> dict[str, bytes]:
        """Inputs of the repository that once found something, by file name."""
        folder = CORPUS / self.name
        return {path.name: path.read_bytes() for path in sorted(folder.iterdir())} if folder.is_dir() else {}

    def seeds(self) -> list[bytes]:
        return [*self.initial(), *self.regressions().values()]


READER = ("subprocess.Popen", "os.posix_spawn", "os.fork")

MESSAGES = (insert_words([word.encode() for word in feeds_servers.json_words()]),) * 4

TARGETS: dict[str, Target] = {
    row.name: row
    for row in (
        Target("text", seeds.programs, (*TEXT, *seeds.program_words()), feeds.feed_text),
        Target("scene", seeds.scenes, (*TEXT, *seeds.scene_words()), feeds.feed_scene),
        Target("obj", seeds.obj_files, (*TEXT, *seeds.mesh_words()), feeds.feed_mesh("obj")),
        Target("ply", seeds.ply_files, (*TEXT, *BINARY, *seeds.mesh_words()), feeds.feed_mesh("ply")),
        Target("stl", seeds.stl_files, (*TEXT, *BINARY, *seeds.mesh_words()), feeds.feed_mesh("stl")),
        Target("geo", seeds.geo_files, (*TEXT, *BINARY, *seeds.geo_words()), feeds.feed_mesh("bgeo")),
        Target("gltf", seeds.gltf_files, (*TEXT, *BINARY, *seeds.gltf_words()), feeds.feed_gltf),
        Target(
            "gltf_ground", seeds.gltf_files, (*TEXT, *BINARY, *seeds.gltf_words()),
            feeds.feed_ground(feeds.gltf_name, "{mesh: FILE}"),
        ),
        Target(
            "usd", seeds.usd_files, (*TEXT, *BINARY, *seeds.usd_words()), feeds.feed_ground(feeds.usd_name, "{usd: FILE}"),
            allowed=READER,
        ),
        Target("body", seeds.body_files, (*TEXT, *seeds.body_words()), feeds.feed_body),
        Target("clip", seeds.clip_files, (*TEXT, *seeds.clip_words()), feeds.feed_clip),
        Target(
            "image", seeds.image_files, BINARY,
            feeds.feed_ground(feeds.image_name, "{height: FILE, extent: [100 mm, 100 mm], scale: 10 mm}"),
            allowed=READER,
        ),
        Target("cache", feeds_cache.cache_inputs, (*TEXT, *BINARY, *BINARY), feeds_cache.feed_cache),
        Target(
            "websocket", feeds_servers.websocket_inputs, (*TEXT, *BINARY, *MESSAGES), feeds_servers.feed_websocket,
            allowed=("socket.connect",),
        ),
        Target("preview", feeds_servers.page_inputs, (*TEXT, *MESSAGES), feeds_servers.feed_page, cap=16 * KIB),
        Target("lsp", feeds_servers.lsp_inputs, (*TEXT, *MESSAGES), feeds_servers.feed_lsp),
    )
}  # fmt: skip
