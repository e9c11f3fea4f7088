"""Settings of Sphinx for the documentation site: `python -m sphinx -W -c docs . OUT` in the project's folder, or `antdsl docs`.

The Markdown pages are the sources, so that they read the same in a repository viewer. The links below each heading of the root
page are the site's table of contents. Pages of codes are in none: a table of 170 entries on each page would double the time."""

import posixpath
import re

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata

project = "antdsl"
html_title = "antdsl"
extensions = ["myst_nb"]
nb_execution_mode = "off"  # notebooks are stored with what they print; tests run them
root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "docs/notebooks/*.ipynb",
    "grammar/README.md",
    "examples/*/README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "SECURITY.md",
]
exclude_patterns = ["docs/**/out"]
html_theme = "furo"
pygments_style, pygments_dark_style = "friendly", "native"
html_copy_source = html_show_sphinx = html_show_copyright = False
myst_heading_anchors = 6
# Pages show wrong programs on purpose, and programs in languages without a lexer.
suppress_warnings = ["misc.highlighting_failure"]


def add_contents(app: Sphinx, page: str, source: list[str]) -> None:
    """Append a hidden table of contents to the root page for each heading with links, and mark pages of codes as in no table."""
    if page.startswith("docs/codes/") and not page.endswith("README"):
        source[0] = f"---\norphan: true\n---\n{source[0]}"
    for group in source[0].split("\n## ")[1:] if page == root_doc else ():
        links = re.findall(r"\[([^\]]+)\]\(([\w./]+)\.(?:md|ipynb)\)", group)
        entries = [f"{text[0].upper()}{text[1:]} </{posixpath.normpath(posixpath.join('docs', link))}>" for text, link in links]
        source[0] += "\n".join(["", "```{toctree}", ":hidden:", f":caption: {group.splitlines()[0]}", *entries, "```", ""])


def setup(app: Sphinx) -> ExtensionMetadata:
    """Called by Sphinx."""
    app.connect("source-read", add_contents)
    return {"parallel_read_safe": True}
