"""Run the notebooks of docs/notebooks. As a script, it stores what they print and draw: `python tests/notebooks.py`."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def execute_notebook(path: Path, folder: Path) -> nbformat.NotebookNode:
    """Return the notebook with new outputs. It runs in `folder`; an error in a cell raises `CellExecutionError`."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times, which differ between runs
    return notebook


def list_texts(notebook: nbformat.NotebookNode) -> list[str]:
    """Return what each cell prints or shows as text. Drawings and messages of other programs are left out."""
    texts = []
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if output.output_type == "stream":
                texts.append(output.text)
            elif "image/png" not in output.data:
                texts.append(output.data.get("text/plain", ""))
    return texts


if __name__ == "__main__":
    os.environ["PYTHONSAFEPATH"] = "1"
    for path in NOTEBOOKS:
        with tempfile.TemporaryDirectory() as folder:
            nbformat.write(execute_notebook(path, Path(folder)), path)
        print(path.name, path.stat().st_size // 1024, "KiB")
