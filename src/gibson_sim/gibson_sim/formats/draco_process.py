"""Decodes Draco meshes in a separate process with limited memory and time: a small file can allocate gigabytes, or crash the decoder.

Standard input: for each mesh its length, 8 bytes little-endian, and its bytes. Standard output: a NumPy archive (.npz) with, for mesh i,
``i_faces`` (F, 3) and ``i_<id>`` (V, C) for each attribute by its unique id. An error is one line on standard error.
"""

from __future__ import annotations

import io
import resource
import sys

import numpy as np

MEMORY_BYTES = 4 * 2**30
"""Limit of the address space of the process, bytes."""
SECONDS = 60
"""Limit of the CPU time of the process, seconds."""


def main() -> int:
    """Decodes the meshes on standard input; returns the exit code."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import DracoPy

    data, at, arrays = sys.stdin.buffer.read(), 0, {}
    number = 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 8], "little")
        try:
            mesh = DracoPy.decode(data[at + 8 : at + 8 + length])
        # The C++ decoder can throw any exception.
        except Exception as error:
            sys.stderr.write(f"{type(error).__name__}: {' '.join(str(error).split())[:200]}\n")
            return 1
        faces = getattr(mesh, "faces", None)
        arrays[f"{number}_faces"] = np.zeros((0, 3), np.uint32) if faces is None else np.asarray(faces)
        arrays |= {f"{number}_{item['unique_id']}": np.asarray(item["data"]) for item in mesh.attributes}
        at += 8 + length
        number += 1
    archive = io.BytesIO()
    np.savez(archive, **arrays)  # type: ignore[arg-type]
    sys.stdout.buffer.write(archive.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main())
