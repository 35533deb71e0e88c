"""Zones of the deformable blocks of a scene."""

from __future__ import annotations

from typing import Any

from fdem.scene.scene import Block, Scene

__all__ = ["scene_zones"]


def scene_zones(scene: Scene, blocks: list[Block]) -> tuple[dict[Block, Any], list[str]]:
    """Zones of the deformable blocks, excavated ones included, and notes on them.

    Neighbours share surface meshes, so the zones of a block depend on all of them: they are a function of the scene
    alone, kept with it, and an excavation subdivides nothing again.
    """
    if not blocks:
        return {}, []
    from fdem.scene.meshing import zone_meshes

    key = [(block, block.shape, block.body) for block in blocks]
    known = scene.__dict__.get("zone_cache")
    if known is None or known[0] != key:
        notes: list[str] = []
        sizes = [block.body.size for block in blocks]
        made = zone_meshes([block.shape for block in blocks], sizes, [block.name for block in blocks], notes)
        known = scene.__dict__["zone_cache"] = (key, dict(zip(blocks, made, strict=True)), notes)
    return known[1], known[2]
