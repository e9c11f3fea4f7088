"""A page and its server part and meet again: an old page reloads, a stopped server is reported, and the page
reconnects to a restarted server or after a broken connection."""

from __future__ import annotations

import json
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browsing import chromium
from preview_page import SIZE, copied, previewed
from sampling import sampled

from antdsl.user_folders import state_folder

pytest.importorskip("websockets")

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

STALE = "() => !document.getElementById('stale').hidden && document.getElementById('stale').textContent"
FRESH = "() => document.getElementById('stale').hidden && window.antdsl && window.antdsl.agents > 0"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    context = browser.new_context(viewport=SIZE)
    try:
        yield context.new_page()
    finally:
        context.close()


@pytest.mark.parametrize("always", sampled([False, True], [False]))
def test_a_page_of_another_build_loads_itself_again_and_only_once(page: Page, tmp_path: Path, always: bool) -> None:
    """`always`: a cache holds on to the old page, which is then better than none."""
    page.add_init_script(
        """document.addEventListener('readystatechange', () => {
          if (document.readyState !== 'interactive') return;
          const loads = Number(sessionStorage.getItem('loads')) + 1, meta = document.querySelector('meta[name=build]');
          sessionStorage.setItem('loads', loads);
          if (!/^[0-9a-f]{16}$/.test(meta.content)) throw new Error('no build');
          if (ALWAYS || loads === 1) meta.content = '0000000000000000';
        });""".replace("ALWAYS", str(always).lower())
    )
    with previewed(copied("minimal", tmp_path) / "scene.yaml") as full_address:
        page.goto(full_address)
        page.wait_for_function("() => sessionStorage.getItem('loads') === '2'", timeout=60_000)
        page.wait_for_function(FRESH, timeout=60_000)  # it still has its token
        page.wait_for_timeout(1000)
        assert page.evaluate("[sessionStorage.getItem('loads'), location.hash]") == ["2", ""]


@pytest.mark.slow
def test_a_page_comes_back_to_a_server_that_is_started_again_on_its_port(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))  # which is not read: it may point into a project
    folder = state_folder() / "antdsl" / "preview"
    known = set(folder.glob("*"))
    scene = copied("minimal", tmp_path) / "scene.yaml"
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    page.add_init_script(
        """window.sent = [];
        window.WebSocket = class extends WebSocket {
          constructor(...all) { super(...all); window.sent.push(...all[1]); }
          send(words) { window.sent.push(words); super.send(words); }
        };"""
    )
    with previewed(scene, "--port", port) as full_address:  # the last `--port` counts
        page.goto(full_address)
        page.wait_for_function(FRESH, timeout=60_000)
        page.evaluate("() => (window.mine = true)")
    said = page.wait_for_function(STALE, timeout=60_000).json_value()
    assert "does not answer" in said
    with previewed(scene, "--port", port) as again:
        assert again.split("#")[0] == full_address.split("#")[0] and again != full_address, "the token is another one"
        page.wait_for_function(FRESH, timeout=60_000)
        assert page.evaluate("() => window.mine"), "it was not loaded again"
        [place] = set(folder.iterdir()) - known
        assert not (tmp_path / "state").exists()
        keys = json.loads(place.read_text())["keys"]
        assert len(keys) == 2 and stat.S_IMODE(place.stat().st_mode) == 0o600
        sent = page.evaluate("() => window.sent.join(' ')")
        assert not any(key in sent for key in keys), "what it comes back with is never sent"
        assert not any(key in page.evaluate("() => JSON.stringify([{...sessionStorage}, {...localStorage}])") for key in keys)
        page.reload()  # it has the new token
        page.wait_for_function(FRESH, timeout=60_000)
    place.unlink()  # no page knows it any more
    with previewed(scene, "--port", port) as last:
        page.wait_for_function(f"() => String(({STALE})()).includes('terminal')", timeout=60_000)
        page.goto("about:blank")
        page.goto(last)
        page.wait_for_function(FRESH, timeout=60_000)


def test_a_connection_that_breaks_is_made_again(page: Page, tmp_path: Path) -> None:
    page.add_init_script(
        """window.sockets = [];
        window.WebSocket = class extends WebSocket { constructor(...all) { super(...all); window.sockets.push(this); } };"""
    )
    with previewed(copied("minimal", tmp_path) / "scene.yaml") as full_address:
        page.goto(full_address)
        page.wait_for_function(FRESH, timeout=60_000)
        page.evaluate("() => window.sockets[0].send('x'.repeat(70000))")  # more than is read: the server hangs up
        page.wait_for_function("() => window.sockets.length === 2 && window.sockets[1].readyState === 1", timeout=60_000)
        page.wait_for_function(FRESH, timeout=60_000)
