"""Shapes and a tiny rigid-body world for the contact tests (no fdem.scene)."""

from __future__ import annotations

import numpy as np

from fdem.blocks.rigid import RigidBlocks
from fdem.contact.contacts import Contacts, LawTable
from fdem.contact.surface import BlockSurface


def rotation(axis, angle):
    a = np.array(axis, float) / np.linalg.norm(axis)
    k = np.cross(np.eye(3), a)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def prism(poly, h):
    n = len(poly)
    p = np.asarray(poly, float)
    points = np.vstack([np.c_[p, np.zeros(n)], np.c_[p, np.full(n, h)]])
    faces = [list(range(n))[::-1], list(range(n, 2 * n))] + [[i, (i + 1) % n, (i + 1) % n + n, i + n] for i in range(n)]
    return points, faces


def box(a, b, c):
    p, f = prism([[-a / 2, -b / 2], [a / 2, -b / 2], [a / 2, b / 2], [-a / 2, b / 2]], c)
    return p - [0, 0, c / 2], f


def move(shape, r=None, t=(0, 0, 0)):
    r = np.eye(3) if r is None else r
    return np.asarray(shape[0], float) @ np.asarray(r).T + np.array(t, float), shape[1]


def volume_of(points, faces):
    v = 0.0
    for f in faces:
        for k in range(1, len(f) - 1):
            v += points[f[0]] @ np.cross(points[f[k]], points[f[k + 1]]) / 6
    return v


def triangulated(shape):
    return shape[0], [[f[0], f[k], f[k + 1]] for f in shape[1] for k in range(1, len(f) - 1)]


def grid_box(nx, ny, size=(1.0, 1.0, 1.0), gx=None, gy=None):
    """Box whose top and bottom are triangulated grids, as a surface (points, triangles)."""
    gx = np.linspace(0, 1, nx + 1) if gx is None else np.asarray(gx, float)
    gy = np.linspace(0, 1, ny + 1) if gy is None else np.asarray(gy, float)
    nx, ny = len(gx) - 1, len(gy) - 1
    g = np.array([[a, b] for a in gx for b in gy])
    n = len(g)
    pts = np.vstack([np.c_[g, np.zeros(n)], np.c_[g, np.ones(n)]]) * size

    def at(i, j):
        return i * (ny + 1) + j

    tri = []
    for i in range(nx):
        for j in range(ny):
            q = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]
            for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3])):
                tri.append([n + k for k in t])
                tri.append(list(t)[::-1])
    ring = [at(i, 0) for i in range(nx)] + [at(nx, j) for j in range(ny)]
    ring += [at(i, ny) for i in range(nx, 0, -1)] + [at(0, j) for j in range(ny, 0, -1)]
    for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
        tri += [[a, b, b + n], [a, b + n, a + n]]
    return pts, tri


COULOMB = dict(kn=1e9, ks=5e8, tan=0.0, c=0.0, t=0.0, dil=0.0, dil_limit=np.inf, rtan=None, rc=0.0, damping=0.0)


def coulomb(**kw):
    d = COULOMB | kw
    d["rtan"] = d["tan"] if d["rtan"] is None else d["rtan"]
    return LawTable(
        "coulomb", [[d[k] for k in ("kn", "ks", "tan", "c", "t", "dil", "dil_limit", "rtan", "rc", "damping")]]
    )


def bonded(kn=1e9, ks=5e8, tan=0.0, shear=np.inf, tension=np.inf):
    return LawTable("bonded", [[kn, ks, tan, shear, tension]])


def table(*joints):
    """One table of joint laws of one kind, as compile makes it; kn and ks must be given."""
    law, kind = joints[0], type(joints[0])
    rows = [joint.properties(joint.kn, joint.ks) for joint in joints]
    if isinstance(law.sweep, str):
        return LawTable(law.sweep, rows)
    reach = np.array([joint.reach for joint in joints])
    return LawTable(law.sweep, rows, tuple(law.memory), frozenset(law.needs), kind.closure, reach)


