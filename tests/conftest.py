"""What all tests share: `--update`, the order of files, how many examples Hypothesis draws, meshes that are prepared once a file.

`pytest --update` writes golden files again instead of comparing with them; the difference is for a person to read.
`pytest --hypothesis-profile=many` draws fifty times as many examples as are drawn otherwise.
"""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from antdsl.runtime import BindingCache

# Files that take longest are begun first, or at the end one process would be at work on one of them while the others wait.
LONGEST = (
    "test_preview_browser", "test_preview_browser_tools", "test_saved_failures", "test_docs_shell", "test_session", "test_cache",
    "test_same_bits", "test_docs", "test_preview_view", "test_preview_shown", "test_preview_live", "test_local_edits",
    "test_preview_why", "test_foraging", "test_page_panels", "test_explain", "test_profiling", "test_walk",
    "test_preview_coming_back", "test_digging", "test_new_project", "test_preview_memory", "test_foraging_rates",
    "test_program_steering", "test_meaning_programs", "test_thesis", "test_coming_from", "test_preview_hostile",
)  # fmt: skip
PLACE = {name: place for place, name in enumerate(LONGEST)}


def can_sign() -> bool:
    """Whether this user can have a private key for machine code."""
    from antdsl.machine_code import signing

    try:
        return signing.get_signer(create=True) is not None
    except OSError:
        return False


# What a test compiles is no business of the user's own folder; the tests of one run may share it. Without a private key, as where
# the home folder is only read, code stays in memory, and nothing is said of it. The same for tables of meshes.
for variable in ("ANTDSL_NATIVE_CACHE", "ANTDSL_TABLE_CACHE"):
    if variable not in os.environ:
        os.environ[variable] = tempfile.mkdtemp(prefix="antdsl-code-") if can_sign() else ""
        atexit.register(shutil.rmtree, os.environ[variable], ignore_errors=True)

os.environ.setdefault("ANTDSL_DEFAULTS", "")  # the options of tests are those that they write

# Times mean nothing here: the machine may be slow or busy.
settings.register_profile("few", max_examples=40, deadline=None)
settings.register_profile("many", max_examples=2000, deadline=None)
settings.load_profile("few")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update", action="store_true", default=False, help="write golden files anew")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: PLACE.get(item.path.stem, len(PLACE)))


class SharedCache(dict[str, Any]):
    """Values that all `Built` of a process share, and which of them were requested."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: set[str] = set()

    def __getitem__(self, key: str) -> Any:
        self.asked.add(key)
        return super().__getitem__(key)


SHARED_CACHE = SharedCache()


@pytest.fixture(scope="module", autouse=True)
def _shared_meshes() -> Iterator[None]:
    """What is made of meshes is made once a file or two, not once a world: most worlds stand on the same ground. How it is made
    is tested where it is made. A file with tests that simulate has imported what does before the first of them."""
    reuse = sys.modules.get("antdsl.runtime.binding.binding_cache")
    if reuse is None:
        yield
        return
    plain = reuse.BindingCache.__init__

    def begin(built: BindingCache) -> None:
        plain(built)
        built._values = SHARED_CACHE

    SHARED_CACHE.asked.clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reuse.BindingCache, "__init__", begin)
        yield
    for key in SHARED_CACHE.keys() - SHARED_CACHE.asked:
        del SHARED_CACHE[key]
