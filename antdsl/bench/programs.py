"""Programs and scenes of the cases that are no examples: text, with the size of the crowd's place to be put in."""

from __future__ import annotations

from math import sqrt

SIGHT = 40.0  # mm, how far a boid sees others
NEIGHBOURS = 9.0  # others within it
PERSON_SIGHT = 3_000.0  # mm, how far a person reckons with others

BOIDS = """ant 1
"The three rules of boids: keep apart, go along, stay together."
use steering

species boid {
  size      4 mm
  max_speed 40 mm/s
  response  0.25 s

  start flock
  state flock { steer align(radius: 40 mm) * 0.5 + cohere(radius: 40 mm) * 0.1 }

  layers {
    separate(radius: 12 mm)
    state
  }
}
"""

CROWD = """ant 1
"People on an open place, each on a course of its own: round the others by velocities that meet nobody."
use steering

species person {
  size      0.5 m
  radius    0.22 m
  max_speed 1.35 m/s
  response  0.2 s

  start walking
  state walking { steer keep_clear(heading, within: 3 m, horizon: 2 s) }

  layers { state }
}
"""

# What one wrangle of a solver does: points that wander and keep apart.
NODE = """ant 1
"Ants that wander and keep apart, all in one node."
use steering

species ant {
  size      uniform(3.6 mm, 4.4 mm)
  max_speed 30 mm/s

  start wandering
  state wandering { steer wander(swing: 50 deg) }

  layers {
    separate(radius: 1.2 * size, fov: 35 deg)
    state
  }
}
"""


def plane_scene(species: str, agents: int, radius: float) -> str:
    """A scene of one species on the empty plane, in a disc of `radius` mm."""
    crowd = f"{{species: {species}, from: {species}.ant, count: {agents}, place: {{radius: {radius:.3f} mm}}}}"
    return f"antdsl: 1\nunits: mm\nfps: 24\nframes: 1..480\nseed: 1\ncrowd: [{crowd}]\n"


def seen_radius(agents: int, sight: float = SIGHT) -> float:
    """Radius (mm) of the disc in which so many see about nine others each within `sight`."""
    return sight * sqrt(agents / NEIGHBOURS)
