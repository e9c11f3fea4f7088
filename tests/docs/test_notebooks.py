"""The notebooks of docs/notebooks run without an error, and print what they are stored with."""

from __future__ import annotations

from pathlib import Path

import pytest
from notebooks import NOTEBOOKS, execute_notebook, list_texts
from sampling import sampled

SHORT = [path for path in NOTEBOOKS if path.stem != "own_model"]  # that one has a sweep of 25 runs


@pytest.mark.parametrize("path", sampled(NOTEBOOKS, SHORT), ids=lambda path: path.stem)
def test_a_notebook_prints_what_it_shows(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbformat

    monkeypatch.setenv("PYTHONSAFEPATH", "1")
    notebook = execute_notebook(path, tmp_path)
    # How far columns of tables are apart differs between versions of pandas.
    texts = [[text.split() for text in list_texts(each)] for each in (notebook, nbformat.read(path, as_version=4))]
    assert texts[0] == texts[1], "run `python tests/notebooks.py`"
    assert any("image/png" in output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ()))
