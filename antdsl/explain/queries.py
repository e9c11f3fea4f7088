"""The function behind the command `explain`: it reports what an agent of a cache did in a frame, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.explain.history import CacheHistory, ExplainError, open_shot
from antdsl.explain.model import Explanation, StateInterval
from antdsl.explain.replaying import StepReplay
from antdsl.explain.state_timeline import read_state_timeline
from antdsl.explain.step_report import explain_agents
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.runtime.moving.scripted_walks import find_scripted_agents


def explain_agent_in_cache(
    cache: Cache,
    agent: int,
    frame: int,
    *,
    species: str | None = None,
    scene: Path | None = None,
    grants: Mapping[str, Path] | None = None,
    threads: int = 1,
) -> Explanation:
    """Return what an agent did in the step that leads to `frame`, and why. Nothing is written.

    The run is simulated again from the nearest checkpoint up to this step. The result must have the state hash in the cache.
    Raises ExplainError if the hash differs or the request is wrong, and CacheError for a damaged frame.

    `species`: may be None if the scene has only one species. `scene`: may be None if the scene file can be found from the cache.
    """
    name = _require_species(cache, species)
    _require_frame(cache, frame)
    stretches, alive = read_state_timeline(cache, name, agent)
    _require_alive(cache, name, agent, frame, stretches, alive)
    replay = StepReplay(CacheHistory.from_cache(cache, open_shot(cache, scene, grants), threads))
    explanation = explain_agents(replay, frame, [(name, agent)])[0]
    if explanation is None:
        raise make_absence_error(replay, name, agent, frame)
    return replace(explanation, strip=stretches, alive=alive)


def _require_species(cache: Cache, requested_species: str | None) -> str:
    names = [entry.name for entry in cache.manifest.species]
    if requested_species in names:
        return str(requested_species)
    species_list = ", ".join(f"`{name}`" for name in names)
    if requested_species is None:
        if len(names) == 1:
            return names[0]
        raise ExplainError(
            f"`{cache.folder}` has more than one species", f"name one with `--species`: {species_list}", usage=True
        )
    near = find_nearest_name(requested_species, names)
    words = f"no species `{requested_species}`"
    raise ExplainError(words, f"did you mean `{near}`?" if near else f"the species are: {species_list}", usage=True)


def _require_frame(cache: Cache, frame: int) -> None:
    """Raise ExplainError unless `frame` is in the cache and is not the first frame."""
    frames = cache.frames()
    if not frames:
        raise ExplainError(f"`{cache.folder}` has no frames", "run the scene first")
    if frame == cache.manifest.first:
        words = f"frame {frame} is the first: no step of this cache led to it"
        raise ExplainError(words, f"ask for a later one: `--frame {frame + 1}`", usage=True)
    if frame not in frames:
        raise ExplainError(f"no frame {frame}", f"`{cache.folder}` has {frames[0] + 1} to {frames[-1]} to explain", usage=True)


def _require_alive(
    cache: Cache,
    species: str,
    agent: int,
    frame: int,
    state_intervals: tuple[StateInterval, ...],
    lifetime: tuple[int, int] | None,
) -> None:
    """Raise ExplainError if the agent did not exist in the frame before `frame`. If this frame stores no ids, nothing is
    checked."""
    if "id" not in cache.manifest.attributes:
        return
    if lifetime is None:
        raise ExplainError(f"no {species} {agent}", _describe_agents(cache, species, agent, frame), usage=True)
    if not any(s.first <= frame - 1 <= s.last for s in state_intervals):
        lifetime_text = f"{species} {agent} exists from frame {lifetime[0]} to {lifetime[1]}"
        if frame <= lifetime[0]:
            words = f"{species} {agent} had not decided anything by frame {frame}"
            raise ExplainError(words, f"{lifetime_text}: its first step leads to {lifetime[0] + 1}", usage=True)
        raise ExplainError(f"{species} {agent} does not exist at frame {frame}", lifetime_text, usage=True)


def _describe_agents(cache: Cache, species: str, agent: int, frame: int) -> str:
    """Return a hint that lists some agents of a frame, and the id most similar to the requested one."""
    arrays = cache.frame(frame, frozenset(("id", "species")))
    ids = arrays["id"]
    if "species" in arrays:
        ids = ids[arrays["species"] == [entry.name for entry in cache.manifest.species].index(species)]
    if not len(ids):
        return f"no {species} lives at frame {frame}"
    near = find_nearest_name(str(agent), (str(each) for each in ids.tolist()))
    range_text = f"at frame {frame} there are {len(ids)}, from {int(ids.min())} to {int(ids.max())}"
    return f"did you mean {near}? {range_text}" if near else range_text


def make_absence_error(replay: StepReplay, species: str, agent: int, frame: int) -> ExplainError:
    """Return the error for an agent that was not traced. The reason may be that it was dead, in quarantine, or guided by the
    scene."""
    world = replay.restore_step_start(frame)
    population = world.populations[species]
    row = int(population.find_rows(np.array([agent]))[0])
    if row >= 0 and find_scripted_agents(world, population)[row]:
        return ExplainError(f"{species} {agent} decides nothing: it follows the `walk` of its crowd line", "")
    if row >= 0:
        return ExplainError(
            f"{species} {agent} is quarantined after a fault, and did nothing in the step to frame {frame}",
            "`antdsl run` reported the value that was not a number",
        )
    ids = population.ids
    range_text = f"there are {len(ids)}, from {int(ids.min())} to {int(ids.max())}" if len(ids) else "none lives"
    return ExplainError(f"no {species} {agent} at frame {frame - 1}", range_text, usage=True)
