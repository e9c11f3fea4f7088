"""Renders frames of a cache with Cycles in a child process that runs Blender. Pictures are returned as soon as they are
finished."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.child_processes import build_module_environment
from antdsl.diagnostics.model import Report
from antdsl.outputs.blender.requests import describe_frame, describe_light
from antdsl.outputs.drawing import DrawRequest, FrameDrawer
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import SUN_LIGHT, apply_tone_curve, decode_srgb, encode_srgb
from antdsl.outputs.usd.stage import UsdOptions, export_instances
from antdsl.packages import check_extra
from antdsl.safe_read import read_size_limited
from antdsl.scene.looks import LAMP_LOOK_WORD, SURFACE_KINDS
from antdsl.scene.scene_model import UNIT_MM
from antdsl.scene.setting import SENSOR_WIDTH_MM

PYTHON_VARIABLE = "BLENDER_PYTHON"  # environment variable: the path of a Python that has bpy, in place of this one
_SCRIPT = Path(__file__).with_name("cycles_script.py")
_DONE_WORD = "rendered"  # begins a line of the script about a finished frame
_MESSAGE_LINES = 12  # last lines of the child's messages, for an error

Image = NDArray[np.uint8]


class BlenderError(Exception):
    """Error if Blender ends before all pictures are rendered. The message is a complete explanation."""


def check_blender() -> Report:
    """Return an empty report if Blender and USD are installed, otherwise a report with an error that names the missing extra.

    Call this before rendering."""
    report = check_extra("`--blender`", "usd", "pxr")
    if PYTHON_VARIABLE not in os.environ:
        advice = f"or set the environment variable `{PYTHON_VARIABLE}` to a Python that has `bpy`"
        report.extend(check_extra("`--blender`", "blender", "bpy", advice))
    return report


def build_command() -> list[str]:
    """Return the command line of the rendering process, which reads a request from its standard input."""
    return [os.environ.get(PYTHON_VARIABLE, sys.executable), "-P", str(_SCRIPT)]


def build_request(
    gallery: Gallery,
    request: DrawRequest,
    frames: Sequence[int],
    camera_frames: Sequence[int],
    path_by_frame: Mapping[int, Path],
    stage: Path,
    threads: int,
) -> dict[str, Any]:
    """Return the request to render `frames` of the USD file `stage`.

    `camera_frames`: the frames that decide the camera, if it is common to all frames. `path_by_frame`: the file for the pixels of
    each frame. Raises AgentMissing in the same cases as `FrameDrawer`."""
    drawer = FrameDrawer(gallery, replace(request, legend=False), camera_frames, threads)
    times = (0, 1) if request.blur > 0 else (0,)
    return {
        "stage": str(stage),
        "metres_per_unit": UNIT_MM[gallery.manifest.units] / 1000,
        "size": (request.width, request.height),
        "samples": request.samples,
        "threads": threads,
        "blur": request.blur,
        "sensor": SENSOR_WIDTH_MM,
        "light": describe_light(gallery),
        "emission": {LAMP_LOOK_WORD: (decode_srgb(SURFACE_KINDS[LAMP_LOOK_WORD].colour) * SUN_LIGHT).tolist()},
        "frames": [
            {
                "frame": frame,
                "path": str(path_by_frame[frame]),
                **describe_frame(gallery, gallery.make_picture(frame), [drawer.make_camera(frame + later) for later in times]),
            }
            for frame in frames
        ],
    }


def render_with_blender(
    gallery: Gallery, request: DrawRequest, frames: Sequence[int], camera_frames: Sequence[int], threads: int
) -> Iterator[Image]:
    """Yield the pictures (height, width, 3) of the frames in order, each as soon as it is rendered.

    For the arguments see `build_request`. Files are written to a temporary folder, which is removed at the end. Raises
    BlenderError, AgentMissing, UsdError, CacheError, or OSError."""
    if not frames:
        return
    with TemporaryDirectory(prefix="antdsl-blender-") as folder:
        stage = Path(folder, "scene.usdc")
        later = set(gallery.cache.frames()) & {frame + 1 for frame in frames} if request.blur > 0 else set()
        export_instances(gallery, sorted({*frames, *later}), stage, UsdOptions(close=request.camera in ("close", "eye")))
        paths = {frame: Path(folder, f"{frame}.pixels") for frame in frames}
        blender_request = build_request(gallery, request, frames, camera_frames, paths, stage, threads)
        for frame in _run_blender(json.dumps(blender_request)):
            yield _read_pixels(paths[frame], request.height, request.width)
            paths[frame].unlink()


def _run_blender(request: str) -> Iterator[int]:
    """Yield the number of each frame as soon as its pixels are written. Raises BlenderError if the child ends before the last
    frame."""
    process = subprocess.Popen(
        build_command(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=build_module_environment(),
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        writer = Thread(target=_send_request, args=(process.stdin, request), daemon=True)
        writer.start()
        messages: deque[str] = deque(maxlen=_MESSAGE_LINES)
        for line in process.stdout:
            word, _, number = line.strip().partition(" ")
            if word == _DONE_WORD and number.isdecimal():
                yield int(number)
            elif line.strip():
                messages.append(line.rstrip())
        if process.wait() != 0:
            raise BlenderError("Blender stopped before it had rendered all pictures:\n" + "\n".join(messages))
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def _send_request(pipe: IO[str], request: str) -> None:
    """Write the request to the child's standard input. Do nothing if the child has already ended."""
    try:
        with pipe:
            pipe.write(request)
    except BrokenPipeError:
        pass


def _read_pixels(path: Path, height: int, width: int) -> Image:
    """Return the picture that a file of linear light contains, with the same tone curve as antdsl's own pictures."""
    size = height * width * 3 * np.dtype(np.float32).itemsize
    data = read_size_limited(path, size)
    if len(data) != size:
        raise BlenderError("Blender wrote a picture of another size")
    light = np.nan_to_num(np.frombuffer(data, np.float32)).reshape(height, width, 3)
    return encode_srgb(apply_tone_curve(light))
