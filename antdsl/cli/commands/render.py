"""`antdsl render CACHE`: creates stills, a contact sheet and a film from a cache."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.atomic_write import create_folder_durably, sync_files
from antdsl.cli.destinations import choose_default_path, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode, report_failures
from antdsl.cli.picture_arguments import (
    check_blender_request,
    check_camera,
    choose_samples,
    parse_cut,
    parse_full_strengths,
    parse_point,
    parse_window,
)
from antdsl.cli.printing.messages import print_note
from antdsl.cli.scheduler import (
    NO_TLS_OPTION,
    SCHEDULER_OPTION,
    TLS_OPTION,
    SchedulerAddress,
    choose_stop_exit_code,
    raise_on_sigterm,
    require_scheduler,
    run_cache_tasks,
)

if TYPE_CHECKING:
    from antdsl.outputs.drawing import DrawRequest, StillStore
    from antdsl.outputs.gallery import Gallery

PICTURES_PER_SHEET = 9  # pictures on a contact sheet if no frames are named
MAX_PICTURES = 100


class LegendPlacement(StrEnum):
    """Values of `--legend`."""

    beside = "beside"
    none = "none"


@report_failures("drawing stopped", "run the same command with `--resume` to draw the others")
def run_render_command(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Frames to draw. [default: the last; with --film, all]"),
    every: int = typer.Option(None, "--every", min=1, metavar="N", help="Draw only every Nth frame."),
    sheet: bool = typer.Option(
        False, "--sheet", help="Draw several frames on one picture, and the last frame as a separate picture."
    ),
    film: bool = typer.Option(False, "--film", help="Make an .mp4 film; needs the extra [video]."),
    show: str = typer.Option(
        "trail",
        "--show",
        metavar="WORD,…",
        help="Overlays: trail, flow, feelers, velocity, paths, ids; states: agents in their states' colours; `none`: nothing.",
    ),
    window: str = typer.Option(
        "1..2", "--window", metavar="A..B", help="Length of paths in seconds before and after the frame, at most 60."
    ),
    agents: str = typer.Option(
        None,
        "--agents",
        metavar="ID,…",
        help="Draw ids, velocities, paths and feelers of these agents only, also as `guards.17`; the eye camera follows the "
        "first.",
    ),
    width: int = typer.Option(960, "--width", min=16, max=8192, help="Pixels."),
    height: int = typer.Option(540, "--height", min=16, max=8192, help="Pixels."),
    camera: str = typer.Option(
        "scene",
        "--camera",
        metavar="VIEW",
        help="The scene's own (`scene`), NAME of another of its cameras, fitted to the crowd (`fit`), from `above`, straight "
        "above without perspective (`top`), at an agent's `eye` level, or `close` to an agent.",
    ),
    at: str = typer.Option(None, "--at", metavar="X,Y,Z", help="A camera at this point, in the scene's units, with `--look-at`."),
    look_at: str = typer.Option(None, "--look-at", metavar="X,Y,Z", help="What that camera looks at."),
    focal: float = typer.Option(None, "--focal", min=1.0, max=10_000.0, metavar="MM", help="Another focal length. [default: 35]"),
    f_stop: float = typer.Option(
        None, "--f-stop", min=0.0, max=10_000.0, metavar="N", help="Depth of field: focal length by lens diameter; 0 for none."
    ),
    focus: float = typer.Option(
        None, "--focus", min=1e-9, max=1e9, metavar="DISTANCE", help="Distance in focus, in the scene's units. [default: the aim]"
    ),
    blur: float = typer.Option(
        0.0, "--blur", min=0.0, max=1.0, metavar="SHARE", help="Motion blur: shutter time as a share of a frame."
    ),
    least: float = typer.Option(
        None,
        "--least",
        min=0.0,
        max=1000.0,
        metavar="PIXELS",
        help="Minimum drawn length of agents in pixels. [default: 7, up to three times their size]",
    ),
    marks: float = typer.Option(
        0.0, "--marks", min=0.0, max=200.0, metavar="PIXELS", help="Draw agents as discs of this diameter in pixels."
    ),
    full: list[str] = typer.Option(
        [], "--full", metavar="FIELD=VALUE", help="The strength that a field's last colour represents."
    ),
    blender: bool = typer.Option(
        False, "--blender", help="Render the exported scene with Blender's Cycles; needs the extras [blender] and [usd]."
    ),
    samples: int = typer.Option(None, "--samples", min=1, max=65_536, metavar="N", help="Cycles: paths per pixel. [default: 64]"),
    legend: LegendPlacement = typer.Option(
        LegendPlacement.beside, "--legend", help="Legend with states and scales: in a strip at the side, or none."
    ),
    cut: str = typer.Option(
        None, "--cut", metavar="'z > 0'", help="Section view: omit everything beyond a plane, in the scene's units."
    ),
    shot: str = typer.Option(
        None, "--shot", metavar="A..B", help="Frames A to B of the complete film: use its camera and legend for these pictures."
    ),
    resume: bool = typer.Option(False, "--resume", help="Draw only frames without a complete and current picture."),
    threads: int = typer.Option(0, "--threads", min=0, max=256, help="Number of threads; 0: all available cores."),
    scheduler: str = SCHEDULER_OPTION,
    tls: Path = TLS_OPTION,
    no_tls: bool = NO_TLS_OPTION,
    out: Path = typer.Option(None, "--out", metavar="DIR", help="Folder of the pictures. [default: pictures in the cache]"),
) -> None:
    """Draw frames of a cache."""
    from antdsl.cli.arguments import parse_frame_range, require_agents
    from antdsl.cli.commands.run import choose_threads
    from antdsl.outputs.drawing import DrawRequest, StillStore

    require_scheduler(scheduler, tls, no_tls)
    words = tuple(word for word in show.replace(" ", "").split(",") if word and word != "none")
    parse_window(window)
    parse_cut(cut)
    settings = DrawRequest(
        width,
        height,
        camera,
        words,
        cut=cut,
        window=window,
        full=tuple(parse_full_strengths(full).items()),
        least=least,
        marks=marks,
        blur=blur,
        legend=legend is LegendPlacement.beside,
        at=parse_point(at, "--at"),
        look_at=parse_point(look_at, "--look-at"),
        focal=focal,
        f_stop=f_stop,
        focus=focus,
        samples=choose_samples(samples, is_blender=blender),
    )
    if blender:
        check_blender_request(settings, bool(scheduler))
    gallery = _open_gallery(cache, settings)
    settings = replace(settings, agents=tuple(require_agents(agents, gallery.manifest, "--agents")))
    check_camera(gallery, settings)
    drawn_frames = _choose_frames(gallery, parse_frame_range(frames), every, sheet, film)
    folder = out if out is not None else choose_default_path(cache, "pictures")
    require_writable_folder(folder, "--out", *(["film.mp4"] if film else ["sheet.png"] if sheet else []))
    create_folder_durably(folder)
    if film:
        _require_film_support()
    camera_frames = (
        drawn_frames if shot is None else _choose_frames(gallery, parse_frame_range(shot, "--shot"), every, False, True)
    )
    stills = StillStore.build(folder, gallery.cache, settings, camera_frames)
    try:
        with raise_on_sigterm():
            if scheduler:
                if sheet and not film:
                    raise typer.BadParameter("a sheet has few pictures, so it is drawn on this machine", param_hint="--scheduler")
                if film and resume:
                    raise typer.BadParameter(
                        "a film cannot be resumed on a cluster; draw its frames there with "
                        "`--shot A..B --resume`, then the film here",
                        param_hint="--resume",
                    )
                existing_frames = [frame for frame in drawn_frames if resume and stills.read_still(frame) is not None]
                new = [frame for frame in drawn_frames if frame not in set(existing_frames)]
                if new:
                    _draw_on_cluster(
                        (scheduler, tls, no_tls), cache, settings, new, camera_frames, folder, 1 / gallery.dt if film else None
                    )
                _report_skipped(len(existing_frames))
                return
            pictures = _draw_frames(
                gallery, settings, drawn_frames, camera_frames, choose_threads(threads), stills if resume else None
            )
            if film:
                _write_film((image for _, image, _ in pictures), gallery, folder)
            elif sheet:
                _write_sheet([(frame, image) for frame, image, _ in pictures], stills)
            else:
                _write_stills(pictures, stills)
    except KeyboardInterrupt as error:
        advice = "run the same command with `--resume` to draw the others"
        raise CommandError(choose_stop_exit_code(error), "stopped: all written pictures are complete", advice) from None


def _open_gallery(folder: Path, settings: DrawRequest) -> Gallery:
    from antdsl.outputs.cache.cache_reader import CacheError
    from antdsl.outputs.cache.manifest import ManifestError
    from antdsl.outputs.edits.edited_cache import open_edited_cache
    from antdsl.outputs.gallery import PictureUnavailable

    try:
        return settings.gallery(open_edited_cache(folder))
    except (ManifestError, CacheError) as error:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", "name the folder that `antdsl run` printed") from None
    except PictureUnavailable as error:
        advice = "add it to the scene's `output: {attributes: …}` and run again"
        if "field" in str(error):
            advice = "`antdsl info CACHE` lists its fields"
        raise CommandError(ExitCode.FINDINGS, f"error: {error}", advice) from None


def _choose_frames(gallery: Gallery, frame_range: Any, frame_step: int | None, sheet: bool, film: bool) -> list[int]:
    cache_frames = gallery.cache.frames()
    if frame_range is not None:
        cache_frames = [frame for frame in cache_frames if frame_range.first <= frame <= frame_range.last]
    if not cache_frames:
        message = "error: the cache has none of these frames"
        raise CommandError(ExitCode.INPUT_OUTPUT, message, "`antdsl info CACHE` lists its frames")
    if frame_step is not None:
        cache_frames = cache_frames[::frame_step]
        if not sheet or film or len(cache_frames) <= MAX_PICTURES:
            return cache_frames
        words = f"error: {len(cache_frames)} pictures do not fit on a sheet"
        raise CommandError(ExitCode.USAGE, words, f"use a larger `--every`, for at most {MAX_PICTURES} pictures")
    if sheet and not film:
        steps = min(PICTURES_PER_SHEET, len(cache_frames))
        return sorted({cache_frames[round(k * (len(cache_frames) - 1) / max(steps - 1, 1))] for k in range(steps)})
    return cache_frames if frame_range is not None or film else cache_frames[-1:]


def _draw_frames(
    gallery: Gallery,
    settings: DrawRequest,
    frames: list[int],
    camera_frames: list[int],
    threads: int,
    stored_stills: StillStore | None,
) -> Iterator[tuple[int, Any, bool]]:
    """Yield, for each frame, its number, its picture, and whether it was drawn now instead of read from `stored_stills`.

    `camera_frames`: the frames from which an automatic camera is chosen."""
    from antdsl.outputs.blender.rendering import BlenderError
    from antdsl.outputs.cache.cache_reader import CacheError
    from antdsl.outputs.drawing import AgentMissing
    from antdsl.outputs.gallery import PictureUnavailable
    from antdsl.outputs.provenance import make_resume_command

    drawn_images: Iterator[Any] | None = None
    try:
        for number, frame in enumerate(frames):
            stored_image = None if stored_stills is None else stored_stills.read_still(frame)
            if stored_image is not None:
                yield frame, stored_image, False
                continue
            if drawn_images is None:
                left = [each for each in frames[number:] if stored_stills is None or stored_stills.read_still(each) is None]
                drawn_images = _draw_images(gallery, settings, left, camera_frames, threads)
            yield frame, next(drawn_images), True
    except CacheError as error:
        advice = f"to recompute damaged frames: {make_resume_command(gallery.cache.folder)}"
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", advice) from None
    except PictureUnavailable as error:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", "run the scene again into another folder") from None
    except (AgentMissing, BlenderError) as error:
        raise CommandError(ExitCode.FINDINGS, f"error: {error}") from None
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--show") from None


def _draw_images(
    gallery: Gallery, settings: DrawRequest, frames: list[int], camera_frames: list[int], threads: int
) -> Iterator[Any]:
    """Yield the picture of each frame, which antdsl draws or Blender renders. `camera_frames`: as for `_draw_frames`."""
    from antdsl.outputs.blender.rendering import render_with_blender
    from antdsl.outputs.drawing import FrameDrawer

    if settings.samples:
        yield from render_with_blender(gallery, settings, frames, camera_frames, threads)
        return
    drawer = FrameDrawer(gallery, settings, camera_frames, threads)
    for frame in frames:
        yield drawer.draw(frame)


def _draw_on_cluster(
    scheduler: SchedulerAddress,
    cache: Path,
    settings: DrawRequest,
    frames: list[int],
    camera_frames: list[int],
    folder: Path,
    fps: float | None,
) -> None:
    """Draw stills on a cluster's workers into `folder`. `camera_frames`: the frames from which an automatic camera is chosen.
    `fps`: if given, join the stills to a film with this frame rate."""
    from antdsl.outputs.drawing import make_still_path
    from antdsl.shots.stills import make_still_tasks

    stills = folder if fps is None else choose_default_path(folder, "film.frames")
    create_folder_durably(stills)
    for answered in run_cache_tasks(
        scheduler,
        cache,
        stills,
        lambda real_cache, destination: make_still_tasks(real_cache, settings, frames, camera_frames, destination),
    ):
        for frame in answered.task.document["frames"] if fps is None else ():
            print_note(str(make_still_path(folder, frame)))
    if fps is None:
        sync_files(make_still_path(folder, frame) for frame in frames)
    if fps is not None:
        _join_stills(
            [make_still_path(stills, frame) for frame in frames], folder / "film.mp4", fps, settings.width * settings.height
        )
        stills.rmdir()


def _join_stills(paths: list[Path], path: Path, fps: float, pixels_per_picture: int) -> None:
    """Join the picture files `paths` to the film `path`, then remove them. `pixels_per_picture`: the number of pixels of each
    picture."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.outputs.drawing import MAX_STILL_BYTES
    from antdsl.outputs.pictures import write_film
    from antdsl.reader.image_request import ImageError, read_image_file
    from antdsl.safe_read import read_size_limited

    def read_stills() -> Iterator[Any]:
        for each in paths:
            try:
                image = read_image_file(read_size_limited(each, MAX_STILL_BYTES), "PNG", ("RGB",), pixels_per_picture)
            except ImageError as error:
                raise OSError(None, str(error), str(each)) from None
            if image.samples is None:
                raise OSError(None, "is not the picture that was drawn", str(each))
            yield image.samples

    exit_on_errors(write_film(read_stills(), path, fps))
    for each in paths:
        each.unlink()
    print_note(str(path))


