"""Commands without llvmlite: those that need machine code end with exit code 3 and name the package."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from sampling import sampled

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
HIDDEN = "import sys; sys.modules['llvmlite'] = None; from antdsl.cli import main; main()"


def run_without_llvmlite(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-P", "-c", HIDDEN, *words], capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("scene", sampled(["minimal/scene.yaml", "worth/scene.yaml"], ["minimal/scene.yaml"]))
def test_run_names_the_missing_package(scene: str, tmp_path: Path) -> None:
    result = run_without_llvmlite("run", str(EXAMPLES / scene), "--frames", "1..2", "--out", str(tmp_path / "out"))
    assert result.returncode == 3 and "llvmlite is not installed: pip install" in result.stderr, result.stderr[-2000:]
    assert "Traceback" not in result.stderr


def test_check_needs_no_machine_code(tmp_path: Path) -> None:
    assert run_without_llvmlite("check", str(EXAMPLES / "minimal" / "scene.yaml")).returncode == 0
