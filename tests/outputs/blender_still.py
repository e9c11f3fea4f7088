"""Run by a Python with Blender: open a USD file, say what is in it as JSON, and render a still with motion blur.

blender_still.py FILE PICTURE FRAME"""

import json
import math
import sys

import bpy
import mathutils

source, picture, frame = sys.argv[1], sys.argv[2], int(sys.argv[3])
bpy.ops.wm.read_factory_settings(use_empty=True)
# Blender before 4.4 does not convert units
options = bpy.ops.wm.usd_import.get_rna_type().properties.keys()
bpy.ops.wm.usd_import(filepath=source, **({} if "apply_unit_conversion_scale" in options else {"scale": 0.001}))
scene = bpy.context.scene
scene.frame_set(frame)
drawn = bpy.context.evaluated_depsgraph_get()
instances, colours = [], set()
for each in drawn.object_instances:
    if each.is_instance:
        instances.append(list(each.matrix_world.translation))
        colour_attribute = each.object.data.attributes.get("displayColor")
        if colour_attribute is not None and len(colour_attribute.data):
            colours.add(tuple(round(part, 3) for part in list(colour_attribute.data[0].color)[:3]))
items = {
    each.name: list(each.matrix_world.translation) for each in bpy.data.objects if each.parent and each.parent.name == "items"
}
camera = bpy.data.objects.new("still", bpy.data.cameras.new("still"))
camera.data.clip_start = 0.001
scene.collection.objects.link(camera)
middle = sum((mathutils.Vector(place) for place in instances), mathutils.Vector()) / len(instances)
camera.location = middle + mathutils.Vector((0.08, 0.08, 0.05))
camera.rotation_euler = (middle - camera.location).to_track_quat("-Z", "Y").to_euler()
scene.camera = camera
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy = 3
sun.rotation_euler = (math.radians(45), 0, math.radians(40))
scene.collection.objects.link(sun)
scene.world = bpy.data.worlds.new("sky")
scene.world.color = (0.5, 0.6, 0.8)
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 16, False
scene.render.resolution_x, scene.render.resolution_y = 640, 360
scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.5
scene.view_settings.view_transform = "Standard"
scene.render.filepath = picture
bpy.ops.render.render(write_still=True)
image = bpy.data.images.load(picture)
values = list(image.pixels)
tinted = sum(1 for k in range(0, len(values), 4) if max(values[k : k + 3]) - min(values[k : k + 3]) > 0.5)
print(json.dumps({"instances": instances, "items": items, "colours": sorted(colours), "tinted": tinted}))
