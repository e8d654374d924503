"""The inverse of `bunraku.studio.wire.packed_clip`, as the page does it."""

import json
import struct

import numpy as np


def unpacked_clip(data):
    """Frames a second, translations (N, K, 3) and quaternions (N, K, 4)."""
    length = struct.unpack("<I", data[4:8])[0]
    header = json.loads(data[8 : 8 + length])
    shape = header["frames"], header["joints"]
    count = shape[0] * shape[1]
    values = np.frombuffer(data[8 + length :], "<f4", count * 7)
    return header["fps"], values[: count * 3].reshape(*shape, 3), values[count * 3 :].reshape(*shape, 4)


def unpacked_apparel(data):
    """By mesh and primitive: vertices that leave their skin (R,), and how far before it [m] (N, R, 3)."""
    length = struct.unpack("<I", data[4:8])[0]
    header = json.loads(data[8 : 8 + length])
    at = 8 + length + header["frames"] * header["joints"] * 28
    parts = {}
    for part in header.get("parts", ()):
        rows = np.frombuffer(data, "<u4", part["rows"], at)
        values = np.frombuffer(data, "<i2", header["frames"] * len(rows) * 3, at + rows.nbytes)
        at += rows.nbytes + 2 * (values.size + values.size % 2)
        parts[part["mesh"], part["primitive"]] = rows, values.reshape(-1, len(rows), 3) * header["unit"]
    return parts
