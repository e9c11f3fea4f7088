"""Converts the clip lists of agents, in the form of Houdini's agent attributes, to a `ClipPlayback`.

Each agent has a list of clip names, with lists of their times, weights, transform groups and layers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.blending import NO_PARENT_LAYER, ClipBlendTree, ClipPlayback
from antdsl.bodies.agents.poses import REST_CLIP, ClipTable

Numbers = NDArray[Any]
_PADDING_INDEX = -2  # marks a clip or layer that an agent does not have


def build_playback(
    table: ClipTable,
    counts: Numbers,
    names: Numbers,
    times: Numbers,
    weights: Numbers,
    groups: Numbers | None = None,
    layer_ids: Numbers | None = None,
    layer_counts: Numbers | None = None,
    modes: Numbers | None = None,
    layer_weights: Numbers | None = None,
    parents: Numbers | None = None,
) -> ClipPlayback:
    """Return the `ClipPlayback` of n agents. Each argument except `counts` and `layer_counts` is an array in which the lists of
    all agents follow one another.

    `counts`: [n], the number of clips of each agent.
    `names`, `times`, `weights`: agentclipnames (text), agentcliptimes (s) and agentclipweights.
    `groups`: agentcliptransformgroups (text); "" is the complete rig.
    `layer_ids`: agentcliplayerids.
    `layer_counts`: [n], the number of layers of each agent.
    `modes`, `layer_weights`, `parents`: agentcliplayermodes, agentcliplayerweights and agentcliplayerparents.

    Without layers, clips are blended by their weights. Agents with equal lists of groups, layer ids, modes and parents share a
    tree.

    Raises KeyError for a clip that the definition does not have. Raises ValueError if the lists of an agent do not match each
    other or do not form one tree; the message names the agent.
    """
    n, counts = len(counts), np.asarray(counts, np.int64)
    if layer_counts is None:
        layer_counts = np.ones(n, np.int64)
        modes, layer_weights, parents = np.zeros(n, np.int32), np.ones(n, np.float32), np.full(n, NO_PARENT_LAYER, np.int32)
    layer_counts = np.asarray(layer_counts, np.int64)
    if modes is None or layer_weights is None or parents is None:
        raise ValueError("layers need modes, weights and parents: pass all three or none of them")
    of_clips = {"clip names": names, "clip times": times, "clip weights": weights, "groups": groups, "layer ids": layer_ids}
    of_layers = {"layer modes": modes, "layer weights": layer_weights, "layer parents": parents}
    lists = [(what, values, counts) for what, values in of_clips.items()]
    for what, values, expected_counts in lists + [(what, values, layer_counts) for what, values in of_layers.items()]:
        if values is not None and len(values) != int(expected_counts.sum()):
            raise ValueError(f"there are {len(values)} {what}, but the agents need {int(expected_counts.sum())}")
    clip_numbers = _look_up_numbers(names, table.find_clip)
    words, group_numbers = _find_distinct_names(groups, len(names))
    clips = _pad_lists(clip_numbers, counts, REST_CLIP).astype(np.int32)
    group = _pad_lists(group_numbers, counts, _PADDING_INDEX)
    layer = _pad_lists(np.zeros(len(names), np.int64) if layer_ids is None else layer_ids, counts, _PADDING_INDEX)
    mode, parent = _pad_lists(modes, layer_counts, _PADDING_INDEX), _pad_lists(parents, layer_counts, _PADDING_INDEX)
    structure = np.concatenate([group, layer, mode, parent], axis=1)
    _, first, tree = np.unique(structure, axis=0, return_index=True, return_inverse=True)
    trees = tuple(_build_agent_tree(int(agent), words, group, layer, mode, parent, counts, layer_counts) for agent in first)
    return ClipPlayback(
        trees, tree.reshape(-1).astype(np.int32), clips, _pad_lists(times, counts, 0.0),
        _pad_lists(weights, counts, 0.0).astype(np.float32), _pad_lists(layer_weights, layer_counts, 0.0).astype(np.float32),
    )  # fmt: skip


def _look_up_numbers(names: Numbers, number: Callable[[str], int]) -> NDArray[np.int64]:
    """Return a number for each name. `number`: a function that returns the number of one name. It is called once for each
    distinct name."""
    known, which = np.unique(np.asarray(names, np.str_), return_inverse=True)
    return np.array([number(str(name)) for name in known], np.int64)[which.reshape(-1)]


def _find_distinct_names(names: Numbers | None, count: int) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """Return the distinct names, and for each of `count` entries the index of its name. If `names` is None, all entries have an
    empty name."""
    if names is None:
        return ("",), np.zeros(count, np.int64)
    known, which = np.unique(np.asarray(names, np.str_), return_inverse=True)
    return tuple(str(name) for name in known), which.reshape(-1)


def _pad_lists(values: Numbers | None, counts: NDArray[np.int64], fill_value: float) -> Numbers:
    """Convert concatenated lists to rows [n, longest length], padded with `fill_value`. `counts`: the length of each list."""
    flat_values = np.asarray([] if values is None else values)
    kind = flat_values.dtype if len(flat_values) else np.asarray(fill_value).dtype
    padded_rows = np.full((len(counts), int(counts.max(initial=0))), fill_value, kind)
    rows = np.repeat(np.arange(len(counts)), counts)
    padded_rows[rows, np.arange(len(flat_values)) - np.repeat(np.cumsum(counts) - counts, counts)] = flat_values
    return padded_rows


def _build_agent_tree(
    agent: int, group_names: tuple[str, ...], group: Numbers, layer: Numbers, mode: Numbers, parent: Numbers, counts: Numbers,
    layer_counts: Numbers,
) -> ClipBlendTree:  # fmt: skip
    """Return the clip tree of one agent. The other arguments are the padded lists of all agents, with one row per agent."""
    clips, layers = slice(int(counts[agent])), slice(int(layer_counts[agent]))
    layer_ids, modes, parents = (row.tolist() for row in (layer[agent, clips], mode[agent, layers], parent[agent, layers]))
    try:
        return ClipBlendTree(tuple(layer_ids), tuple(group_names[k] for k in group[agent, clips]), tuple(modes), tuple(parents))
    except ValueError as wrong:
        raise ValueError(f"agent {agent}: {wrong}") from None
