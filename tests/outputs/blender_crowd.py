"""Run by a Python with Blender: open a USD file, and print as JSON what its agents are in some frames.

blender_crowd.py FILE FRAME…"""

import json
import sys

import bpy
import numpy as np

source, frames = sys.argv[1], [int(word) for word in sys.argv[2:]]
bpy.ops.wm.read_factory_settings(use_empty=True)
options = bpy.ops.wm.usd_import.get_rna_type().properties.keys()
# Blender before 4.4 does not convert units
bpy.ops.wm.usd_import(filepath=source, **({} if "apply_unit_conversion_scale" in options else {"scale": 0.001}))


def find_agent(thing):  # type: ignore[no-untyped-def]
    """Return the name of the agent that an object belongs to, or None."""
    while thing is not None and not thing.name.startswith("agent_"):
        thing = thing.parent
    return None if thing is None else thing.name


meshes = [(find_agent(thing), thing) for thing in bpy.data.objects if thing.type == "MESH" and find_agent(thing)]
agents = {name: {"points": {}, "materials": set(), "colours": []} for name, _ in meshes}
for name, thing in meshes:
    agents[name]["materials"] |= {slot.material.name for slot in thing.material_slots}
    colours = thing.data.attributes.get("displayColor")
    agents[name]["colours"] += [list(colours.data[0].color)[:3]] if colours is not None and len(colours.data) else []
for frame in frames:
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    for name, thing in meshes:
        posed = thing.evaluated_get(graph)
        mesh = posed.to_mesh()
        points = np.zeros(3 * len(mesh.vertices))
        mesh.vertices.foreach_get("co", points)
        matrix = np.array(posed.matrix_world)
        agents[name]["points"].setdefault(frame, []).extend((points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]).tolist())
        posed.to_mesh_clear()
print(json.dumps({name: {**each, "materials": sorted(each["materials"])} for name, each in agents.items()}))
