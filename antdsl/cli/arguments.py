"""Parsers of command-line arguments: `NAME=VALUE` pairs, ranges of frames, and folders granted to a scene."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl import limits

if TYPE_CHECKING:
    from antdsl.outputs.cache.manifest import Manifest
    from antdsl.scene.values import FrameRange


def parse_pairs(words: Iterable[str], flag: str) -> dict[str, str]:
    """Return `NAME=VALUE` words as a mapping. Raises BadParameter for any other word."""
    mapping = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign or not name.strip() or not value.strip():
            raise typer.BadParameter(f"write NAME=VALUE, not `{word}`", param_hint=flag)
        mapping[name.strip()] = value.strip()
    return mapping


UNTIL_OPTION = typer.Option(
    None,
    "--until",
    metavar="CONDITION",
    help="End with the first frame in which a condition of specs holds: 'total(food.load) == 0'. Overrides the scene.",
)


def parse_until(text: str | None) -> str | None:
    """Return the condition of `--until` on one line, or None if the option is not given. Raises BadParameter for an empty
    text."""
    if text is None:
        return None
    from antdsl.scene.values import parse_condition

    try:
        return parse_condition(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--until") from None


STDIN_PATH = Path("-")


def read_standard_input() -> bytes:
    """Return the program text from standard input, truncated at the size limit of files."""
    return sys.stdin.buffer.read(limits.MAX_PROGRAM_BYTES + 1)


def parse_grants(words: Iterable[str]) -> dict[str, Path]:
    """Return `--root NAME=DIR` arguments as a mapping. Raises BadParameter if a folder does not exist."""
    folders = {}
    for name, folder in parse_pairs(words, "--root").items():
        path = Path(folder)
        if not re.fullmatch("[A-Za-z][A-Za-z0-9_]{1,31}", name):
            raise typer.BadParameter(f"`{name}` is not a valid name for a root (2 to 32 letters)", param_hint="--root")
        if not path.is_dir():
            raise typer.BadParameter(f"there is no folder `{folder}`", param_hint="--root")
        folders[name] = path.resolve()
    return folders


def require_scene(path: Path, hint: str = "SCENE") -> None:
    """Raise BadParameter if the path is a program or a folder instead of a scene. The message suggests a scene in that folder.
    `hint`: the name of the argument."""
    if path.suffix == ".ant":
        raise typer.BadParameter(f"`{path}` is a program; name a scene that uses it, such as scene.yaml", param_hint=hint)
    if path.is_dir():
        from antdsl.files import find_files

        scenes = [file for file in find_files([path])[0] if file.suffix != ".ant"]
        near = min(scenes, key=lambda file: (len(file.parts), str(file)), default=path / "scene.yaml")
        display_path = near if near.is_absolute() else f"./{near}"
        raise typer.BadParameter(f"`{path}` is a folder; name a scene, such as `{display_path}`", param_hint=hint)


def parse_frame_range(text: str | None, flag: str = "--frames") -> FrameRange | None:
    """Return a range such as `A..B` as a FrameRange, or None if `text` is None."""
    if text is None:
        return None
    from antdsl.scene.quantities import QuantityError
    from antdsl.scene.values import parse_frame_range

    try:
        return parse_frame_range(text)
    except QuantityError as error:
        raise typer.BadParameter(f"`{text}` {error}: {error.help or 'write A..B'}", param_hint=flag) from None


def require_agents(text: str | None, manifest: Manifest, flag: str) -> list[int]:
    """Return the keys of the agents in a list such as `3,8..12,guards.17`. Raises BadParameter if the list is invalid."""
    from antdsl.outputs.chosen_agents import UnknownAgent, find_keys

    try:
        return find_keys(text, manifest)
    except UnknownAgent as why:
        raise typer.BadParameter(f"{why}: {why.help}", param_hint=flag) from None


def parse_shutter(text: str | None, flag: str = "--shutter") -> tuple[float, float] | None:
    """Return the times at which a shutter opens and closes, from `A..B`, in frames relative to the current frame.

    Return None if `text` is None. Raises BadParameter unless both times are from -1 to 1 and at most one frame apart."""
    if text is None:
        return None
    from antdsl.scene.quantities import QuantityError, parse_number_range

    try:
        first, last = parse_number_range(text)
    except QuantityError:
        raise typer.BadParameter(f"`{text}` is not a time: write `-0.25..0.25`, in frames", param_hint=flag) from None
    if not -1 <= first < last <= 1 or last - first > 1:
        words = f"`{text}` must span at most one frame, within -1 to 1; write `-0.25..0.25`"
        raise typer.BadParameter(words, param_hint=flag)
    return first, last


def parse_tolerance(text: str | None, flag: str = "--tolerance") -> float | None:
    """Return a percentage such as `0.5%` as a fraction from 0 to 0.1, or None if `text` is None."""
    if text is None:
        return None
    from antdsl.scene.quantities import QuantityError, parse_number, split_quantity

    try:
        digits, unit = split_quantity(text)
        percentage = parse_number(digits)
    except QuantityError:
        percentage, unit = -1.0, ""
    if unit != "%" or not 0 <= percentage <= 10:
        words = f"`{text}` is not a share of the body's length from 0% to 10%: write `0.5%`"
        raise typer.BadParameter(words, param_hint=flag)
    return percentage / 100
