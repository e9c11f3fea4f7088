"""People of JuPedSim (C++, float64) on an open place: its collision-free speed model, each on its own course, as many within
3 m as in the case `crowd`; it ignores people farther off. `crowd_jupedsim.py AGENTS STEPS`."""

from __future__ import annotations

import jupedsim as jps
from turns import crowd, neighbours, read_arguments, timed, turns

SIGHT, RADIUS, SPEED, FAR = 3.0, 0.22, 1.35, 100.0


def main() -> None:
    """Run on from turn to turn: in steps of 0.01 s the crowd hardly spreads, and to add people takes longer than their steps."""
    agents, steps = read_arguments()
    positions, courses = crowd(agents, SIGHT)
    half = max(abs(part) for place in positions for part in place) + 2 * FAR
    area = [(-half, -half), (half, -half), (half, half), (-half, half)]
    simulation = jps.Simulation(model=jps.CollisionFreeSpeedModel(), geometry=area)
    stage = simulation.add_direct_steering_stage()
    journey = simulation.add_journey(jps.JourneyDescription([stage]))
    for (x, y), (east, north) in zip(positions, courses, strict=True):
        person = jps.CollisionFreeSpeedModelAgentParameters(
            position=(x, y), desired_speed=SPEED, radius=RADIUS, journey_id=journey, stage_id=stage
        )
        simulation.agent(simulation.add_agent(person)).target = (x + FAR * east, y + FAR * north)

    def turn() -> tuple[float, float]:
        spent = timed(simulation.iterate, steps)
        return spent, neighbours([person.position for person in simulation.agents()], SIGHT)

    turns(turn)


if __name__ == "__main__":
    main()
