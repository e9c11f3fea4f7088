"""The environment in which a cache was made.

It consists of a hash of antdsl's sources, versions of the numerical packages, the platform and the command."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from antdsl.diagnostics.model import replace_unprintable
from antdsl.machine_code import llvm_compiler
from antdsl.outputs.cache.manifest import ManifestError, Provenance, read_manifest
from antdsl.scene.paths import GRANTED_PATH_PATTERN
from antdsl.scene.values import FrameRange
from antdsl.source_hash import hash_sources

_MAX_COMMAND_CHARACTERS = 2000  # characters of a command


def collect_provenance(scene: str, frames: FrameRange, seed: int, inputs: Mapping[str, str]) -> Provenance:
    """Return the provenance of a cache that this process makes. `scene`: the name of the scene file. `inputs`: the inputs of the
    run."""
    return Provenance(sources=hash_sources(), command=make_command(scene, frames, seed, inputs), **_find_package_versions())


def make_command(scene: str, frames: FrameRange, seed: int, inputs: Mapping[str, str]) -> str:
    """Return the command that makes the same frames again.

    It contains neither folders nor options that do not change results, such as `--out` and `--threads`. So a run gives the same
    bytes anywhere, and its cache reveals nothing about the machine."""
    return shlex.join(_make_command_words(scene, frames, seed, inputs))[:_MAX_COMMAND_CHARACTERS]


def make_resume_command(folder: Path) -> str:
    """Return the command that completes a cache, or makes its damaged frames again.

    Words in capitals are placeholders for values that the manifest does not contain: the folders of granted roots, and the scene
    of an unreadable manifest. All words from the manifest are quoted, because the manifest may come from a stranger."""
    try:
        manifest = read_manifest(folder)
    except ManifestError:
        return f"antdsl run SCENE --out {shlex.quote(str(folder))} --resume"
    scene = os.path.normpath(folder / manifest.scene_path) if manifest.scene_path is not None else manifest.scene
    words = _make_command_words(scene, FrameRange(manifest.first, manifest.last), manifest.seed, manifest.inputs)
    roots = sorted({match[1] for name in manifest.inputs if (match := GRANTED_PATH_PATTERN.fullmatch(name))})
    words += [word for name in roots for word in ("--root", f"{name}=FOLDER")]
    return replace_unprintable(shlex.join([*words, "--out", str(folder), "--resume"])[:_MAX_COMMAND_CHARACTERS])


def _make_command_words(scene: str, frames: FrameRange, seed: int, inputs: Mapping[str, str]) -> list[str]:
    """Return the words of the command that makes these frames again."""
    changes = [f"{name.removeprefix('--set ')}={text}" for name, text in inputs.items() if name.startswith("--set ")]
    sets = [word for change in changes for word in ("--set", change)]
    return ["antdsl", "run", scene, "--frames", f"{frames.first}..{frames.last}", "--seed", str(seed), *sets]


@cache
def _find_package_versions() -> Mapping[str, str]:
    """Return the versions of Python and of numerical packages, and the platform."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "llvm": _find_llvm_versions(),
        "open3d": _find_installed_version("open3d", "open3d-cpu"),
        "platform": f"{platform.system()} {platform.machine()}",
    }


def _find_llvm_versions() -> str:
    """Return the versions of LLVM and llvmlite. Empty if machine code is not available."""
    if llvm_compiler.find_unavailability_reason():
        return ""
    import llvmlite
    import llvmlite.binding as llvm

    return f"{'.'.join(map(str, llvm.llvm_version_info))} (llvmlite {llvmlite.__version__})"


def _find_installed_version(*names: str) -> str:
    """Return the version of the first of these packages that is installed. Empty if none is."""
    for name in names:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return ""
