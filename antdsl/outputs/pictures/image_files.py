"""Writes pictures as PNG stills and, if the extra `[video]` is installed, as films."""

import errno
import io
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import atomic_path, write_atomically
from antdsl.diagnostics.model import Report
from antdsl.safe_read import open_size_limited

Image = NDArray[np.uint8]


def write_still(image: Image, path: Path) -> None:
    """Write a picture as PNG, atomically. Raises OSError if writing fails."""
    from PIL import Image as PillowImage

    data = io.BytesIO()
    PillowImage.fromarray(np.ascontiguousarray(image)).save(data, format="PNG")
    write_atomically(path, data.getvalue())


def check_film_support() -> Report:
    """Return an empty report if films can be written, else a report with an error that names the missing extra.

    Call this before drawing."""
    report = Report()
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError, OSError):
        message = "a film needs the extra `[video]`, which is not installed"
        report.error("missing-extra", message, None, help='run `pip install "antdsl[video]"`, or render stills with `--sheet`')
    return report


def write_film(images: Iterable[Image], path: Path, fps: float) -> Report:
    """Write pictures (h, w, 3) of equal size as an H.264 film. An odd last row or column is cut off, because the format requires
    even sizes.

    The report has an error if the extra `[video]` is missing, if there are no pictures, or if the file cannot be written."""
    report = check_film_support()
    if not report.ok:
        return report
    import imageio_ffmpeg

    pictures = iter(images)
    first = next(pictures, None)
    if first is None:
        report.error("no-pictures", "a film needs at least one frame", None, help="request frames that the cache contains")
        return report
    height, width = first.shape[0] // 2 * 2, first.shape[1] // 2 * 2
    try:
        with atomic_path(path, path.suffix or ".mp4") as part:
            writer = imageio_ffmpeg.write_frames(
                str(part), (width, height), fps=float(fps), quality=8, macro_block_size=2, ffmpeg_log_level="error"
            )
            writer.send(None)
            count = 0
            try:
                for image in _prepend_image(first, pictures):
                    writer.send(np.ascontiguousarray(image[:height, :width]))
                    count += 1
            finally:
                writer.close()
            _check_frame_count(part, count)
    except OSError as problem:
        why = (problem.strerror or "the encoder stopped").lower()
        message = f"cannot write the film `{path.name}`: {why}"
        report.error("cannot-write", message, None, "name an existing folder with free space")
    return report


def _check_frame_count(path: Path, count: int) -> None:
    """Raise OSError if a film has fewer frames than were drawn, or is incomplete. The encoder itself does not report a full
    disk."""
    import imageio_ffmpeg

    try:
        frame_count = imageio_ffmpeg.count_frames_and_secs(str(path))[0] or 0
    except RuntimeError:
        frame_count = 0
    if frame_count < count or not _is_complete(path):
        words = f"{min(frame_count, count - 1)} of {count} frames reached the disk, which may be full"
        raise OSError(errno.EIO, words, str(path))


def _is_complete(path: Path) -> bool:
    """Return whether the boxes of an MP4 file (ISO/IEC 14496-12) end exactly at the end of the file."""
    with open_size_limited(path, 1 << 62) as file:
        end, place = os.fstat(file.fileno()).st_size, 0
        while place < end:
            file.seek(place)
            head = file.read(16)
            size = int.from_bytes(head[:4], "big")
            size = int.from_bytes(head[8:16], "big") if size == 1 else size
            if len(head) < 8 or size < 8:
                return False
            place += size
    return place == end


def _prepend_image(first: Image, others: Iterable[Image]) -> Iterable[Image]:
    """Yield `first`, then the other pictures."""
    yield first
    yield from others
