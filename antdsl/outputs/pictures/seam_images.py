"""Bodies at the seam of a periodic world. A part that extends beyond one side is also drawn at the opposite side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.outputs.pictures.model import Crowd

_BODY_REACH = 1.0  # body lengths from an agent's position within which its body is drawn


def add_seam_images(crowds: tuple[Crowd, ...], box: PeriodicBox | None) -> tuple[Crowd, ...]:
    """Return crowds together with the images of agents that extend into the box of a periodic world (scene units).

    None as box means that the world is not periodic. For the next frame, an agent that wraps continues straight on, so that
    motion blur does not lead back across the world."""
    if box is None:
        return crowds
    moving = [_continue_motion(crowd, box) for crowd in crowds]
    return (*moving, *(image for crowd in moving for image in _iterate_images(crowd, box)))


def _continue_motion(crowd: Crowd, box: PeriodicBox) -> Crowd:
    """Return a crowd in which positions of the next frame are replaced by their nearest images."""
    if crowd.next_crowd is None:
        return crowd
    step = crowd.next_crowd.position - crowd.position
    position = crowd.position + box.move_points(step, box.find_nearest_images(step))
    return replace(crowd, next_crowd=replace(crowd.next_crowd, position=position))


def _iterate_images(crowd: Crowd, box: PeriodicBox) -> Iterator[Crowd]:
    """Yield the images of the agents near the sides of the box, as one crowd for each image of the box."""
    widths, low = np.array(box.widths), np.array(box.low)
    wraps, reach = widths > 0, (_BODY_REACH * crowd.scale)[:, None]
    for image in box.list_images()[1:]:
        displacement = image * widths
        position = crowd.position + displacement
        near = (~wraps | ((position >= low - reach) & (position <= low + widths + reach))).all(axis=1)
        if near.any():
            nearby = replace(crowd, paths=None, velocity=None).select_rows(near)
            following = nearby.next_crowd
            yield replace(
                nearby,
                position=position[near],
                next_crowd=None if following is None else replace(following, position=following.position + displacement),
            )
