"""Runs in its own process: meshes packed by Draco in, arrays out. It imports nothing of the package.

Draco allocates what the bytes ask for, so hostile ones could ask for any amount: this process has a limit, and a crash
of the library ends this process alone.

Input: a line of JSON, {"bytes": LIMIT, "lengths": [...]}, and then the packed meshes. Output: an .npz archive with
`N_faces` and `N_ID` for each mesh N and each of its attributes' ids.
"""

from __future__ import annotations

import json
import sys
from io import BytesIO

import numpy as np


def main() -> None:
    """Unpack the meshes of the standard input."""
    import DracoPy

    head = json.loads(sys.stdin.buffer.readline())
    limit_memory(int(head["bytes"]))
    arrays: dict[str, np.ndarray] = {}
    for number, length in enumerate(head["lengths"]):
        mesh = DracoPy.decode(sys.stdin.buffer.read(length))
        arrays[f"{number}_faces"] = np.asarray(mesh.faces, np.uint32)
        for attribute in mesh.attributes:
            arrays[f"{number}_{int(attribute['unique_id'])}"] = np.asarray(attribute["data"])
    out = BytesIO()
    np.savez(out, **arrays)  # type: ignore[arg-type]
    sys.stdout.buffer.write(out.getbuffer())


def limit_memory(more: int) -> None:
    """Let this process take this many bytes more than it has; systems without such limits are left alone."""
    try:
        import resource

        with open("/proc/self/statm", encoding="ascii") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + more, used + more))
    except (ImportError, OSError, ValueError):
        pass


if __name__ == "__main__":
    main()
