"""What all tests share: `--update`, the order of files, how many examples Hypothesis draws, meshes that are prepared once a file.

`pytest --update` writes golden files anew instead of comparing with them; the difference is for a person to read.
`pytest --hypothesis-profile=many` draws fifty times as many examples as are drawn otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings

# Files that take longest are begun first, or at the end one process would be at work on one of them while the others wait.
LONGEST = (
    "test_preview_browser", "test_preview_browser_tools", "test_specs_kept", "test_docs_shell", "test_session", "test_cache",
    "test_same_bits", "test_docs", "test_preview_view", "test_preview_shown", "test_preview_live", "test_local_edits",
    "test_preview_why", "test_foraging", "test_page_panels", "test_explain", "test_profiling", "test_compiled_walk",
    "test_preview_coming_back", "test_digging", "test_new_project", "test_preview_memory", "test_foraging_rates",
    "test_program_steering", "test_meaning_programs", "test_thesis", "test_coming_from", "test_preview_hostile",
)  # fmt: skip
PLACE = {name: place for place, name in enumerate(LONGEST)}

# Time says nothing here: whoever runs the tests may have a slow machine, or a busy one.
settings.register_profile("few", max_examples=40, deadline=None)
settings.register_profile("many", max_examples=2000, deadline=None)
settings.load_profile("few")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update", action="store_true", default=False, help="write golden files anew")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: PLACE.get(item.path.stem, len(PLACE)))


@pytest.fixture(scope="module")
def kept_meshes() -> Iterator[None]:
    """What is made of meshes is made once a file, as it is once a session of the preview: most worlds of a file stand on the same
    ground. Not for tests of how it is made."""
    from antdsl.runtime import Built  # late: most processes of the quick part simulate nothing
    from antdsl.runtime.binding import bind_world

    built = Built()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bind_world, "Built", lambda: built)
        yield
