"""A glTF 2.0 document in memory: its JSON tree and its buffers, with every index, offset and length checked on use."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bunraku.errors import FormatError
from bunraku.formats.memory import room

__all__ = ["COMPONENT_TYPES", "ELEMENT_SIZES", "MAX_ELEMENTS", "Document"]

COMPONENT_TYPES: dict[int, np.dtype[Any]] = {
    code: np.dtype(name)
    for code, name in ((5120, "i1"), (5121, "u1"), (5122, "<i2"), (5123, "<u2"), (5125, "<u4"), (5126, "<f4"))
}
ELEMENT_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
MAX_ELEMENTS = 50_000_000
"""Most elements of one accessor: one may be declared without any data behind it, so the file's size is no bound."""


@dataclass(frozen=True, eq=False)
class Document:
    """A glTF document.

    Args:
        path: Where it came from, for messages.
        tree: The JSON object.
        buffers: The bytes of each buffer; those that name one file share them.
        images: Bytes of the images that are files or data URIs, by image index; None where the file is missing.
        size: Bytes of the file and of the files that it names, each once; 0 for a document that was made in memory.
    """

    path: Path
    tree: dict[str, Any]
    buffers: list[bytes | memoryview]
    images: dict[int, bytes | None]
    size: int = 0

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: views into the file as bytes of their own."""
        return {**self.__dict__, "buffers": [bytes(buffer) for buffer in self.buffers]}

    @property
    def _own(self) -> int:
        return self.size or sum(len(buffer) for buffer in self.buffers)

    def has_room(self, needed: int) -> bool:
        """Whether a file of this size may take so much memory beside itself [bytes]."""
        return self._own + needed <= room(self._own)

    def check_memory(self, needed: int) -> None:
        """Refuse what takes more memory than a file of this size may.

        Args:
            needed: About how much it takes beside the file itself [bytes].

        Raises:
            FormatError: It is too much.
        """
        if not self.has_room(needed):
            self.fail(
                f"reading it would take {(self._own + needed) / 1e6:,.0f} MB of memory, which is too much for its "
                "size or for this machine; simplify it, or close other programs"
            )

    def fail(self, problem: str) -> NoReturn:
        """Raise a FormatError about this document."""
        raise FormatError(self.path, problem)

    def items(self, kind: str) -> list[dict[str, Any]]:
        """A top-level list of the document, empty where it has none."""
        return self.objects(self.tree, kind)

    def objects(self, owner: dict[str, object], key: str) -> list[dict[str, Any]]:
        """A list of objects under a key of an object."""
        value = owner.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.fail(f"'{key}' must be a list of objects; the file is broken, export it again")
        return value

    def entry(self, owner: dict[str, object], key: str) -> dict[str, object]:
        """An object under a key of an object."""
        value = owner.get(key)
        if not isinstance(value, dict):
            self.fail(f"'{key}' must be an object; the file is broken, export it again")
        return value

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """One entry of a top-level list."""
        items = self.tree.get(kind, [])  # only the entry is checked: files hold thousands, and each is asked for often
        if (
            not isinstance(items, list)
            or type(index) is not int
            or not 0 <= index < len(items)
            or not isinstance(items[index], dict)
        ):
            self.fail(f"{kind}[{index!r:.20}] does not exist; the file is broken, export it again")
        return items[index]

    def integer(self, owner: dict[str, object], key: str, default: int | None = None, high: int = 2**40) -> int:
        """A non-negative whole number under a key of an object."""
        value = owner.get(key, default)
        if type(value) is float and value.is_integer():
            value = int(value)
        if type(value) is not int or not 0 <= value <= high:
            self.fail(
                f"'{key}' must be a whole number from 0 to {high}, not {value!r:.40}; the file is broken, export it "
                "again"
            )
        return value

    def numbers(self, owner: dict[str, object], key: str, default: list[float]) -> np.ndarray:
        """A list of finite numbers under a key of an object, as long as the default, float64."""
        value = owner.get(key, default)
        good = isinstance(value, list) and len(value) == len(default) and all(type(x) in (int, float) for x in value)
        out = np.array(value, float) if good else np.array([np.nan])
        if not np.isfinite(out).all():
            self.fail(f"'{key}' must be {len(default)} finite numbers; the file is broken, export it again")
        return out

    def indices(self, owner: dict[str, object], key: str, kind: str) -> list[int]:
        """A list of indices into a top-level list, under a key of an object."""
        value, listed = (
            owner.get(key, []),
            self.tree.get(kind, []),
        )  # the list's own entries are not checked, as in `item`
        count = len(listed) if isinstance(listed, list) else 0
        if not isinstance(value, list) or not all(type(x) is int and 0 <= x < count for x in value):
            self.fail(f"'{key}' points at {kind} that do not exist; the file is broken, export it again")
        return value

    def view(self, index: Any) -> memoryview:
        """The bytes of a buffer view."""
        view = self.item("bufferViews", index)
        buffer = self.integer(view, "buffer")
        if buffer >= len(self.buffers):
            self.fail(f"buffer {buffer} does not exist; the file is broken, export it again")
        start, length = self.integer(view, "byteOffset", 0), self.integer(view, "byteLength")
        data = memoryview(self.buffers[buffer])
        if start + length > len(data):
            self.fail(
                f"bufferViews[{index}] ends at byte {start + length} of {len(data)}; the file is truncated, export or "
                "download it again"
            )
        return data[start : start + length]

    def image(self, index: Any) -> bytes | memoryview | None:
        """The encoded bytes of an image; None where its file is missing."""
        entry = self.item("images", index)
        data = self.images.get(index)
        return self.view(entry["bufferView"]) if data is None and "bufferView" in entry else data

    def count(self, index: Any) -> int:
        """Number of elements of an accessor."""
        return self.integer(self.item("accessors", index), "count", high=MAX_ELEMENTS)

    def accessor(self, index: Any, kinds: tuple[str, ...], raw: bool = False) -> np.ndarray:
        """The elements of an accessor, sparse values put in place.

        Args:
            index: Which accessor.
            kinds: The element types that are allowed here, such as ("VEC3",).
            raw: Keep integers as they are stored; otherwise normalised ones become floats.

        Returns:
            Elements, shape (count, components), in their stored type or float32.
        """
        accessor = self.item("accessors", index)
        kind, component = accessor.get("type"), accessor.get("componentType")
        if kind not in kinds:
            self.fail(
                f"accessors[{index}] has type {kind!r:.20} where {' or '.join(kinds)} is needed; the file is broken, "
                "export it again"
            )
        dtype = COMPONENT_TYPES.get(component) if type(component) is int else None
        if dtype is None:
            self.fail(
                f"accessors[{index}] has component type {component!r:.20}, which glTF does not know; the file is "
                "broken, export it again"
            )
        count, size = self.count(index), ELEMENT_SIZES[kind]
        if "bufferView" in accessor:
            values = self._elements(accessor, accessor["bufferView"], dtype, count, size)
        else:
            self.check_memory(count * size * dtype.itemsize)
            values = np.zeros((count, size), dtype)
        sparse = accessor.get("sparse")
        if isinstance(sparse, dict):
            values = self._sparse(sparse, values.copy(), dtype)
        if raw or not accessor.get("normalized") or dtype.kind == "f":
            return values
        scaled: np.ndarray = values.astype(np.float32) / np.float32(np.iinfo(dtype).max)
        return np.maximum(scaled, -1, out=scaled)

    def _elements(self, owner: dict[str, object], view: Any, dtype: np.dtype, count: int, size: int) -> np.ndarray:
        data = self.view(view)
        offset = self.integer(owner, "byteOffset", 0)
        width = dtype.itemsize * size
        stride = self.integer(self.item("bufferViews", view), "byteStride", width, high=65535)
        if stride < width:
            self.fail(
                f"bufferViews[{view}] packs elements of {width} bytes every {stride}; the file is broken, export it "
                "again"
            )
        if count and offset + stride * (count - 1) + width > len(data):
            self.fail(
                f"an accessor reads past the end of bufferViews[{view}]; the file is truncated, export or download it "
                "again"
            )
        if not count:
            return np.zeros((0, size), dtype)
        return np.ndarray((count, size), dtype, data, offset, (stride, dtype.itemsize))

    def _sparse(self, sparse: dict[str, object], values: np.ndarray, dtype: np.dtype) -> np.ndarray:
        count = self.integer(sparse, "count", high=len(values))
        where, what = sparse.get("indices"), sparse.get("values")
        if (
            not isinstance(where, dict)
            or not isinstance(what, dict)
            or where.get("componentType") not in (5121, 5123, 5125)
        ):
            self.fail("a sparse accessor lacks its indices or values; the file is broken, export it again")
        rows = self._elements(where, where.get("bufferView"), COMPONENT_TYPES[where["componentType"]], count, 1)[:, 0]
        if count and int(rows.max()) >= len(values):
            self.fail("a sparse accessor replaces elements that do not exist; the file is broken, export it again")
        values[rows] = self._elements(what, what.get("bufferView"), dtype, count, values.shape[1])
        return values
