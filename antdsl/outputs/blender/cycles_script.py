"""Renders frames of a USD file with Cycles. This script runs in a Python that has Blender (`bpy`), not in antdsl.

It reads a request as JSON (`rendering.py`) from standard input. For each frame, it writes the pixels to the path that the request
names: linear light, float32 (height, width, 3), top row first. Then it writes a line `rendered FRAME` to standard output."""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

LAMP_NAME = "antdsl_lamp"  # begins the names of lamps


class CyclesScene:
    """The scene in Blender that a request describes."""

    def __init__(self, request: dict[str, Any]) -> None:
        self._bpy: Any = import_module("bpy")
        self._mathutils: Any = import_module("mathutils")
        self._request = request

    def render(self) -> None:
        """Render all frames of the request."""
        self._open_stage()
        self._set_rendering()
        self._set_emission()
        self._add_sun()
        self._add_sky()
        scene, data = self._bpy.context.scene, self._bpy.data
        scene.camera = data.objects.new("antdsl_camera", data.cameras.new("antdsl_camera"))
        scene.camera.data.sensor_fit, scene.camera.data.sensor_width = "HORIZONTAL", self._request["sensor"]
        scene.camera.rotation_mode = "QUATERNION"
        scene.collection.objects.link(scene.camera)
        for each in self._request["frames"]:
            self._set_lamps(each["lamps"])
            self._set_camera(each["frame"], each["cameras"])
            scene.frame_set(each["frame"])
            self._render_frame(Path(each["path"]))
            print(f"rendered {each['frame']}", flush=True)

    def _open_stage(self) -> None:
        """Import a USD file into an empty scene, in metres, without its lights and its offset from the origin."""
        self._bpy.ops.wm.read_factory_settings(use_empty=True)
        # Blender before 4.4 does not convert units
        has_units = "apply_unit_conversion_scale" in self._bpy.ops.wm.usd_import.get_rna_type().properties
        scale = {} if has_units else {"scale": self._request["metres_per_unit"]}
        self._bpy.ops.wm.usd_import(filepath=self._request["stage"], import_lights=False, import_cameras=False, **scale)
        for thing in self._bpy.data.objects:
            if thing.parent is None:
                thing.location = (0, 0, 0)

    def _set_emission(self) -> None:
        """Make the materials of lamps emit light. The lamp objects cast no shadow, because each light source is inside its
        object."""
        radiance_by_material = self._request["emission"]
        for name, radiance in radiance_by_material.items():
            material = self._bpy.data.materials.get(name)
            surface = None if material is None else material.node_tree.nodes.get("Principled BSDF")
            if surface is not None:
                surface.inputs["Emission Color"].default_value = (*radiance, 1)
                surface.inputs["Emission Strength"].default_value = 1
        for thing in self._bpy.data.objects:
            if any(slot.material is not None and slot.material.name in radiance_by_material for slot in thing.material_slots):
                thing.visible_shadow = False

    def _add_sun(self) -> None:
        """Add the sun."""
        light = self._request["light"]
        strength = max(light["sun_irradiance"])
        if strength > 0:
            sun = self._bpy.data.lights.new("antdsl_sun", "SUN")
            sun.energy, sun.angle = strength, light["sun_angle"]
            sun.color = [each / strength for each in light["sun_irradiance"]]
            thing = self._bpy.data.objects.new("antdsl_sun", sun)
            thing.rotation_euler = self._mathutils.Vector(light["sun_direction"]).to_track_quat("Z", "Y").to_euler()
            self._bpy.context.scene.collection.objects.link(thing)

    def _add_sky(self) -> None:
        """Add the sky: a single colour for the lighting, and a gradient that is brighter towards the horizon for the camera."""
        light = self._request["light"]
        world = self._bpy.data.worlds.new("antdsl_sky")
        self._bpy.context.scene.world, world.use_nodes = world, True
        nodes, links = world.node_tree.nodes, world.node_tree.links
        backdrop, lit, mix = nodes["Background"], nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeMixShader")
        lit.inputs["Color"].default_value = (*light["sky"], 1)
        place, split, root, ramp, path = (
            nodes.new(f"ShaderNode{each}") for each in ("TexCoord", "SeparateXYZ", "Math", "ValToRGB", "LightPath")
        )
        root.operation = "SQRT"
        for element, name in zip(ramp.color_ramp.elements, ("horizon", "zenith"), strict=True):
            element.color = (*light[name], 1)
        for start, end in (
            (place.outputs["Generated"], split.inputs[0]),
            (split.outputs["Z"], root.inputs[0]),
            (root.outputs[0], ramp.inputs[0]),
            (ramp.outputs[0], backdrop.inputs["Color"]),
            (path.outputs["Is Camera Ray"], mix.inputs[0]),
            (lit.outputs[0], mix.inputs[1]),
            (backdrop.outputs[0], mix.inputs[2]),
            (mix.outputs[0], nodes["World Output"].inputs["Surface"]),
        ):
            links.new(start, end)

    def _set_lamps(self, lamps: list[dict[str, Any]]) -> None:
        """Replace the lamps of the previous frame by `lamps`."""
        for old in [thing for thing in self._bpy.data.objects if thing.name.startswith(LAMP_NAME)]:
            self._bpy.data.lights.remove(old.data)
        for each in lamps:
            bulb = self._bpy.data.lights.new(LAMP_NAME, "POINT")
            bulb.energy, bulb.shadow_soft_size = max(each["power"]), each["radius"]
            bulb.color = [part / bulb.energy for part in each["power"]]
            thing = self._bpy.data.objects.new(LAMP_NAME, bulb)
            thing.location = each["centre"]
            self._bpy.context.scene.collection.objects.link(thing)

    def _set_camera(self, frame: int, cameras: list[dict[str, Any]]) -> None:
        """Place the camera for a frame. If `cameras` also has the camera of the next frame, the camera moves evenly from one to
        the other."""
        thing = self._bpy.context.scene.camera
        thing.animation_data_clear()
        thing.data.animation_data_clear()
        for number, each in enumerate(cameras):
            lens = thing.data
            thing.matrix_world = self._mathutils.Matrix(each["matrix"])
            lens.type = "PERSP" if each["parallel_width"] is None else "ORTHO"
            lens.lens, lens.ortho_scale = each["focal"], each["parallel_width"] or 1
            lens.clip_start, lens.clip_end = each["reach"] / 1000, each["reach"] * 1000
            lens.dof.use_dof = each["f_stop"] is not None
            lens.dof.aperture_fstop, lens.dof.focus_distance = each["f_stop"] or 1, each["focus"]
            if len(cameras) > 1:
                thing.keyframe_insert("location", frame=frame + number)
                thing.keyframe_insert("rotation_quaternion", frame=frame + number)
                lens.dof.keyframe_insert("focus_distance", frame=frame + number)

    def _render_frame(self, path: Path) -> None:
        """Render the current frame, and write its pixels to a file. Blender first writes a temporary file next to it."""
        width, height = self._request["size"]
        picture = path.with_suffix(".exr")
        self._bpy.context.scene.render.filepath = str(picture)
        self._bpy.ops.render.render(write_still=True)
        image = self._bpy.data.images.load(str(picture))
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
        self._bpy.data.images.remove(image)
        picture.unlink()
        np.ascontiguousarray(pixels.reshape(height, width, 4)[::-1, :, :3]).tofile(path)

    def _set_rendering(self) -> None:
        """Set size, samples, threads and motion blur. Pixels are written as linear light, without a tone curve."""
        scene = self._bpy.context.scene
        scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
        scene.cycles.samples, scene.cycles.use_denoising = self._request["samples"], True
        scene.cycles.sample_clamp_indirect = 10
        scene.render.resolution_x, scene.render.resolution_y = self._request["size"]
        scene.render.resolution_percentage = 100
        scene.render.use_persistent_data = True
        if self._request["threads"]:
            scene.render.threads_mode, scene.render.threads = "FIXED", self._request["threads"]
        scene.render.use_motion_blur, scene.render.motion_blur_shutter = self._request["blur"] > 0, self._request["blur"]
        scene.render.motion_blur_position = "START"
        settings = scene.render.image_settings
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
        scene.view_settings.view_transform, scene.view_settings.exposure = "Raw", 0


if __name__ == "__main__":
    CyclesScene(json.load(sys.stdin)).render()
    os._exit(0)  # the modules of Blender may crash when the interpreter removes them
