"""A Chromium for tests of the preview's page: found on this machine, driven without a screen, drawing in software."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from antdsl.bootstrap import BROWSERS, DRIVER_LIBRARIES, find_missing_packages

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Where this says `required`, as CI does, tests that need a browser fail where none is found instead of being skipped.
BROWSER_VARIABLE = "ANTDSL_BROWSER"
_FLAGS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
    "--force-color-profile=srgb",
)


def find_browser() -> str | None:
    """The path of a Chromium, or None."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


@contextmanager
def chromium(*extra_flags: str) -> Iterator[Browser]:
    """A browser, with `extra_flags` flags. The test that asks for it is skipped where there is none, or fails where one is
    required."""
    path, lacking = find_browser(), find_missing_packages(DRIVER_LIBRARIES)
    if path is None or lacking:
        no = pytest.fail if os.environ.get(BROWSER_VARIABLE) == "required" else pytest.skip
        no(f"this machine has no {' '.join(lacking) or 'Chromium'}")
    sync_api = pytest.importorskip("playwright.sync_api")
    flags = [*_FLAGS, *extra_flags, *(["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else [])]
    with sync_api.sync_playwright() as driver:
        driver.selectors.set_test_id_attribute("data-test")
        browser = driver.chromium.launch(executable_path=path, args=flags)
        try:
            yield browser
        finally:
            browser.close()
