"""Overlays on a picture: agents as discs, paths, velocities and feelers as lines, and ids as text."""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from antdsl.bodies.body import rotate_vectors
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.model import AgentPathLines, Crowd, FlowArrows, Picture

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_VELOCITY_COLOUR, _FEELER_COLOUR = (255, 250, 235), (255, 96, 64)
# head of an arrow: its length as a share of the arrow, and its angle (radians)
_ARROW_HEAD_LENGTH, _ARROW_HEAD_ANGLE = 0.34, 0.45
_VELOCITY_LINE_SECONDS = 0.25  # seconds of motion that a velocity line shows
_MAX_DRAWN_IDS = 2000
_PAST_PATH_COLOUR, _FUTURE_PATH_COLOUR = (20, 24, 30), (255, 236, 120)  # colours of past and future paths
_PATH_ALPHA_RANGE, _PATH_ALPHA_STEPS = (40, 235), 8  # opacity at the far ends and at the agent; steps between them


@cache
def load_font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Pillow's built-in typeface at `size` pixels."""
    return ImageFont.load_default(size)


def draw_overlay(
    image: Image, picture: Picture, view: CameraView, distances: NDArray[np.float32], show: tuple[str, ...], marks: float
) -> Image:
    """Return `image` with the overlays that `show` names. Parts behind the ground are omitted.

    `distances` (h, w): the distances of static surfaces. `marks`: the diameter in pixels of the discs that represent agents; 0
    for none."""
    lines = [word for word in ("flow", "velocity", "paths", "feelers", "ids") if word in show]
    if not lines and marks <= 0:
        return image
    canvas = PillowImage.fromarray(image)
    if marks > 0:
        _draw_marks(canvas, picture, view, distances, marks)
    draw = ImageDraw.Draw(canvas, "RGBA")
    for flow in picture.flows if "flow" in show else ():
        _draw_arrows(draw, view, flow, _is_unhidden(flow.position, view, distances))
    for crowd in picture.crowds if "paths" in show else ():
        if crowd.paths is not None:
            _draw_paths(draw, view, crowd.paths, distances)
    for crowd in picture.crowds:
        is_visible = _find_visible_agents(crowd, view, distances)
        if "velocity" in show and crowd.velocity is not None:
            lift = _compute_lifted_positions(crowd)[is_visible]
            _draw_lines(
                draw,
                view,
                np.stack([lift, lift + _VELOCITY_LINE_SECONDS * np.asarray(crowd.velocity)[is_visible]], axis=1),
                _VELOCITY_COLOUR,
            )
        if "feelers" in show and crowd.feelers is not None and len(crowd.feelers):
            ends = np.asarray(crowd.feelers, np.float64)
            _draw_lines(draw, view, ends[_is_unhidden(ends[:, 0], view, distances)], _FEELER_COLOUR)
        if "ids" in show and crowd.ids is not None:
            _draw_ids(draw, view, crowd, np.flatnonzero(is_visible)[:_MAX_DRAWN_IDS])
    return np.asarray(canvas)


def _compute_lifted_positions(crowd: Crowd) -> Array:
    """Return the agents' positions, lifted from the ground to the height of the body."""
    up = rotate_vectors(np.asarray(crowd.orient, np.float64), np.tile([0.0, 1.0, 0.0], (len(crowd.position), 1)))
    return np.asarray(crowd.position, np.float64) + up * 0.25 * np.asarray(crowd.scale, np.float64)[:, None]


