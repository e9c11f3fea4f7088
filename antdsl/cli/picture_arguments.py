"""The picture options of `antdsl render`. Their texts are converted to values, and conflicting options are reported."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from antdsl.outputs.agent_paths import PathWindow
    from antdsl.outputs.cut_plane import CutPlane
    from antdsl.outputs.drawing import DrawRequest
    from antdsl.outputs.gallery import Gallery

_DEFAULT_SAMPLES = 64  # paths per pixel


def parse_cut(text: str | None) -> CutPlane | None:
    from antdsl.outputs.cut_plane import CutPlane

    cut = CutPlane.parse(text) if text is not None else None
    if text is not None and cut is None:
        raise typer.BadParameter(f"`{text}` is not a plane such as `z > 0` or `x < -12.5`", param_hint="--cut")
    return cut


def parse_point(text: str | None, option: str) -> tuple[float, float, float] | None:
    from antdsl.scene.quantities import QuantityError, parse_number

    if text is None:
        return None
    try:
        x, y, z = (parse_number(part.strip()) for part in text.split(","))
    except (QuantityError, ValueError):
        raise typer.BadParameter(f"`{text}` is not a point such as `120,80,-40`", param_hint=option) from None
    return x, y, z


def check_camera(gallery: Gallery, settings: DrawRequest) -> None:
    """End the command if camera options contradict each other, or if no camera of the scene has the requested name."""
    from antdsl.diagnostics.suggestion import find_nearest_name
    from antdsl.scene.camera_models import CAMERA_VIEWS

    missing = next((name for name in ("at", "look_at") if getattr(settings, name) is None), None)
    if missing is not None and (settings.at or settings.look_at):
        option = "--" + missing.replace("_", "-")
        raise typer.BadParameter(f"a camera needs a position and an aim: add `{option} X,Y,Z`", param_hint=option)
    if settings.at is not None and settings.camera != "scene":
        raise typer.BadParameter("`--at` places a camera: leave `--camera` out", param_hint="--camera")
    if settings.focal is not None and settings.camera == "top":
        raise typer.BadParameter("`--camera top` has parallel rays, so it has no focal length", param_hint="--focal")
    names = [*CAMERA_VIEWS, *gallery.manifest.named_cameras]
    if settings.camera not in names:
        near = find_nearest_name(settings.camera, names)
        help = f"did you mean `{near}`?" if near else "it has " + ", ".join(f"`{name}`" for name in names)
        raise typer.BadParameter(f"the cache has no camera `{settings.camera}`: {help}", param_hint="--camera")


def choose_samples(samples: int | None, *, is_blender: bool) -> int:
    """Return the number of paths per pixel for Cycles, or 0 if antdsl draws the picture. `samples`: the option's value."""
    if samples is not None and not is_blender:
        raise typer.BadParameter("only Cycles has paths per pixel: add `--blender`", param_hint="--samples")
    return (samples or _DEFAULT_SAMPLES) if is_blender else 0


def check_blender_request(settings: DrawRequest, is_on_cluster: bool) -> None:
    """End the command if Blender is missing, or if options are set that apply only to antdsl's own pictures."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.outputs.blender.rendering import check_blender

    unavailable = {
        "--show": not {"trail", "states"}.issuperset(settings.show),
        "--cut": settings.cut is not None,
        "--marks": settings.marks > 0,
        "--least": settings.least is not None,
        "--full": bool(settings.full),
        "--scheduler": is_on_cluster,
    }
    for option in (name for name, is_set in unavailable.items() if is_set):
        raise typer.BadParameter(
            "Blender renders the scene without this: leave it out, or leave `--blender` out", param_hint=option
        )
    exit_on_errors(check_blender())


def parse_window(text: str) -> PathWindow:
    from antdsl.outputs.agent_paths import MAX_WINDOW_SECONDS, PathWindow

    window = PathWindow.parse(text)
    if window is None:
        words = f"`{text}` is not a range of seconds such as `1..2`, of at most {MAX_WINDOW_SECONDS:g}"
        raise typer.BadParameter(words, param_hint="--window")
    return window


def parse_full_strengths(texts: list[str]) -> dict[str, float]:
    from antdsl.scene.quantities import QuantityError, parse_number

    strengths = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            strengths[name.strip()] = parse_number(value)
        except QuantityError:
            strengths[name.strip()] = 0.0
        if strengths[name.strip()] <= 0:
            raise typer.BadParameter(f"`{text}` is not a field with a strength, such as `trail=20`", param_hint="--full")
    return strengths
