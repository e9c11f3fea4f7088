"""People of RVO2 (C++, float32) by the package `pyrvo`: each follows its own course, with the numbers of the case `crowd`.
`crowd_rvo2.py AGENTS STEPS`. The wished velocities are set once: a step is `doStep` alone."""

from __future__ import annotations

from pyrvo import RVOSimulator
from turns import crowd, neighbours, read_arguments, timed, turns

DT, SIGHT, MOST, HORIZON, RADIUS, SPEED = 1 / 24, 3.0, 10, 2.0, 0.22, 1.35


def main() -> None:
    """Start again for each turn, so that the crowd has not spread."""
    agents, steps = read_arguments()
    positions, courses = crowd(agents, SIGHT)

    def turn() -> tuple[float, float]:
        simulator = RVOSimulator(DT, SIGHT, MOST, HORIZON, HORIZON, RADIUS, SPEED)
        for place, (x, y) in zip(positions, courses, strict=True):
            simulator.set_agent_pref_velocity(simulator.add_agent(place), (x * SPEED, y * SPEED))
        spent = timed(simulator.do_step, steps)
        return spent, neighbours([simulator.get_agent_position(k).to_tuple() for k in range(agents)], SIGHT)

    turns(turn)


if __name__ == "__main__":
    main()