def _find_visible_agents(crowd: Crowd, view: CameraView, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return a mask of the agents of a crowd that are in the picture, and not hidden by a static surface. `depth`: see
    `_is_unhidden`."""
    return _is_unhidden(_compute_lifted_positions(crowd), view, depth) if len(crowd.position) else np.zeros(0, np.bool_)


def _is_unhidden(points: Array, view: CameraView, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return a mask of the points that are in the picture, and not hidden by a static surface. `depth` (h, w): distances of
    static surfaces."""
    pixels, ahead = view.project(points)
    inside = (ahead > 0) & (pixels >= 0).all(axis=1) & (pixels[:, 0] < view.width) & (pixels[:, 1] < view.height)
    column, row = np.where(inside[:, None], pixels, 0).astype(np.int64).T
    distance = view.compute_distances(points)
    near = distance <= depth[row, column] * 1.005 + view.compute_pixel_size(np.maximum(ahead, 0)) * 2
    return np.asarray(inside & near)


def _draw_lines(draw: ImageDraw.ImageDraw, view: CameraView, end_points: Array, colour: tuple[int, int, int]) -> None:
    """Draw lines with end points (n, 2, 3). A line is omitted if one end is not in front of the camera."""
    if not len(end_points):
        return
    pixels, ahead = view.project(end_points.reshape(-1, 3))
    pairs = pixels.reshape(-1, 4)
    is_drawn = (ahead.reshape(-1, 2) > 0).all(axis=1) & (np.abs(pairs) < 1e5).all(axis=1)
    width = 2 if view.height >= 900 else 1
    for a, b, c, d in pairs[is_drawn].tolist():
        draw.line((a, b, c, d), fill=(*colour, 215), width=width)


def _draw_paths(draw: ImageDraw.ImageDraw, view: CameraView, paths: AgentPathLines, depth: NDArray[np.float32]) -> None:
    """Draw paths, with past positions dark and future positions bright, fainter towards the ends.

    Segments with a hidden or missing end are omitted. The segments nearest to the current frame are drawn last, on top."""
    count, frames = paths.positions.shape[:2]
    points = paths.positions.reshape(-1, 3)
    is_present = np.isfinite(points).all(axis=1)
    is_visible = np.zeros(len(points), np.bool_)
    is_visible[is_present] = _is_unhidden(points[is_present], view, depth)
    pixels = np.zeros((len(points), 2))
    pixels[is_visible] = view.project(points[is_visible])[0]
    visible_steps, flat = is_visible.reshape(count, frames), pixels.reshape(count, frames, 2)
    width = 3 if view.height >= 900 else 2
    order = [*range(paths.current_index), *reversed(range(paths.current_index, frames - 1))]  # from each end towards the agent
    for k in order:
        ahead = k >= paths.current_index
        share = (
            (k + 1 - paths.current_index) / max(frames - 1 - paths.current_index, 1)
            if ahead
            else (paths.current_index - k) / max(paths.current_index, 1)
        )
        shade = np.ceil((1.0 - share) * _PATH_ALPHA_STEPS) / _PATH_ALPHA_STEPS
        alpha = round(_PATH_ALPHA_RANGE[0] + (_PATH_ALPHA_RANGE[1] - _PATH_ALPHA_RANGE[0]) * float(shade))
        both = visible_steps[:, k] & visible_steps[:, k + 1]
        for line in flat[both, k : k + 2].reshape(-1, 4).tolist():
            draw.line(line, fill=(*(_FUTURE_PATH_COLOUR if ahead else _PAST_PATH_COLOUR), alpha), width=width)


def _draw_arrows(draw: ImageDraw.ImageDraw, view: CameraView, flow: FlowArrows, is_visible: NDArray[np.bool_]) -> None:
    """Draw those arrows of a flow that start at a visible point."""
    start, displacement = flow.position[is_visible], flow.displacement[is_visible]
    if not len(start):
        return
    (a, near), (b, far) = view.project(start), view.project(start + displacement)
    is_drawn = (near > 0) & (far > 0) & (np.abs(a) < 1e5).all(axis=1) & (np.abs(b) < 1e5).all(axis=1)
    a, b = a[is_drawn], b[is_drawn]
    back = (a - b) * _ARROW_HEAD_LENGTH
    c, s = np.cos(_ARROW_HEAD_ANGLE), np.sin(_ARROW_HEAD_ANGLE)
    for sign in (-1, 1):
        turned = np.stack([back[:, 0] * c - sign * back[:, 1] * s, sign * back[:, 0] * s + back[:, 1] * c], axis=1)
        for line in np.concatenate([b, b + turned], axis=1).tolist():
            draw.line(line, fill=(*flow.colour, 225), width=1)
    for line in np.concatenate([a, b], axis=1).tolist():
        draw.line(line, fill=(*flow.colour, 225), width=1)


def _draw_ids(draw: ImageDraw.ImageDraw, view: CameraView, crowd: Crowd, rows: NDArray[np.int64]) -> None:
    """Write the ids of the agents in `rows` next to their bodies."""
    if crowd.ids is None:
        return
    size = max(9, view.height // 54)
    pixels, _ = view.project(_compute_lifted_positions(crowd)[rows])
    for (x, y), name in zip(pixels.tolist(), np.asarray(crowd.ids)[rows].tolist(), strict=True):
        draw.text(
            (x + size * 0.3, y - size * 1.1),
            str(name),
            font=load_font(size),
            fill=(255, 255, 255, 235),
            stroke_width=1,
            stroke_fill=(0, 0, 0, 190),
        )


def _draw_marks(
    canvas: PillowImage.Image, picture: Picture, view: CameraView, distances: NDArray[np.float32], diameter: float
) -> None:
    """Draw a disc, `diameter` pixels wide, in the colour of each visible agent. Near discs cover far ones.

    For soft edges, the discs are drawn enlarged and then scaled down."""
    times = 4 if view.width * view.height <= 1 << 20 else 2
    sheet = PillowImage.new("RGBA", (view.width * times, view.height * times))
    draw = ImageDraw.Draw(sheet)
    discs = []
    for crowd in picture.crowds:
        is_visible = _find_visible_agents(crowd, view, distances)
        pixels, ahead = view.project(np.where(is_visible[:, None], _compute_lifted_positions(crowd), 0.0))
        colour = np.clip(np.nan_to_num(np.asarray(crowd.colour, np.float64)) * 255, 0, 255).round()
        discs.append(np.concatenate([ahead[:, None], pixels, colour], axis=1)[is_visible])
    every = np.concatenate(discs or [np.zeros((0, 6))])
    for _, x, y, *colour in every[np.argsort(-every[:, 0], kind="stable")].tolist():
        x, y, reach = x * times, y * times, diameter * times / 2
        edge = max(1.0, reach * 0.3)
        draw.ellipse((x - reach - edge, y - reach - edge, x + reach + edge, y + reach + edge), fill=(20, 20, 20, 255))
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), fill=(*(int(c) for c in colour), 255))
    small = sheet.resize((view.width, view.height), PillowImage.Resampling.BOX)
    canvas.paste(small, (0, 0), small)
