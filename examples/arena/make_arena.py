"""Writes height.png and rim.json of this example: `python examples/arena/make_arena.py`.

A height image of 161 × 161 samples in 16 bits for an arena of 160 × 160 m, and the line along its rim. The same numbers give the
same files."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from antdsl.bodies.shapes import compute_wave_noise

HERE = Path(__file__).parent
SIDE, SAMPLES = 160.0, 161  # m
HIGH = 6.0  # m, of the whole range of the image


def heights() -> np.ndarray:
    """Hills of 70 m across and folds of 15 m, float64[SAMPLES, SAMPLES] in m; rows go along z, columns along x."""
    axis = np.linspace(-SIDE / 2, SIDE / 2, SAMPLES)
    x, z = np.meshgrid(axis, axis)
    places = np.stack([x.ravel(), z.ravel()], axis=1)
    height = 1.3 * compute_wave_noise(places, 41, 70.0, 2) + 0.12 * compute_wave_noise(places, 42, 15.0, 2)
    return np.clip(height.reshape(SAMPLES, SAMPLES) + HIGH / 2, 0.0, HIGH)


if __name__ == "__main__":
    whole = np.round(heights() / HIGH * 65535).astype(np.uint16)
    Image.fromarray(whole).save(HERE / "height.png", optimize=True)
    half = SIDE / 2
    corners = [(-half, -half), (half, -half), (half, half), (-half, half), (-half, -half)]
    (HERE / "rim.json").write_text(json.dumps([[x, 0.0, z] for x, z in corners]) + "\n")
