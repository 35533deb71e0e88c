"""The shapes blocks are made of, under one name each."""

from __future__ import annotations

from fdem.scene.measures import Shape, ShapeReport
from fdem.scene.polyhedra import Polyhedron, Surface
from fdem.scene.tetmesh import TetMesh

__all__ = ["Polyhedron", "Shape", "ShapeReport", "Surface", "TetMesh"]
