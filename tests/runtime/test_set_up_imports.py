"""What the set-up of a crowd on a mesh does again in the next run: it computes no table, and imports no SciPy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from children import child_environment

from antdsl.machine_code import signing
from antdsl.numerics.stored_tables import TABLE_STORE

ROOT = Path(__file__).parents[2]
SET_UP = """
import sys
from pathlib import Path
from antdsl.numerics import stored_tables
from antdsl.pipeline import open_scene
from antdsl.runtime import bind
from antdsl.runtime.checkpoints import state_hash
shot, report = open_scene(Path(sys.argv[1]))
world = bind(shot.plan, shot.setting)
print(stored_tables.count_computed_tables(), "scipy" in sys.modules, state_hash(world))
"""


@pytest.mark.slow
def test_the_next_run_computes_nothing_again(tmp_path: Path) -> None:
    if signing.get_signer(create=True) is None:
        pytest.skip("this user can have no private key")

    def set_up(folder: Path | str) -> list[str]:
        command = [sys.executable, "-P", "-c", SET_UP, str(ROOT / "examples/foraging/scene.yaml")]
        environment = child_environment() | {TABLE_STORE.variable: str(folder)}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    never, first, second = set_up(""), set_up(tmp_path / "tables"), set_up(tmp_path / "tables")
    assert never[2] == first[2] == second[2]
    assert int(first[0]) > int(second[0]), (first, second)
    assert second[1] == "False"
