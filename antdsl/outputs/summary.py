"""The summary of a run as one JSON document, written with `--summary`."""

from __future__ import annotations

import json
from typing import Any

from antdsl.numerics.processor.host import measure_peak_memory
from antdsl.outputs.recording import Recording


def summarise_run(recording: Recording) -> dict[str, Any]:
    """Return counts, speeds and measurements of a run.

    Only `seconds`, `fps` and the peak memory may differ between runs with equal inputs."""
    world = recording.world
    stepping = recording.seconds.get("step", 0.0) + recording.seconds.get("hand_over", 0.0)
    steps = recording.steps
    return {
        "agents": len(world),
        "frames": 0 if recording.frame is None else recording.frame - recording.shot.frames.first + 1,
        "fps": round(steps / stepping, 3) if stepping > 0 else 0.0,
        "seconds": {
            name: round(value, 6)
            for name, value in {
                **recording.seconds,
                **recording.frame_seconds,
                **recording.writer_seconds,
                **world.timings,
            }.items()
        },
        "states": count_states(recording),
        "transitions": dict(world.transitions),
        "items": {
            name: {attribute: float(amount.sum()) for attribute, amount in items.amounts.items()}
            for name, items in world.items.items()
        },
        "carried": sum_carried_amounts(recording),
        "faults": world.faults.fault_count,
        "max_surface_error": recording.surface_error,
        "motion": world.motion.summarise(),
        **({} if world.detail_levels is None else {"lod": world.detail_levels.summarise_counts(world)}),
        **({"measures": dict(recording.measures.values)} if recording.measures is not None and recording.measures.values else {}),
        "state_hash": recording.last_state_hash,
        "peak_memory": measure_peak_memory(),
    }


def count_states(recording: Recording) -> dict[str, int]:
    """Return the number of agents in each state, by `species.state`, or by `species.machine.state` for states of a named
    machine."""
    import numpy as np

    agent_counts: dict[str, int] = {}
    for name, population in recording.world.populations.items():
        for machine in population.plan.machines:
            counts = np.bincount(population.now[f"{machine.name}.state"], minlength=len(machine.states))
            prefix = name if machine.name == "main" else f"{name}.{machine.name}"
            agent_counts |= {f"{prefix}.{state}": int(count) for state, count in zip(machine.states, counts, strict=True)}
    return agent_counts


def sum_carried_amounts(recording: Recording) -> dict[str, float]:
    """Return the sum over all agents of each attribute that items also have, by `species.attribute`.

    These sums are the amounts in transit between items."""
    import numpy as np

    shared_attributes = {attribute for items in recording.world.items.values() for attribute in items.amounts}
    return {
        f"{name}.{attribute}": float(population.now[attribute].astype(np.float64).sum())
        for name, population in recording.world.populations.items()
        for attribute in sorted(shared_attributes)
        if attribute in population.now
    }


def encode_summary(recording: Recording) -> bytes:
    """Return the summary of a run as the bytes of its file."""
    return (json.dumps(summarise_run(recording), indent=1) + "\n").encode()