class World:
    """Rigid polyhedra, their contacts, and resultants on them."""

    def __init__(self, shapes, law=None, fixed=None, affine=None, density=2500.0, **options):
        self.fixed = np.array(fixed if fixed is not None else [False] * len(shapes))
        affine = affine if affine is not None else [True] * len(shapes)
        start = np.r_[0, np.cumsum([len(s[0]) for s in shapes])]
        self.start = start
        self.x = np.ascontiguousarray(np.concatenate([s[0] for s in shapes]).astype(float))
        self.x_old = self.x.copy()
        blocks, mass, density = [], np.zeros(len(self.x)), np.broadcast_to(density, len(shapes))
        self.volume, self.centroid = [], []
        for i, (p, f) in enumerate(shapes):
            edges = {(a, b) for q in f for a, b in zip(q, [*q[1:], q[0]], strict=True)}
            v = volume_of(np.asarray(p, float), f) if all((b, a) in edges for a, b in edges) else 0.0
            loops = [np.array(q, np.int32) + start[i] for q in f]
            behind = None
            if not affine[i]:
                normals = [np.cross(p[q[1]] - p[q[0]], p[q[2]] - p[q[0]]) for q in f]
                far = [np.argmax(np.abs((p - p[q[0]]) @ n)) for q, n in zip(f, normals, strict=True)]
                behind = np.array(far, np.int32) + start[i]
            gp = (int(start[i]), int(start[i + 1]))
            tags = np.full(len(f), -1)
            blocks.append(BlockSurface(loops, tags, affine[i], gp, bool(self.fixed[i]), v, density[i] * v, behind))
            mass[start[i] : start[i + 1]] = density[i] * v
            self.volume.append(v)
        options.setdefault("gap_tolerance", 0.0)
        options.setdefault("prune", 0.0)
        self.law = law or coulomb()
        self.contacts = Contacts(
            blocks, self.x, gp_mass=mass, laws=[self.law],
            assign=lambda bs, bm, fs, fm, pts: (np.zeros(len(bs), np.int32), np.zeros(len(bs), np.int32)), **options,
        )  # fmt: skip
        self.f = np.zeros_like(self.x)
        self.faces = [s[1] for s in shapes]

    def forces(self, dt=0.0):
        self.f[:] = 0.0
        self.contacts.forces(self.x, self.x_old, dt, self.f)
        return self.f

    def commit(self):
        self.contacts.commit()
        self.x_old[:] = self.x

    def resultant(self, i, about=(0.0, 0.0, 0.0)):
        sl = slice(self.start[i], self.start[i + 1])
        return self.f[sl].sum(0), np.cross(self.x[sl] - np.asarray(about), self.f[sl]).sum(0)

    def shift(self, i, t):
        self.x[self.start[i] : self.start[i + 1]] += t


class Flight:
    """Free rigid motion of the blocks of a World by the leapfrog of `RigidBlocks`: between forces the momenta stay."""

    def __init__(self, world, velocity, spin, density=2500.0):
        self.w, n = world, len(velocity)
        whole = [_moments(world.x[a:b], f) for a, b, f in zip(world.start, world.start[1:], world.faces, strict=False)]
        density = np.broadcast_to(density, n)
        self.m = [density[i] * volume for i, (volume, _, _) in enumerate(whole)]
        inertia = [density[i] * (np.trace(second) * np.eye(3) - second) for i, (_, _, second) in enumerate(whole)]
        slices = slice(0, 6 * n), slice(0, 7 * n), slice(0, len(world.x))
        centres = np.array([centre for _, centre, _ in whole])
        self.batch = RigidBlocks(world.x, world.start, np.array(self.m), np.array(inertia), centres, *slices)
        self.q, self.a, self.f = np.zeros(7 * n), np.zeros(6 * n), np.zeros(6 * n)
        self.batch.start(self.q)
        self.v = np.hstack([np.array(velocity, float), np.array(spin, float)]).ravel()

    def kinetic(self):
        return self.batch.kinetic(self.q, self.v)

    def momentum(self):
        """Linear and angular momentum of all blocks together."""
        v, c = self.v.reshape(-1, 6)[:, :3], self.q.reshape(-1, 7)[:, :3]
        p = np.array(self.m)[:, None] * v
        return p.sum(0), (np.cross(c, p) + self.batch.angular_momentum(self.q, self.v)).sum(0)

    def step(self, dt, update=True):
        """One step; True while contacts push."""
        w = self.w
        f_gp = w.forces(dt)
        touching = bool(w.contacts.n_patches) and bool(w.contacts._area.any())
        self.f[:] = 0.0
        self.batch.pull(self.q, f_gp, self.f)
        self.batch.accelerate(self.q, self.f, self.a)
        self.v += dt * self.a
        w.commit()
        self.batch.advance(self.q, self.v, dt)
        self.batch.place(self.q, w.x)
        if update:
            w.contacts.update(w.x)
        return touching


def _moments(points, loops):
    """Volume, centroid and central second moments of a polyhedron."""
    origin = points.mean(axis=0)
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for f in loops:
        for k in range(1, len(f) - 1):
            a, b, c = points[[f[0], f[k], f[k + 1]]] - origin
            v, s = a @ np.cross(b, c) / 6, a + b + c
            volume += v
            first += v * s / 4
            second += v * (np.outer(a, a) + np.outer(b, b) + np.outer(c, c) + np.outer(s, s)) / 20
    centre = first / volume
    return volume, origin + centre, second - volume * np.outer(centre, centre)
