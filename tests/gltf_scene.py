"""A glTF file evaluated at a time as its specification says, apart from all readers and writers of antdsl: node transforms with
animation, skins, morph targets; and what the specification asks of accessors."""

from __future__ import annotations

import json
import struct
from base64 import b64decode
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
KIND = {5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


class Scene:
    def __init__(self, data: bytes) -> None:
        if data[:4] == b"glTF":
            version, length = struct.unpack_from("<II", data, 4)
            size, kind = struct.unpack_from("<II", data, 12)
            assert (version, length, kind) == (2, len(data), 0x4E4F534A) and size % 4 == 0
            self.tree: dict[str, Any] = json.loads(data[20 : 20 + size])
            assert struct.unpack_from("<II", data, 20 + size)[1] == 0x004E4942
            self.buffer = data[28 + size :]
        else:
            self.tree = json.loads(data)
            self.buffer = b64decode(self.tree["buffers"][0]["uri"].partition(",")[2])
        assert len(self.tree["buffers"]) == 1 and self.tree["buffers"][0]["byteLength"] == len(self.buffer)

    def array(self, number: int) -> np.ndarray:
        entry = self.tree["accessors"][number]
        view = self.tree["bufferViews"][entry["bufferView"]]
        kind, width = KIND[entry["componentType"]], WIDTH[entry["type"]]
        start = view["byteOffset"] + entry.get("byteOffset", 0)
        values = np.frombuffer(self.buffer, kind, entry["count"] * width, start).reshape(-1, width)
        return np.maximum(values / 32767, -1.0) if entry.get("normalized") else values

    def check(self) -> None:
        """Alignment, bounds and what must be there."""
        parts: dict[int, list[tuple[int, int]]] = {}
        for number, entry in enumerate(self.tree["accessors"]):
            view = self.tree["bufferViews"][entry["bufferView"]]
            size = np.dtype(KIND[entry["componentType"]]).itemsize
            start, length = entry.get("byteOffset", 0), entry["count"] * WIDTH[entry["type"]] * size
            assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= len(self.buffer)
            assert start % 4 == 0 and start + length <= view["byteLength"] and entry["count"] > 0
            assert entry.get("normalized", False) == (entry["componentType"] == 5122)
            parts.setdefault(entry["bufferView"], []).append((start, start + length))
            if "min" in entry:
                values = self.array(number)
                assert values.min(axis=0).tolist() == entry["min"] and values.max(axis=0).tolist() == entry["max"]
        assert len(parts) == len(self.tree["bufferViews"])
        for number, inside in parts.items():  # accessors fill their view, and none overlaps another
            ends = [0, *(end for _, end in sorted(inside))]
            assert all(0 <= start - end < 4 for (start, _), end in zip(sorted(inside), ends[:-1], strict=True))
            assert ends[-1] == self.tree["bufferViews"][number]["byteLength"]
        for mesh in self.tree["meshes"]:
            for each in mesh["primitives"]:
                count = self.tree["accessors"][each["attributes"]["POSITION"]]["count"]
                for name, number in each["attributes"].items():
                    assert self.tree["accessors"][number]["count"] == count
                    if name.startswith("WEIGHTS"):
                        assert np.allclose(self.array(number).sum(axis=1), 1, atol=1e-5)
                    if name == "NORMAL":
                        assert np.allclose(np.linalg.norm(self.array(number), axis=1), 1, atol=1e-5)
                for target in [each["attributes"], *each.get("targets", [])]:
                    assert {"min", "max"} <= set(self.tree["accessors"][target["POSITION"]])
                assert self.array(each["indices"]).max() < count and each["material"] < len(self.tree["materials"])
        parents = [child for node in self.tree["nodes"] for child in node.get("children", [])]
        assert len(parents) == len(set(parents)) and not set(parents) & set(self.tree["scenes"][0]["nodes"])
        assert len(parents) + len(self.tree["scenes"][0]["nodes"]) == len(self.tree["nodes"])
        for animation in self.tree.get("animations", []):
            targets = [(each["target"]["node"], each["target"]["path"]) for each in animation["channels"]]
            assert len(targets) == len(set(targets))
            for sampler in animation["samplers"]:
                times = self.array(sampler["input"])[:, 0]
                assert (np.diff(times) > 0).all() and {"min", "max"} <= set(self.tree["accessors"][sampler["input"]])
            for channel in animation["channels"]:  # section 3.11: floats, or normalized integers of rotations and weights
                output = self.tree["accessors"][animation["samplers"][channel["sampler"]]["output"]]
                assert output["componentType"] == 5126 or channel["target"]["path"] == "rotation"
                if output["componentType"] == 5122:
                    lengths = np.linalg.norm(self.array(animation["samplers"][channel["sampler"]]["output"]), axis=1)
                    assert np.abs(lengths - 1).max() < 1e-4

    def at(self, seconds: float, animation: int = 0) -> tuple[list[np.ndarray], dict[int, np.ndarray]]:
        """World matrices of all nodes, and the world points of each node that has a mesh."""
        local = [dict(node) for node in self.tree["nodes"]]
        for channel in self.tree["animations"][animation]["channels"] if "animations" in self.tree else []:
            sampler = self.tree["animations"][animation]["samplers"][channel["sampler"]]
            local[channel["target"]["node"]][channel["target"]["path"]] = self._value(sampler, seconds, channel["target"]["path"])
        world: list[Any] = [None] * len(local)

        def place(number: int, above: np.ndarray) -> None:
            node, matrix = local[number], np.eye(4)
            if "matrix" in node:
                matrix = np.array(node["matrix"]).reshape(4, 4).T
            else:
                turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
                matrix[:3, :3] = turn * np.asarray(node.get("scale", [1, 1, 1]))
                matrix[:3, 3] = node.get("translation", [0, 0, 0])
            world[number] = above @ matrix
            for child in node.get("children", []):
                place(child, world[number])

        for top in self.tree["scenes"][0]["nodes"]:
            place(top, np.eye(4))
        return world, {n: self._points(node, world, n) for n, node in enumerate(local) if "mesh" in node}

    def _value(self, sampler: dict[str, Any], seconds: float, path: str) -> np.ndarray:
        times, values = self.array(sampler["input"])[:, 0].astype(float), self.array(sampler["output"]).astype(float)
        values = values.reshape(len(times), -1)
        t = float(np.clip(seconds, times[0], times[-1]))
        if sampler["interpolation"] == "STEP":
            return values[np.searchsorted(times, t + 1e-6, side="right") - 1]
        if path == "rotation" and len(times) > 1:
            return Slerp(times, Rotation.from_quat(values))(t).as_quat()
        return np.array([np.interp(t, times, column) for column in values.T])

    def _points(self, node: dict[str, Any], world: list[np.ndarray], number: int) -> np.ndarray:
        mesh, parts = self.tree["meshes"][node["mesh"]], []
        for each in mesh["primitives"][:1]:  # all of a mesh share their points
            points = self.array(each["attributes"]["POSITION"]).astype(float)
            for weight, target in zip(node.get("weights", mesh.get("weights", [])), each.get("targets", []), strict=True):
                points = points + weight * self.array(target["POSITION"])
            points = np.concatenate([points, np.ones((len(points), 1))], axis=1)
            if "skin" not in node:
                parts.append((points @ world[number].T)[:, :3])
                continue
            skin = self.tree["skins"][node["skin"]]
            inverse = self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
            matrices = np.array([world[joint] for joint in skin["joints"]]) @ inverse
            joints, weights = self.array(each["attributes"]["JOINTS_0"]), self.array(each["attributes"]["WEIGHTS_0"])
            parts.append(np.einsum("pk,pkij,pj->pi", weights, matrices[joints], points)[:, :3])
        return np.concatenate(parts)
