"""The command behind the code lens above a spec: it runs this spec of a saved program."""

from __future__ import annotations

import asyncio
import os
from asyncio.subprocess import DEVNULL, PIPE, STDOUT
from pathlib import Path

from antdsl.child_processes import build_module_command, build_module_environment

RUN_SPEC_COMMAND = "antdsl.runSpec"
_MAX_MESSAGE_LINES = 12


async def run_spec(path: Path, name: str) -> tuple[bool, str]:
    """Run a spec with `antdsl test`. Return whether it failed, and the last lines of the report."""
    words = build_module_command("antdsl", "test", "--no-keep", "-k", name, "--", os.fspath(path))
    environment = {**build_module_environment(), "NO_COLOR": "1"}
    process = await asyncio.create_subprocess_exec(*words, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT, env=environment)
    try:
        output, _ = await process.communicate()
    finally:
        if process.returncode is None:  # the session ends
            process.kill()
    lines = output.decode("utf-8", "replace").strip().splitlines()
    return process.returncode != 0, "\n".join(lines[-_MAX_MESSAGE_LINES:])
