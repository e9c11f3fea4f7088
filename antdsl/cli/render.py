"""`antdsl render CACHE`: stills, a contact sheet and a film of a cache."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.cli.exits import Exit, Stop

if TYPE_CHECKING:
    from antdsl.outputs.gallery import Gallery
    from antdsl.outputs.pictures.model import Camera, Picture

SHEET = 9  # pictures on a contact sheet where no frames are named


class View(StrEnum):
    scene = "scene"
    above = "above"
    eye = "eye"


def render(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    frames: str = typer.Option(
        None, "--frames", metavar="A..B", help="Which frames. [default: the last; all with --film]", show_default=False
    ),
    every: int = typer.Option(None, "--every", min=1, metavar="N", help="Every so many frames."),
    sheet: bool = typer.Option(False, "--sheet", help="One picture with several frames on it, and the last frame by itself."),
    film: bool = typer.Option(False, "--film", help="An .mp4; needs the extra [video]."),
    show: str = typer.Option(
        "trail", "--show", metavar="WORD,…", help="What to draw besides: trail, feelers, velocity, ids; `none` for nothing."
    ),
    agents: str = typer.Option(
        None, "--agents", metavar="ID,…", help="Only these agents' ids and velocities; the eye camera follows the first."
    ),
    width: int = typer.Option(960, "--width", min=16, max=8192, help="Pixels."),
    height: int = typer.Option(540, "--height", min=16, max=8192, help="Pixels."),
    camera: View = typer.Option(View.scene, "--camera", help="The scene's own, one from above, one at an agent's eye level."),
    threads: int = typer.Option(0, "--threads", min=0, max=256, help="0 takes all cores."),
    out: Path = typer.Option(
        None, "--out", metavar="DIR", help="Where pictures go. [default: pictures in the cache]", show_default=False
    ),
) -> None:
    """Draw frames of a cache."""
    from antdsl.cli.arguments import frame_range

    gallery = _gallery(cache)
    wanted = _frames(gallery, frame_range(frames), every, sheet, film)
    followed = _ids(agents)
    words = tuple(word for word in show.replace(" ", "").split(",") if word and word != "none")
    folder = out if out is not None else cache / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    drawn = _draw(gallery, wanted, camera, followed, words, width, height, threads or _cores())
    _keep(drawn, gallery, folder, sheet, film)


def _cores() -> int:
    import os

    return os.cpu_count() or 1


def _gallery(folder: Path) -> Gallery:
    from antdsl.outputs.cache import CacheError, open_cache
    from antdsl.outputs.gallery import Gallery, NoPicture
    from antdsl.outputs.manifest import ManifestError

    try:
        return Gallery(open_cache(folder))
    except (ManifestError, CacheError) as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "name the folder that `antdsl run` printed") from None
    except NoPicture as why:
        raise Stop(Exit.FINDINGS, f"error: {why}", "add it to `output: {attributes: …}` of the scene and run again") from None


def _frames(gallery: Gallery, between: Any, every: int | None, sheet: bool, film: bool) -> list[int]:
    there = gallery.cache.frames()
    if between is not None:
        there = [frame for frame in there if between.first <= frame <= between.last]
    if not there:
        raise Stop(Exit.INPUT_OUTPUT, "error: the cache has none of these frames", "`antdsl info CACHE` says which it has")
    if every is not None:
        return there[::every]
    if sheet and not film:
        steps = min(SHEET, len(there))
        return sorted({there[round(k * (len(there) - 1) / max(steps - 1, 1))] for k in range(steps)})
    return there if between is not None or film else there[-1:]


def _ids(text: str | None) -> tuple[int, ...]:
    if text is None:
        return ()
    try:
        return tuple(int(word) for word in text.split(",") if word.strip())
    except ValueError:
        raise typer.BadParameter(f"`{text}` is not a list of ids such as 3,17", param_hint="--agents") from None


def _draw(
    gallery: Gallery,
    frames: list[int],
    camera: View,
    agents: tuple[int, ...],
    show: tuple[str, ...],
    width: int,
    height: int,
    threads: int,
) -> list[tuple[int, Any]]:
    from antdsl.outputs.cache import CacheError
    from antdsl.outputs.pictures.render import Renderer

    renderer = Renderer(width, height, threads=threads)
    drawn = []
    standing: Camera | None = None
    for frame in frames:
        try:
            picture = gallery.picture(frame, agents=frozenset(agents))
        except CacheError as why:
            raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "`antdsl run SCENE --resume` writes damaged frames again") from None
        if standing is None or camera is View.eye:
            standing = _camera(gallery, picture, camera, agents, width / height)
        try:
            drawn.append((frame, renderer.draw(picture, standing, show=show)))
        except ValueError as why:
            raise typer.BadParameter(str(why), param_hint="--show") from None
    return drawn


def _camera(gallery: Gallery, picture: Picture, which: View, agents: tuple[int, ...], aspect: float) -> Camera:
    from antdsl.outputs.pictures.cameras import camera_at_eye_level, camera_over

    if which is View.eye:
        found = camera_at_eye_level(picture, agents[0] if agents else None)
        if found is None:
            raise Stop(
                Exit.FINDINGS, f"error: there is no agent {agents[0] if agents else ''} to stand beside".replace("  ", " ")
            )
        return found
    own = gallery.camera() if which is View.scene else None
    return own if own is not None else camera_over(picture, aspect=aspect)


def _keep(drawn: list[tuple[int, Any]], gallery: Gallery, folder: Path, sheet: bool, film: bool) -> None:
    from PIL import Image

    if sheet:
        from antdsl.outputs.pictures import contact_sheet

        path = folder / "sheet.png"
        Image.fromarray(contact_sheet([image for _, image in drawn], [f"frame {frame}" for frame, _ in drawn])).save(path)
        typer.echo(path)
    if film:
        from antdsl.outputs.pictures import film as write_film

        path = folder / "film.mp4"
        try:
            write_film([image for _, image in drawn], path, 1 / gallery.dt)
        except ImportError as why:
            raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "pip install 'antdsl[video]'") from None
        typer.echo(path)
    if not film:
        for frame, image in drawn[-1:] if sheet else drawn:
            path = folder / f"picture.{frame:04d}.png"
            Image.fromarray(image).save(path)
            typer.echo(path)
