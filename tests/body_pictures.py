"""Makes the pictures of the bodies of the library for docs/bodies.md, in their natural colours: `python tests/body_pictures.py
[WORD…]`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from meshes import grid
from PIL import Image

from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import NO_DRIVEN_POSE, PosedBody
from antdsl.outputs.pictures import Camera, Crowd, Picture, Solid, render_frame
from antdsl.outputs.pictures.camera import to_tuple
from antdsl.outputs.pictures.light import encode_srgb_values

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
WORDS = ("ant", "ant_soldier", "ant_queen", "roach", "spider", "hunter", "rabbit", "person")
WIDTH, HEIGHT, SCALE = 400, 260, 2  # pixels, and how much finer the picture is computed
LENGTH = 10.0
TOWARDS_EYE = np.array([0.25, 0.32, 1.0]) / np.linalg.norm([0.25, 0.32, 1.0])


def draw_body(word: str) -> Image.Image:
    """One agent with the body, in its idle clip, from the side, so near that it fills the picture."""
    definition = load_library_body(word)
    body = PosedBody(definition, [])
    colour = encode_srgb_values(body.compute_natural_colours(NO_DRIVEN_POSE, 1))
    clips = tuple(body.build_idle_clips(np.array([0]), 0.0))
    crowd = Crowd(
        word, np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]), np.full(1, LENGTH), colour,
        ids=np.array([0]), body=body, machine_clips=clips, is_marked=np.zeros(1, np.bool_),
    )  # fmt: skip
    points = body.compute_shape_points(crowd.compute_poses())[0][0].astype(np.float64) * LENGTH
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    aim = middle + np.array([0.0, 0.02 * radius, 0.0])
    eye = aim + TOWARDS_EYE * radius * (3.1 if word != "person" else 4.4)
    ground = Solid("ground", *grid(400.0 * LENGTH, 40, lambda x, z: np.full(np.shape(x), low[1])), "ground")
    camera = Camera(to_tuple(eye), to_tuple(aim), focal=50.0)
    image = render_frame(Picture((ground,), crowds=(crowd,)), camera, WIDTH * SCALE, HEIGHT * SCALE)
    return Image.fromarray(image).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS).quantize(200, dither=Image.Dither.NONE)


if __name__ == "__main__":
    for each in sys.argv[1:] or WORDS:
        draw_body(each).save(IMAGES / f"body_{each}.png", optimize=True)
        print(each, flush=True)
