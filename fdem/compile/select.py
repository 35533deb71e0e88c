"""Resolves the user's targets to blocks, gridpoints and faces of a model."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdem.blocks.conditions import dual, weights_of
from fdem.compile.layout import Layout
from fdem.errors import SceneError, UnsupportedError
from fdem.model import Model
from fdem.scene.scene import Gridpoint, choose

__all__ = ["Selector"]


class Selector:
    """Resolves the user's targets to gridpoints, blocks and surface triangles of a model."""

    def __init__(self, layout: Layout, model: Model) -> None:
        self.layout, self.model, self.scene = layout, model, layout.scene
        self.tag_number = {tag: i for i, tag in enumerate(model.tags)}
        self.owner = model.gp_block

    def blocks(self, target: Any, what: str) -> list[int]:
        """Model rows of the blocks selected (removed ones left out)."""
        index = self.layout.index
        return [index[b] for b in self.scene.select_blocks(target) if b in index]

    def pairs(self, target: Any) -> list[tuple[int, int | None]]:
        """Model rows with the face tag that selects within (None: all of the block)."""
        index = self.layout.index
        return [
            (index[b], None if tag is None else self.tag_number.get(tag, -2))
            for b, tag in self.scene.select(target)
            if b in index
        ]

    def nearest(self, handle: Gridpoint) -> int:
        """Gridpoint nearest to the handle's place."""
        blocks = self.blocks(handle.target, "gridpoint")
        if not blocks:
            raise SceneError(f"gridpoint near {handle.near}: all blocks of {handle.target!r} have been removed")
        gp = np.concatenate([np.arange(*self.model.gp_range[b]) for b in blocks])
        distance = np.linalg.norm(self.model.X[gp] + self.model.origin - handle.near, axis=1)
        return int(gp[np.argmin(distance)])

    def gridpoints(self, target: Any, where: Any, what: str) -> np.ndarray:
        """Gridpoints selected by target and `where`, ascending.

        Raises
        ------
        SceneError
            If none is selected.
        """
        if isinstance(target, Gridpoint):
            return np.array([self.nearest(target)])
        parts = []
        for block, tag in self.pairs(target):
            if tag is None:
                parts.append(np.arange(*self.model.gp_range[block]))
            else:
                faces = (self.model.triangle_block == block) & (self.model.triangle_tag == tag)
                parts.append(np.unique(self.model.triangles[faces]))
        gp = np.unique(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.int64)
        if where is not None and len(gp):
            gp = gp[choose(what, where, self.model.X[gp] + self.model.origin)]
        if not len(gp):
            raise SceneError(f"{what}: target {target!r} with where = {where!r} selects no gridpoint")
        return gp

    def faces(self, target: Any, where: Any, what: str) -> np.ndarray:
        """Surface triangles selected by target and `where` (rows of model.triangles).

        Raises
        ------
        SceneError
            If none is selected.
        """
        mask = np.zeros(len(self.model.triangles), dtype=bool)
        for block, tag in self.pairs(target):
            of_block = self.model.triangle_block == block
            mask |= of_block if tag is None else of_block & (self.model.triangle_tag == tag)
        rows = np.flatnonzero(mask)
        if where is not None and len(rows):
            centroids = self.model.X[self.model.triangles[rows]].mean(axis=1) + self.model.origin
            rows = rows[choose(what, where, centroids)]
        if not len(rows):
            raise SceneError(f"{what}: target {target!r} with where = {where!r} selects no face")
        return rows

    def area_vectors(self, rows: np.ndarray) -> np.ndarray:
        """Outward area vectors (n, 3) [m^2] of surface triangles."""
        a, b, c = (self.model.X[self.model.triangles[rows, k]] for k in range(3))
        return 0.5 * np.cross(b - a, c - a)

    def affine(self, block: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gridpoints and weights of a material point of `block`, exact for what its formulation can do.

        Raises
        ------
        SceneError
            If the point lies outside a zoned block.
        """
        model = self.model
        if model.zoned[block]:
            zones = model.zones[model.zone_start[block] : model.zone_start[block + 1]]
            corners = model.X[zones]
            edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
            inner = np.linalg.solve(edges, (point - corners[:, 0])[:, :, None])[:, :, 0]
            weights = np.column_stack([1 - inner.sum(axis=1), inner])
            best = int(np.argmax(weights.min(axis=1)))
            if weights[best].min() < -1e-6:
                where = point + model.origin
                raise SceneError(f"Force: at = {where} lies outside block {model.names[block]!r}")
            return zones[best], weights[best]
        batch, row = model.batch_of(block), int(model.batch_row[block])
        if getattr(batch, "by_points", False):
            value = batch.functions((point - batch.centre0[row])[None], np.array([row]))[0]
            return weights_of(batch, row, value)
        gp = np.arange(*model.gp_range[block])
        if len(gp) == 1:
            if np.linalg.norm(point - model.X[gp[0]]) > 1e-9 * model.size[block]:
                raise UnsupportedError(
                    f"Force: block {model.names[block]!r} is a sphere without orientation, forces act at its centre; "
                    "Rigid(orientation=True) gives it one"
                )
            return gp, np.ones(1)
        chosen = gp[_spread(model.X[gp])]
        corners = model.X[chosen]
        inner = np.linalg.solve((corners[1:] - corners[0]).T, point - corners[0])
        return chosen, np.concatenate([[1 - inner.sum()], inner])

    def evenly(self, block: int) -> tuple[np.ndarray, np.ndarray]:
        """Gridpoints and weights by which a force moves a block that moves as a whole, without turning or strain."""
        batch, row = self.model.batch_of(block), int(self.model.batch_row[block])
        if getattr(batch, "by_points", False):
            return weights_of(batch, row, np.zeros(batch.k))
        return self.affine(block, self.model.centroid[block])

    def dual(self, block: int) -> np.ndarray:
        """Weights (n, 3) by which gridpoints of a block give its deformation gradient."""
        batch, row = self.model.batch_of(block), int(self.model.batch_row[block])
        if getattr(batch, "by_points", False):
            return dual(batch, row)
        arm = self.model.X[slice(*self.model.gp_range[block])]
        arm = arm - arm.mean(axis=0)
        return arm @ np.linalg.pinv(arm.T @ arm)


def _spread(points: np.ndarray) -> list[int]:
    """Four points far from lying in a plane."""
    centre = points.mean(axis=0)
    first = int(np.argmax(np.linalg.norm(points - centre, axis=1)))
    second = int(np.argmax(np.linalg.norm(points - points[first], axis=1)))
    line = points[second] - points[first]
    third = int(np.argmax(np.linalg.norm(np.cross(points - points[first], line), axis=1)))
    normal = np.cross(line, points[third] - points[first])
    fourth = int(np.argmax(np.abs((points - points[first]) @ normal)))
    return [first, second, third, fourth]