def _require_film_support() -> None:
    """End the command before anything is drawn if the extra for films is not installed."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.outputs.pictures import check_film_support

    exit_on_errors(check_film_support())


def _write_film(images: Iterator[Any], gallery: Gallery, folder: Path) -> None:
    """Write each picture to the film as soon as it is drawn. No stills are stored."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.outputs.pictures import write_film

    path = folder / "film.mp4"
    exit_on_errors(write_film(images, path, 1 / gallery.dt))
    print_note(str(path))


def _write_sheet(pictures: list[tuple[int, Any]], stills: StillStore) -> None:
    from antdsl.outputs.pictures import make_contact_sheet
    from antdsl.outputs.pictures.image_files import write_still

    path = stills.folder / "sheet.png"
    write_still(make_contact_sheet([image for _, image in pictures], [f"frame {frame}" for frame, _ in pictures]), path)
    print_note(str(path))
    picture = stills.write_still(*pictures[-1])
    sync_files([picture])
    print_note(str(picture))


def _write_stills(drawn_frames: Iterator[tuple[int, Any, bool]], stills: StillStore) -> None:
    existing_count, paths = 0, []
    for frame, image, new in drawn_frames:
        existing_count += not new
        if new:
            paths.append(stills.write_still(frame, image))
            print_note(str(paths[-1]))
    sync_files(paths)
    _report_skipped(existing_count)


def _report_skipped(count: int) -> None:
    if count:
        print_note(f"{count} {'picture was' if count == 1 else 'pictures were'} there already")
