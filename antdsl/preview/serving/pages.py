"""The files of the page, read once: each address that there is, what it answers, and a hash of all."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256

from antdsl.resources import page_file

_FILES = {
    "index.html": "text/html; charset=utf-8",
    "app.js": "text/javascript; charset=utf-8",
    "app.css": "text/css; charset=utf-8",
}
_BUILD = b'<meta name="build" content="" />'


@dataclass(frozen=True, slots=True)
class Pages:
    """`routes`: by the address as it stands in a request, its type and body. An address is looked up here and nowhere else: none
    is ever made into the name of a file."""

    routes: dict[str, tuple[str, bytes]]
    build: str


def pages() -> Pages:
    """The page as it was installed. OSError where its files are missing."""
    bodies = {name: page_file(name).read_bytes() for name in _FILES}
    hashed = sha256()
    for name in _FILES:
        hashed.update(len(bodies[name]).to_bytes(8, "little") + bodies[name])
    build = hashed.hexdigest()[:16]
    # the page compares this with what the server says when it is connected: one out of a cache finds out that it is old
    bodies["index.html"] = bodies["index.html"].replace(_BUILD, _BUILD.replace(b'""', f'"{build}"'.encode()))
    routes = {f"/{name}": (kind, bodies[name]) for name, kind in _FILES.items()}
    return Pages({**routes, "/": routes["/index.html"]}, build)
