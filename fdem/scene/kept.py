"""What a state that goes on in an edited scene brings along: origin and zones that new neighbours must not change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fdem.scene.meshing import ZoneMesh
from fdem.scene.tetmesh import TetMesh

__all__ = ["Kept"]

Array = Any

_FIELDS = ("points", "tets", "triangles", "triangle_face")
_FILLS = 1e-6  # of the volume: other shapes are not the block they were


@dataclass(frozen=True)
class Kept:
    """Origin and zones of a state.

    Parameters
    ----------
    origin : (3,) array
        What positions are relative to [m].
    zones : mapping of str to ZoneMesh
        By block name.
    """

    origin: Array
    zones: Mapping[str, ZoneMesh]

    @classmethod
    def of(cls, layout: Any) -> Kept:
        """Those of a compiled layout."""
        parts = zip(layout.blocks, layout.meshes, layout.kind, strict=True)
        zones = {block.name: mesh for block, mesh, kind in parts if kind == "zoned"}
        return cls(layout.origin, zones)

    def differing(self, made: Mapping[Any, ZoneMesh]) -> dict[str, ZoneMesh]:
        """Zones by block name that fill the same blocks as those `made` (by block) and are not the same."""
        out = {}
        for block, mesh in made.items():
            kept = self.zones.get(block.name)
            if kept is None or isinstance(block.shape, TetMesh) or kept.size != mesh.size:
                continue
            if not np.array_equal(kept.tets, mesh.tets) and _fills(kept, block.shape):
                out[block.name] = kept
        return out

    def arrays(self) -> dict[str, Array]:
        """Everything as arrays, to be written to a file."""
        out: dict[str, Array] = {"origin": self.origin, "names": np.array(list(self.zones), dtype=np.str_)}
        for i, mesh in enumerate(self.zones.values()):
            out |= {f"{name}_{i}": getattr(mesh, name) for name in _FIELDS} | {f"size_{i}": np.array(mesh.size)}
        return out

    @classmethod
    def read(cls, arrays: Mapping[str, Array]) -> Kept:
        """What `arrays` gave."""
        zones = {
            str(name): ZoneMesh(**{field: arrays[f"{field}_{i}"] for field in _FIELDS}, size=float(arrays[f"size_{i}"]))
            for i, name in enumerate(arrays["names"])
        }
        return cls(arrays["origin"], zones)


def _fills(mesh: ZoneMesh, shape: Any) -> bool:
    edges = mesh.points[mesh.tets[:, 1:]] - mesh.points[mesh.tets[:, :1]]
    volume = float(np.linalg.det(edges).sum()) / 6.0
    corners = {tuple(p) for p in shape.points.tolist()}
    return abs(volume - shape.volume) <= _FILLS * shape.volume and corners <= {tuple(p) for p in mesh.points.tolist()}
