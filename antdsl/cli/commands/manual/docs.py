"""`antdsl docs`: builds the documentation site from the installed Markdown pages and opens it."""

from __future__ import annotations

import shutil
import tempfile
from hashlib import blake2b
from importlib.util import find_spec
from pathlib import Path

import typer

from antdsl import __version__
from antdsl.cli.destinations import require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note, print_result
from antdsl.resources import documentation_folder
from antdsl.user_folders import cache_folder, make_private_folder

FIRST_PAGE = "docs/index.html"
_PACKAGES = ("sphinx", "myst_parser", "myst_nb", "furo")


def run_docs_command(
    to: Path = typer.Option(None, "--to", metavar="DIR", help="Build the site in this new or empty folder, and do not open it."),
    no_open: bool = typer.Option(False, "--no-open", help="Print the path of the first page without opening a browser."),
) -> None:
    """Open this documentation in the browser, offline. The first time it is built, which needs the extra [docs]."""
    site = to if to is not None else _choose_cached_site()
    if to is not None or not (site / FIRST_PAGE).is_file():
        _require_sphinx()
        if to is None:
            shutil.rmtree(site.parent, ignore_errors=True)  # sites of other versions
            make_private_folder(site.parent)
        elif to.exists() and (not to.is_dir() or any(to.iterdir())):
            raise CommandError(ExitCode.INPUT_OUTPUT, f"error: `{to}` already exists and is not empty", "name another folder")
        require_writable_folder(site, "--to")
        print_note("building the site takes about half a minute")
        _build_site(site)
    print_result(str(site / FIRST_PAGE))
    if to is None and not no_open:
        import webbrowser

        webbrowser.open((site / FIRST_PAGE).as_uri())


def _choose_cached_site() -> Path:
    """Return the folder of this user's copy of the site. The folder's name contains a hash of the installed pages."""
    root = documentation_folder()
    digest = blake2b(__version__.encode(), digest_size=8)
    for path in sorted([root / "docs" / "conf.py", *root.glob("docs/**/*.md"), *root.glob("*.md"), *root.glob("grammar/*.md")]):
        digest.update(path.read_bytes())
    try:
        return cache_folder() / "antdsl" / "docs" / digest.hexdigest()
    except OSError as error:
        message = f"error: there is no folder to store the site in: {error.strerror}"
        raise CommandError(ExitCode.INPUT_OUTPUT, message, "name one with `--to`") from None


def _require_sphinx() -> None:
    """End the command if a package of the extra `[docs]` is missing."""
    missing = [name for name in _PACKAGES if find_spec(name) is None]
    if missing:
        message = f"error[missing-extra]: the site needs the packages {', '.join(missing)}"
        raise CommandError(ExitCode.FINDINGS, message, 'run `pip install "antdsl[docs]"`')


def _build_site(site: Path) -> None:
    """Build the site in a temporary folder, and move it to `site` once it is complete."""
    import socket
    from io import StringIO

    has_ipv6 = socket.has_ipv6
    socket.has_ipv6 = False  # otherwise a package that Sphinx imports binds a socket to find this out
    try:
        from sphinx.application import Sphinx
        from sphinx.util.docutils import docutils_namespace, patch_docutils

        root = documentation_folder()
        site.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".antdsl-docs-", dir=site.parent) as work:
            output, doctrees = Path(work) / "site", Path(work) / "doctrees"
            # `patch_docutils` prevents docutils from reading settings in the current folder. Links to sources that are not
            # installed are warnings, which the tests of a checkout report.
            with patch_docutils(root / "docs"), docutils_namespace():
                Sphinx(root, root / "docs", output, doctrees, "html", status=None, warning=StringIO()).build()
            if site.is_dir():
                site.rmdir()
            output.rename(site)
    finally:
        socket.has_ipv6 = has_ipv6
