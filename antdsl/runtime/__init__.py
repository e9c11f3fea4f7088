"""The simulation of a shot: creates a world from a plan and a setting, and advances the world step by step.

`bind` (in `binding`) creates the world at its first frame. `step` runs each function in `phases.PHASES` once. During a step,
senses read the world as it was at the start of the step. The plan's blocks run on a backend (`backends`) and write requests
into an `EffectRequests`. Then claims, deposits, digging, births and deaths are resolved, in an order that does not depend on
the order of rows. `moving` moves all agents by their steering forces. `world` contains all mutable data. `checkpoints` writes,
reads and hashes the complete state."""

from antdsl.runtime.binding.bind_world import BindError, bind, set_flow, set_param
from antdsl.runtime.binding.binding_cache import BindingCache
from antdsl.runtime.checkpoints import CheckpointError, restore_checkpoint, state_hash, take_checkpoint
from antdsl.runtime.digging import take_dug_balls
from antdsl.runtime.faults import Fault, FaultStop, LimitStop
from antdsl.runtime.feet.feet_state import feet_hash
from antdsl.runtime.lifecycle import collect_emissions, list_event_names
from antdsl.runtime.phases import step
from antdsl.runtime.world import Items, Options, Population, World
from antdsl.scene.setting import CrowdData, FieldStartData, ItemData, MeshData, PlacementData, WorldSetting

__all__ = [
    "BindError",
    "BindingCache",
    "CheckpointError",
    "CrowdData",
    "Fault",
    "FaultStop",
    "FieldStartData",
    "ItemData",
    "Items",
    "LimitStop",
    "MeshData",
    "Options",
    "PlacementData",
    "Population",
    "World",
    "WorldSetting",
    "bind",
    "collect_emissions",
    "feet_hash",
    "list_event_names",
    "restore_checkpoint",
    "set_flow",
    "set_param",
    "state_hash",
    "step",
    "take_checkpoint",
    "take_dug_balls",
]
