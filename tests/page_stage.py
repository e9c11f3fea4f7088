"""The preview's page in a browser, with the test as its server: the test records its requests and sends its messages."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from antdsl.preview.requests import REQUEST_ADAPTER

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page, Route, WebSocketRoute

PAGE = Path(__file__).resolve().parents[1] / "antdsl" / "preview" / "page"
ADDRESS = "http://localhost:8765/"
KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; base-uri 'none'; "
    "frame-ancestors 'none'; form-action 'none'"
)

# Counts what a page has heard: the listener stands before the page's own, in the same turn.
COUNTING = """
window.heard = 0;
window.WebSocket = class extends WebSocket {
    constructor(...given) {
        super(...given);
        this.addEventListener("message", () => window.heard++);
    }
};
"""


class Stage:
    """A page that is open. `asks`: its requests, each a message that a server takes; `wrong`: what the browser complained of."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.asks: list[dict[str, Any]] = []
        self.wrong: list[str] = []
        self._socket: WebSocketRoute | None = None
        self._sent = 0
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("console", lambda message: self.wrong.append(message.text) if message.type == "error" else None)
        page.route(f"{ADDRESS}**", self._serve)
        page.route_web_socket(f"{ADDRESS.replace('http', 'ws')}ws", self._joined)
        page.add_init_script(COUNTING)

    def _serve(self, route: Route) -> None:
        name = route.request.url.removeprefix(ADDRESS) or "index.html"
        headers = {"Content-Security-Policy": POLICY, "Content-Type": KINDS[name.rsplit(".", 1)[-1]]}
        route.fulfill(body=(PAGE / name).read_bytes(), headers=headers)

    def _joined(self, socket: WebSocketRoute) -> None:
        self._socket, self._sent = socket, 0
        socket.on_message(self._heard)

    def _heard(self, said: str | bytes) -> None:
        REQUEST_ADAPTER.validate_json(said)  # a page that asks what no server takes fails here
        self.asks.append(json.loads(said))

    def tell(self, *messages: dict[str, Any] | bytes) -> None:
        """Messages and packets, in this order."""
        assert self._socket is not None
        for each in messages:
            self._socket.send(each if isinstance(each, bytes) else json.dumps(each))
        self._sent += len(messages)
        self.page.wait_for_function("sent => window.heard >= sent", arg=self._sent)
        self.drawn()

    def drawn(self) -> None:
        """Wait until all that came so far is on the page, and the page's requests have arrived."""
        self.page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def find(self, name: str) -> Locator:
        return self.page.locator(f'[data-test="{name}"]')

    def requests_of(self, op: str) -> list[dict[str, Any]]:
        self.drawn()
        return [each for each in self.asks if each["op"] == op]


@contextmanager
def stage(browser: Browser) -> Iterator[Stage]:
    """The page, open and connected; that nothing went wrong in it is looked at in the end."""
    context = browser.new_context(viewport={"width": 1280, "height": 720})
    context.grant_permissions(["clipboard-read", "clipboard-write"], origin=ADDRESS)
    opened = Stage(context.new_page())
    try:
        opened.page.goto(ADDRESS)
        opened.page.wait_for_function("document.getElementById('stale').hidden")
        yield opened
        assert not opened.wrong, opened.wrong
    finally:
        context.close()
