"""The files of the page. They are read once, and give a response for every address and one hash of all files."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256

from antdsl.resources import preview_page_file

_CONTENT_TYPE_BY_FILE = {
    "index.html": "text/html; charset=utf-8",
    "app.js": "text/javascript; charset=utf-8",
    "app.css": "text/css; charset=utf-8",
}
_BUILD_PLACEHOLDER = b'<meta name="build" content="" />'


@dataclass(frozen=True, slots=True)
class PageFiles:
    """The files of the page. `routes`: for each address in a request, the content type and the body. Addresses are only looked
    up here; they never become file names."""

    routes: dict[str, tuple[str, bytes]]
    build: str


def load_pages() -> PageFiles:
    """Return the files of the installed page. Raises OSError if files are missing."""
    bodies = {name: preview_page_file(name).read_bytes() for name in _CONTENT_TYPE_BY_FILE}
    hashed = sha256()
    for name in _CONTENT_TYPE_BY_FILE:
        hashed.update(len(bodies[name]).to_bytes(8, "little") + bodies[name])
    build = hashed.hexdigest()[:16]
    # the page compares it with the server's value when it connects, and so detects an outdated cached page
    bodies["index.html"] = bodies["index.html"].replace(
        _BUILD_PLACEHOLDER, _BUILD_PLACEHOLDER.replace(b'""', f'"{build}"'.encode())
    )
    routes = {f"/{name}": (kind, bodies[name]) for name, kind in _CONTENT_TYPE_BY_FILE.items()}
    return PageFiles({**routes, "/": routes["/index.html"]}, build)
