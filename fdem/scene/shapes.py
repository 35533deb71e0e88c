"""The shapes blocks are made of, under one name each."""

from __future__ import annotations

from fdem.scene.measures import Shape, ShapeReport
from fdem.scene.polyhedra import Polyhedron, Surface
from fdem.scene.round import Balls, Clump, Cylinder, Sphere
from fdem.scene.tetmesh import TetMesh

__all__ = ["Balls", "Clump", "Cylinder", "Polyhedron", "Shape", "ShapeReport", "Sphere", "Surface", "TetMesh"]
