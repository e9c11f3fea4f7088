"""One step: all phases in their order, each with the time that passed and that of the processors."""

from __future__ import annotations

from time import perf_counter, process_time

from antdsl.numerics.float_environment import is_standard, standard
from antdsl.runtime.faults import FaultStop
from antdsl.runtime.phases import PHASES
from antdsl.runtime.world import World

_SHORT = 200e-6  # s
_LAST = PHASES[-1][0]


def step(world: World) -> None:
    """Go on by one frame. Raises FaultStop after a whole step in which a value was at fault, if the options say `stop`,
    and LimitStop in the middle of one that would take more than the limits allow."""
    if is_standard():
        _step(world)
        return
    with standard():
        _step(world)


def _step(world: World) -> None:
    started, worked = perf_counter(), process_time()
    timings, spent = world.timings, world.worked
    for name, phase in PHASES:
        phase(world)
        ended = perf_counter()
        passed = ended - started
        # The processors' clock takes longer to read than many a phase of a small crowd: those have what passed, and the next that
        # takes longer the rest.
        done = worked + passed if passed < _SHORT and name != _LAST else process_time()
        timings[name] = timings.get(name, 0.0) + passed
        spent[name] = spent.get(name, 0.0) + done - worked
        started, worked = ended, done
    if world.faults.latest is not None and world.options.on_fault == "stop":
        raise FaultStop(world.faults.latest)
