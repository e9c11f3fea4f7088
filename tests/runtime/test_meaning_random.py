"""Random programs: every number and state of every frame as a plain reading of the text has it, and the same on both backends."""

from __future__ import annotations

import random

import meshes
import numpy as np
import pytest
import random_sensing
import random_vanishing
from meaning import OPTION_SETS, crowd, item, play
from random_programs import NAMES, NUMBERS, Author, Reading
from sampling import sampled

from antdsl.runtime import FieldStartData, MeshData, Options, World

FRAMES = 14
SENSING = (
    Options(on_fault="quarantine", backend="numpy"),
    Options(on_fault="quarantine", chunk=3, threads=2, shuffle_rows=3, backend="numpy"),
    Options(on_fault="quarantine", backend="native", wait_for_code=True, chunk=8, shuffle_rows=4),
    Options(on_fault="quarantine", backend="reference", shuffle_rows=2),
)


@pytest.mark.parametrize("seed", [*range(30), 1283])
def test_a_program_does_what_it_says(seed: int) -> None:
    program = Author(random.Random(seed)).program()
    history = play(program.text, steps=FRAMES, option_sets=(OPTION_SETS[0], OPTION_SETS[2]))
    reading = Reading(program)
    for frame in range(FRAMES + 1):
        state = NAMES[history.at("main.state", frame)[0]]
        numbers = [history.at(name, frame)[0] for name in NUMBERS]
        expected = (reading.state, [float(reading.now[name]) for name in NUMBERS])
        assert (state, numbers) == expected, f"frame {frame}\n{program.text}"
        reading.step()


@pytest.fixture(scope="module")
def place() -> dict[str, object]:
    """Hills with a boulder, a road, two sources and a nest, some scent to begin with."""
    return {
        "surfaces": {"ground": MeshData(*meshes.terrain(200.0, 12))},
        "obstacles": {"stones": MeshData(*meshes.ball(15.0, (40, 5, 10), 6))},
        "curves": {"way_in": np.array([[-80.0, 0, -80], [0, 0, 10], [80, 0, 60]])},
        "items": {"food": (item("f", 20, -20, 8, load=5), item("g", -40, 10, 8, load=2.5)), "nest": (item("n", 0, 0, 12),)},
        "field_start": {"trail": (FieldStartData(0.5, (0.0, 0.0, 0.0), 40.0),)},
        "seed": 9,
    }


@pytest.mark.parametrize("seed", range(8))
def test_backends_agree_on_what_agents_sense_and_do(seed: int, place: dict[str, object]) -> None:
    text = random_sensing.Sensing(seed).text
    agents = (crowd(9, radius=60), crowd(3, species="other", radius=60))
    history = play(text, *agents, world=random_sensing.WORLD, steps=6, option_sets=SENSING, **place)
    assert history.world.frame == 6 and history.world.faults.fault_count == 0  # what is no number loses against its bounds


@pytest.mark.parametrize("seed", sampled(range(60), [3]))
def test_backends_agree_on_species_that_die_out_and_come_back(seed: int, place: dict[str, object]) -> None:
    text = random_vanishing.Vanishing(seed).text
    agent_counts: list[tuple[int, ...]] = []
    crowds = (crowd(4, radius=60), crowd(3, species="other", radius=60), crowd(1, species="egg", radius=60))

    def count(world: World) -> None:
        agent_counts.append(tuple(len(world.populations[name]) for name in ("a", "other")))

    history = play(text, *crowds, world=random_sensing.WORLD, steps=14, option_sets=SENSING, each=count, **place)
    assert history.world.faults.fault_count == 0 and any(0 in each for each in agent_counts)
