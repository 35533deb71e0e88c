"""Scenes that are solved at the origin and far from it: a patch test and a wedge."""

from __future__ import annotations

from typing import Any

import numpy as np

import fdem

from .base import settled, simulation
from .meshes import box_mesh

YOUNG, POISSON = 1e10, 0.25
A = np.array([[1e-4, 2e-4, -5e-5], [3e-5, -1e-4, 7e-5], [4e-5, 1e-5, 6e-5]])
SHIFT = np.array([1e-3, -2e-3, 5e-4])


def exact_stress(gradient: np.ndarray) -> np.ndarray:
    """Cauchy stress of the St. Venant-Kirchhoff material at the displacement gradient."""
    lam = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    mu = YOUNG / (2 * (1 + POISSON))
    F = np.eye(3) + gradient
    strain = 0.5 * (F.T @ F - np.eye(3))
    cauchy = F @ (lam * np.trace(strain) * np.eye(3) + 2 * mu * strain) @ F.T / np.linalg.det(F)
    return cauchy[[0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]


def patch_at(origin: Any) -> np.ndarray:
    """Stresses (m, 6) of the zones of a cube whose boundary is moved linearly."""
    origin = np.asarray(origin, float)
    points, tets = box_mesh((3, 3, 3), (1, 1, 1), jitter=0.25, seed=1)
    scene = fdem.Scene(gravity=(0, 0, 0))
    rock = fdem.Elastic(2500, YOUNG, POISSON)
    block = scene.add(fdem.tet_mesh(points + origin, tets), fdem.Zoned(), rock)
    scene.apply(
        fdem.Displacement(lambda x: (x - origin) @ A.T + SHIFT), block,
        where=lambda x: (np.abs(x - origin - 0.5) > 0.5 - 1e-7).any(axis=1),
    )  # fmt: skip
    sim = settled(scene, 1e-8)
    sim.cycle(1000)
    return sim[block].zone_stress


def normal_of(dip: float, direction: float) -> np.ndarray:
    """Upward normal of a plane."""
    d, a = np.radians(dip), np.radians(direction)
    return np.array([np.sin(d) * np.sin(a), np.sin(d) * np.cos(a), np.cos(d)])


SIDES = normal_of(40, 130), normal_of(60, 220)
LINE = np.cross(*SIDES) / np.linalg.norm(np.cross(*SIDES))
LINE = LINE if LINE[2] < 0 else -LINE
# equilibrium of a unit weight across the line of intersection: normal forces, and what drives along it
RA, RB, DRIVE = np.linalg.solve(np.column_stack([*SIDES, -LINE]), [0.0, 0.0, 1.0])
CRITICAL = np.degrees(np.arctan(DRIVE / (RA + RB)))


def wedge(phi: float, speed: float = 0.0, origin: Any = (0.0, 0.0, 0.0), kn: float = 1e9) -> fdem.Scene:
    """Rock cut by planes 40/130 and 60/220 (dip/direction); the piece above both is free, g = 10."""
    origin = np.asarray(origin)
    scene = fdem.Scene(gravity=(0, 0, -10))
    pieces = [fdem.brick(origin - 5, origin + 5)]
    for dip, direction in ((40, 130), (60, 220)):
        pieces = fdem.cut(pieces, fdem.JointSet(dip, direction, origin=tuple(origin)))
    for piece in pieces:
        above = tuple(bool((piece.centroid - origin) @ n > 0) for n in SIDES)
        name = {(1, 1): "wedge", (0, 1): "under A", (1, 0): "under B", (0, 0): "deep"}[above]
        moves = {"velocity": speed * LINE} if name == "wedge" else {"fixed": True}
        scene.add(piece, fdem.Rigid(), fdem.Elastic(2000.0), name=name, **moves)
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=phi, damping=0.1))
    return scene


def slid(phi: float, origin: Any, speed: float = 0.3) -> tuple[fdem.Simulation, np.ndarray, float]:
    """Slides on along the line from a settled start; mean acceleration after the shear has turned into the line."""
    start = settled(wedge(35.0, origin=origin), 1e-8)
    sim = simulation(wedge(phi, speed, origin), fdem.Explicit(safety=0.4), start=start)
    begin = sim["wedge"].position
    sim.run(time=0.1)
    first = sim["wedge"].velocity @ LINE
    sim.run(time=0.2)
    return sim, begin, (sim["wedge"].velocity @ LINE - first) / 0.2


def wedge_angle(origin: Any) -> tuple[float, set[tuple[int, ...]]]:
    """Friction angle [degrees] at which the wedge keeps its speed, and the pairs of blocks in contact."""
    rates = []
    for phi in (CRITICAL - 0.1, CRITICAL + 0.1):
        sim, _, rate = slid(phi, origin)
        rates.append(rate)
    pairs = {tuple(pair) for pair in np.sort(sim.system.contacts.pairs, axis=1).tolist()}
    return CRITICAL - 0.1 + 0.2 * rates[0] / (rates[0] - rates[1]), pairs
