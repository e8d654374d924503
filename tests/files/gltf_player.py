"""A player of glTF skins written from the glTF 2.0 specification alone, to check Bunraku's files against. It shares no
code with it.
"""

import json
import struct

import numpy as np

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Player:
    """Plays a GLB: `Player(path).vertices(1.5)` is where its meshes are after 1.5 s, in node order."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, total = struct.unpack_from("<4sII", data)
        assert (magic, version, total) == (b"glTF", 2, len(data))
        length, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        self.tree = json.loads(data[20 : 20 + length])
        self.binary = data[20 + length + 8 :]
        self.nodes = self.tree["nodes"]

    def accessor(self, index):
        """Values of an accessor, integers kept unless normalised."""
        entry = self.tree["accessors"][index]
        if "bufferView" not in entry:
            return self._sparse(entry)
        view = self.tree["bufferViews"][entry["bufferView"]]
        dtype, size = np.dtype(_TYPES[entry["componentType"]]), _SIZES[entry["type"]]
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        stride = view.get("byteStride", dtype.itemsize * size)
        rows = [np.frombuffer(self.binary, dtype, size, start + stride * i) for i in range(entry["count"])]
        out = np.array(rows).reshape(entry["count"], size)
        if entry.get("normalized"):
            out = np.maximum(out / np.iinfo(dtype).max, -1)
        return out

    def _sparse(self, entry):
        """Zeros but for the elements that a sparse accessor lists."""
        out = np.zeros((entry["count"], _SIZES[entry["type"]]))
        if "sparse" in entry:
            sparse, parts = entry["sparse"], []
            for part, component, size in (
                ("indices", sparse["indices"]["componentType"], 1),
                ("values", entry["componentType"], out.shape[1]),
            ):
                view = self.tree["bufferViews"][sparse[part]["bufferView"]]
                start = view.get("byteOffset", 0) + sparse[part].get("byteOffset", 0)
                parts.append(
                    np.frombuffer(self.binary, _TYPES[component], size * sparse["count"], start).reshape(-1, size)
                )
            out[parts[0][:, 0]] = parts[1]
        return out

    def vertices(self, time, animation=0):
        """World positions of all vertices at a time [s], shape (V, 3)."""
        pose = self._pose(time, animation)
        world = {}
        for root in self.tree["scenes"][self.tree.get("scene", 0)]["nodes"]:
            self._walk(root, np.eye(4), pose, world)
        out = []
        for number, node in enumerate(self.nodes):
            if "mesh" in node and number in world:
                seen = set()
                for primitive in self.tree["meshes"][node["mesh"]]["primitives"]:
                    if primitive["attributes"]["POSITION"] not in seen:
                        seen.add(primitive["attributes"]["POSITION"])
                        weights = pose.get((number, "weights"), self.tree["meshes"][node["mesh"]].get("weights", []))
                        out.append(self._place(primitive, weights, node, world, number))
        return np.concatenate(out)

    def _place(self, primitive, morphs, node, world, number):
        attributes = primitive["attributes"]
        positions = np.c_[
            self.accessor(attributes["POSITION"]).astype(float),
            np.ones(self.tree["accessors"][attributes["POSITION"]]["count"]),
        ]
        for weight, target in zip(morphs, primitive.get("targets", []), strict=True):
            if weight and "POSITION" in target:
                positions[:, :3] += weight * self.accessor(target["POSITION"])
        if "skin" not in node:
            return (positions @ world[number].T)[:, :3]
        skin = self.tree["skins"][node["skin"]]
        inverse = self.accessor(skin["inverseBindMatrices"]).astype(float).reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = np.array([world[joint] @ inverse[i] for i, joint in enumerate(skin["joints"])])
        joints, weights = self.accessor(attributes["JOINTS_0"]), self.accessor(attributes["WEIGHTS_0"]).astype(float)
        out = np.zeros((len(positions), 4))
        for column in range(4):
            out += weights[:, column, None] * np.einsum("vij,vj->vi", matrices[joints[:, column]], positions)
        return out[:, :3]

    def _pose(self, time, animation):
        pose = {}
        if "animations" not in self.tree:
            return pose
        entry = self.tree["animations"][animation]
        for channel in entry["channels"]:
            sampler = entry["samplers"][channel["sampler"]]
            times, values = (
                self.accessor(sampler["input"])[:, 0].astype(float),
                self.accessor(sampler["output"]).astype(float),
            )
            assert sampler["interpolation"] == "LINEAR"
            path = channel["target"]["path"]
            if path == "weights":
                values = values.reshape(len(times), -1)
            pose[channel["target"]["node"], path] = self._sample(times, values, time, path == "rotation")
        return pose

    @staticmethod
    def _sample(times, values, time, spherical):
        if time <= times[0]:
            return values[0]
        if time >= times[-1]:
            return values[-1]
        after = int(np.searchsorted(times, time, side="right"))
        a, b = values[after - 1], values[after]
        share = (time - times[after - 1]) / (times[after] - times[after - 1])
        if not spherical:
            return a + share * (b - a)
        dot = a @ b
        sign, angle = np.sign(dot) or 1.0, np.arccos(min(abs(dot), 1.0))
        if angle < 1e-6:
            return a + share * (sign * b - a)
        return (np.sin(angle * (1 - share)) * a + sign * np.sin(angle * share) * b) / np.sin(angle)

    def _walk(self, number, above, pose, world):
        node = self.nodes[number]
        if "matrix" in node:
            local = np.array(node["matrix"], float).reshape(4, 4).T
        else:
            local = np.eye(4)
            x, y, z, w = pose.get((number, "rotation"), node.get("rotation", [0, 0, 0, 1]))
            local[:3, :3] = [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
            local[:3, :3] = local[:3, :3] * np.array(node.get("scale", [1, 1, 1]))
            local[:3, 3] = pose.get((number, "translation"), node.get("translation", [0, 0, 0]))
        world[number] = above @ local
        for child in node.get("children", []):
            self._walk(child, world[number], pose, world)
