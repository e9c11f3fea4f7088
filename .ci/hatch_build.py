"""Compiles the package's kernels when a wheel is built, or the package is installed from a checkout.

It runs the source tree's own `antdsl.machine_code.build_objects`, with the packages of the build environment. Where that does not
work, the package is installed all the same: kernels are compiled when they are first used."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# The folder of the sources goes into the search path here and not by PYTHONPATH: pip's build environments drop folders that an
# editable installation also names.
RUN_BUILDER = (
    "import runpy, sys; sys.path.insert(0, sys.argv.pop(1)); "
    "runpy.run_module('antdsl.machine_code.build_objects', run_name='__main__', alter_sys=True)"
)


class ObjectsHook(BuildHookInterface):
    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile for all targets; for an editable install, which stays on this machine, only for this one."""
        command = [sys.executable, "-P", "-c", RUN_BUILDER, self.root]
        if version == "editable":
            command.append("--host")
        ended = subprocess.run(command, cwd=self.root)
        if ended.returncode:
            self.app.display_warning("kernels were not compiled in advance: they are compiled when they are first used")
        else:
            build_data["artifacts"].append("/antdsl/machine_code/objects/*.objects")
