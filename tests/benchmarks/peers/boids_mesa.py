"""Boids of Mesa (Python): its own example, on a torus so wide that each sees about nine others. `boids_mesa.py AGENTS STEPS`."""

from __future__ import annotations

from math import pi, sqrt

from mesa.examples.basic.boid_flockers.model import BoidFlockers
from turns import NEIGHBOURS, read_arguments, timed, turns

SIGHT = 10.0


def main() -> None:
    """Start again for each turn."""
    agents, steps = read_arguments()
    side = SIGHT * sqrt(agents * pi / NEIGHBOURS)

    def turn() -> tuple[float, float]:
        model = BoidFlockers(population_size=agents, width=side, height=side, vision=SIGHT, seed=1)
        spent = timed(model.step, steps, warm=1)
        return spent, sum(len(boid.neighbors) for boid in model.agents) / agents

    turns(turn)


if __name__ == "__main__":
    main()
