"""A real browser on a hostile page, with a preview running beside it: the page finds out nothing and steers nothing, also where
it knows the token."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import pytest
from browsing import chromium
from preview_page import copied, previewed

pytest.importorskip("websockets")

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

EVIL = "evil.example"  # leads to this machine, as after DNS rebinding
# Each tries to get something, and gives what it got; "nothing" is what all of them should give.
TRIES = {
    "fetch": "fetch(address).then(r => r.text())",
    "fetch without rules": "fetch(address, {mode: 'no-cors'}).then(r => r.text()).then(text => text || 'nothing')",
    "a script": "tag('script', {src: address + 'app.js', type: 'text/javascript'})",
    "a module": "tag('script', {src: address + 'app.js', type: 'module'})",
    "a style": "tag('link', {href: address + 'app.css', rel: 'stylesheet'})",
    "a socket": "socket(['antdsl.1'])",
    "a socket with the token": "socket(['antdsl.1', 'token.' + token])",
    "a post": "fetch(address, {method: 'POST', mode: 'no-cors', body: '{}'}).then(r => r.text()).then(text => text || 'nothing')",
}
HELP = """
  const tag = (name, more) => new Promise(done => {
    const made = Object.assign(document.createElement(name), more);
    made.onload = () => done('loaded');
    made.onerror = () => done('nothing');
    document.head.append(made);
  });
  const socket = protocols => new Promise(done => {
    const made = new WebSocket(address.replace('http', 'ws') + 'ws', protocols);
    made.onopen = () => done('open');
    made.onmessage = event => done(event.data);
    made.onerror = () => done('nothing');
  });
"""


class _Page(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>evil</title>")

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def hostile() -> Iterator[int]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Page)
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    # nothing of the browser's own keeps a page from this machine: it is the server that has to
    with chromium(
        f"--host-resolver-rules=MAP {EVIL} 127.0.0.1",
        "--disable-features=BlockInsecurePrivateNetworkRequests,PrivateNetworkAccessChecks,LocalNetworkAccessChecks",
    ) as chromium_browser:
        yield chromium_browser


def tried(page: Page, what: str, address: str, token: str) -> str:
    script = f"async ([address, token]) => {{ {HELP} try {{ return await {TRIES[what]} }} catch {{ return 'nothing' }} }}"
    return str(page.evaluate(script, [address, token]))


def test_a_hostile_page_gets_nothing(browser: Browser, tmp_path: Path) -> None:
    scene = copied("minimal", tmp_path) / "scene.yaml"
    with previewed(scene) as full_address, hostile() as port:
        address, _, token = full_address.partition("#")
        page = browser.new_page()
        page.goto(f"http://{EVIL}:{port}/")
        for what in TRIES:
            assert tried(page, what, address, token) == "nothing", what
        # the same from a page that is no page of anybody: its origin is `null`
        page.goto("data:text/html,<title>evil</title>")
        for what in TRIES:
            assert tried(page, what, address, token) == "nothing", what
        # and what it should get, from the page itself
        page.goto(address)
        assert "<title>" in tried(page, "fetch", address, token)
        assert tried(page, "a socket with the token", address, token) != "nothing"
        page.close()


def test_no_other_page_shows_the_preview_in_itself(browser: Browser, tmp_path: Path) -> None:
    scene = copied("minimal", tmp_path) / "scene.yaml"
    with previewed(scene) as full_address, hostile() as port:
        page = browser.new_page()
        page.goto(f"http://{EVIL}:{port}/")
        page.evaluate(
            "address => document.body.append(Object.assign(document.createElement('iframe'), {src: address}))", full_address
        )
        page.wait_for_timeout(1000)
        frame = next(each for each in page.frames if each.parent_frame)
        assert frame.url.startswith("chrome-error:")
        page.close()


def test_the_page_is_not_there_by_another_name(browser: Browser, tmp_path: Path) -> None:
    """After DNS rebinding the browser takes the preview for a page of the attacker, and lets them read it."""
    scene = copied("minimal", tmp_path) / "scene.yaml"
    with previewed(scene) as full_address:
        address, _, token = full_address.partition("#")
        rebound = address.replace("127.0.0.1", EVIL)
        page = browser.new_page()
        response = page.goto(f"{rebound}#{token}")
        assert response is not None and response.status == 403
        assert page.evaluate("document.body.innerText").strip() == "Forbidden"
        for what in ("a socket", "a socket with the token", "a script"):
            assert tried(page, what, rebound, token) == "nothing", what
        assert response.headers["content-security-policy"].startswith("default-src 'none'")
        page.close()
