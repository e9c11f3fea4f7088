"""Programs and scenes for the cases that are not examples. Their texts contain a placeholder for the size of the crowd's area."""

from __future__ import annotations

from math import sqrt

SIGHT_RADIUS_MM = 40.0  # mm, how far a boid sees others
MEAN_NEIGHBOURS = 9.0  # others within it
PERSON_SIGHT_RADIUS_MM = 3_000.0  # mm, how far a person reckons with others

BOIDS_PROGRAM = """ant 1
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

CROWD_PROGRAM = """ant 1
"People on an open place, each on its own course: round the others by velocities that avoid collisions."
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

# Ants on grids: two scents, read from the nine cells around; no obstacles, and agents do not avoid each other.
TRAILS_PROGRAM = """ant 1
"Ants on flat ground that find food by one scent and the nest by another."
use steering

world {
  surface ground
  items   food
  items   nest
}

field to_food on ground { cell 5 mm; half_life 29 s; combine max }
field to_nest on ground { cell 5 mm; half_life 29 s; combine max }

species ant {
  size      4 mm
  max_speed 120 mm/s
  response  0.1 s

  start search
  state search {
    steer climb(to_food, nearest: 9) + wander() * 0.3
    deposit to_nest 24 /s * exp(-time_in_state / 2 s)
    when touching(food) -> carry
  }
  state carry {
    steer climb(to_nest, nearest: 9) + wander() * 0.3
    deposit to_food 24 /s * exp(-time_in_state / 2 s)
    when touching(nest) -> search
  }

  layers { state }
}
"""

# What one wrangle of a solver does: points that wander and keep apart.
NODE_PROGRAM = """ant 1
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


def build_plane_scene(species: str, agents: int, radius: float) -> str:
    """Return a scene in which agents of one species fill a disc of `radius` mm on an otherwise empty plane."""
    crowd = f"{{species: {species}, from: {species}.ant, count: {agents}, place: {{radius: {radius:.3f} mm}}}}"
    return f"antdsl: 1\nunits: mm\nfps: 24\nframes: 1..480\nseed: 1\ncrowd: [{crowd}]\n"


def build_flat_ground(side_length: float) -> str:
    """Return a PLY file of a square with its centre at the origin, made of two triangles. `side_length`: the width in mm."""
    head = "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    corners = "".join(f"{x * side_length / 2:g} 0 {z * side_length / 2:g}\n" for x, z in ((-1, -1), (-1, 1), (1, 1), (1, -1)))
    return f"{head}element face 2\nproperty list uchar int vertex_indices\nend_header\n{corners}3 0 1 2\n3 0 2 3\n"


def build_trails_scene(agents: int) -> str:
    """Return a scene of `agents` ants from one nest, on a square metre with 200 x 200 scent cells, like krABMaga's example."""
    return f"""antdsl: 1
units: mm
fps: 24
frames: 1..480
seed: 1
contacts: off
world:
  ground: {{mesh: ground.ply}}
  food: {{there: {{at: [-375, 0, -375], on: ground, radius: 5 mm}}}}
  nest: {{home: {{at: [375, 0, 375], on: ground, radius: 5 mm}}}}
crowd: [{{species: ant, from: ant.ant, count: {agents}, place: {{on: ground, radius: 480 mm}}}}]
"""


def compute_disc_radius(agents: int, sight_radius: float = SIGHT_RADIUS_MM) -> float:
    """Return the radius (mm) of a disc in which each of `agents` agents has about nine others within `sight_radius` mm."""
    return sight_radius * sqrt(agents / MEAN_NEIGHBOURS)
