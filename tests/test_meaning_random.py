"""Random programs: every number and state of every frame as a plain reading of the text has it, and the same on both backends."""

from __future__ import annotations

import random

import pytest
from meaning import FAST, WAYS, crowd, play
from random_programs import NAMES, NUMBERS, Author, Reading

FRAMES = 14


@pytest.mark.parametrize("seed", [*range(30), 1283])
def test_a_program_does_what_it_says(seed: int) -> None:
    program = Author(random.Random(seed)).program()
    seen = play(program.text, steps=FRAMES, ways=(WAYS[0], WAYS[2]))
    reading = Reading(program)
    for frame in range(FRAMES + 1):
        state = NAMES[seen.at("main.state", frame)[0]]
        numbers = [seen.at(name, frame)[0] for name in NUMBERS]
        told = (reading.state, [float(reading.now[name]) for name in NUMBERS])
        assert (state, numbers) == told, f"frame {frame}\n{program.text}"
        reading.step()
