"""Zoned blocks by Static: against the discrete answer of linear elasticity, to round-off, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from verify import test_fe_cantilever as cantilever
from verify import test_fe_patch as patch
from verify import test_fe_thick_cylinder as cylinder
from verify.meshes import box, plane, quarter_ring
from verify.test_contact_cases import LOWER, UPPER, graded

import fdem

pytestmark = pytest.mark.filterwarnings("ignore::fdem.FdemWarning")  # coarse meshes: lumped inertia


def discrete(sim, loads, held, given):
    """Displacements (n, 3) of ``K u = f`` with K assembled by scikit-fem, `given` (n, 3) where `held` (n, 3)."""
    batch = sim.model.batches[0]
    K, free, u = batch.stiffness().tocsr(), ~held.ravel(), given.ravel().copy()
    u[free] = spsolve(K[free][:, free].tocsc(), (loads.ravel() - K @ np.where(held.ravel(), u, 0.0))[free])
    return u.reshape(-1, 3)


def beam(cells, sign):
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = box((4 * cells, cells, max(1, cells // 2)), (cantilever.LENGTH, 0.5, 1.0), (0, -0.5, 0))
    block = scene.add(shape, fdem.Zoned(strain="small"), fdem.Elastic(2500, cantilever.YOUNG, 0.0))
    scene.apply(fdem.Displacement(lambda x: sign * cantilever.exact(x)), block, where=plane(0, 0.0))
    scene.apply(fdem.Traction(lambda x: sign * cantilever.end_shear(x)), block, where=plane(0, cantilever.LENGTH))
    sim = fdem.Simulation(scene, fdem.Static(tolerance=1e-11))
    assert sim.solve(ratio=1e-11).converged
    moved = sim[block].gridpoint_displacement
    return sim, moved, sim[block].gridpoints - moved


@pytest.mark.parametrize("cells", [2, 4, pytest.param(16, marks=pytest.mark.long)])
def test_cantilever(cells):
    """3.0 % low at 16 cells, and the discrete answer to 1e-8 (oracle: fe_cantilever).

    The frame of a block turns with it, 1e-6 of the tip: half the difference of a load and its opposite is without that.
    """
    sim, moved, places = beam(cells, 1.0)
    root, end = places[:, 0] < 1e-9, np.abs(places[:, 0] - cantilever.LENGTH) < 1e-9
    low = 1.0 - moved[end & (np.abs(places[:, 1]) < 1e-9), 1].mean() / (cantilever.SCALE * cantilever.TIP)
    assert low == pytest.approx({2: 0.638, 4: 0.319, 16: 0.030}[cells], abs=0.005)
    if cells < 16:
        held = np.repeat(root[:, None], 3, axis=1)
        expected = discrete(sim, sim.system.f_load, held, np.where(held, cantilever.exact(places), 0.0))
        odd = 0.5 * (moved - beam(cells, -1.0)[1])
        assert np.abs(odd - expected).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("strain", ["large", "small"])
def test_patch(strain):
    """A linear displacement of the boundary: the same inside, and its stress, to 1e-10."""
    scene = fdem.Scene(gravity=(0, 0, 0))
    block = scene.add(box((3, 3, 3), (1, 1, 1), jitter=0.25, seed=1), fdem.Zoned(strain=strain),
                      fdem.Elastic(2500, patch.YOUNG, patch.POISSON))  # fmt: skip
    A = patch.A if strain == "large" else 0.5 * (patch.A + patch.A.T)

    def surface(x):
        return (np.abs(x - 0.5) > 0.5 - 1e-9).any(axis=1)

    scene.apply(fdem.Displacement(lambda x: x @ A.T + patch.SHIFT), block, where=surface)
    sim = fdem.Simulation(scene, fdem.Static(tolerance=1e-11))
    report = sim.solve(ratio=1e-11)
    assert report.converged and report.cycles <= 4
    moved = sim[block].gridpoint_displacement
    places = sim[block].gridpoints - moved
    assert np.abs(moved - (places @ A.T + patch.SHIFT)).max() <= 1e-10 * np.abs(A).max()
    if strain == "large":
        exact = patch.exact_stress(A)
        assert np.abs(sim[block].zone_stress - exact).max() <= 1e-10 * np.abs(exact).max()


def bore(sign):
    scene = fdem.Scene(gravity=(0, 0, 0))
    shape = quarter_ring(4, 6, cylinder.INNER, cylinder.OUTER, depth=0.25)
    block = scene.add(shape, fdem.Zoned(strain="small"), fdem.Elastic(2500, cylinder.YOUNG, cylinder.POISSON))
    scene.fix(block, "z")
    scene.fix(block, "x", where=lambda x: x[:, 0] == 0.0)
    scene.fix(block, "y", where=lambda x: x[:, 1] == 0.0)
    scene.apply(
        fdem.Pressure(sign * cylinder.SCALE * cylinder.PRESSURE),
        block,
        where=lambda x: np.hypot(x[:, 0], x[:, 1]) < cylinder.INNER + 0.01,
    )
    return scene, block


def bar(sign):
    scene = fdem.Scene(gravity=(0, 0, -9.81 * sign))
    block = scene.add(box((2, 2, 10), (1, 1, 10)), fdem.Zoned(strain="small"), fdem.Elastic(2500, 1e9, 0.2))
    for axis in range(3):
        scene.fix(block, "xyz"[axis], where=plane(axis, 0.0))
    return scene, block


@pytest.mark.parametrize("case", [bore, bar])
def test_thick_cylinder_and_bar(case):
    """The discrete answer to 1e-8, second order (a pressure that follows, a frame that turns) taken out as above."""
    moved = []
    for sign in (-1.0, 1.0):
        scene, block = case(sign)
        sim = fdem.Simulation(scene, fdem.Static(tolerance=1e-12))
        sim.system.forces()
        loads = sim.system.weight.reshape(-1, 3) if sim.system.f_load is None else sim.system.f_load.copy()
        assert sim.solve(ratio=1e-12).converged
        moved.append(sim[block].gridpoint_displacement)
    places = sim[block].gridpoints - moved[1]
    held = np.abs(places) < 1e-9
    held[:, 2] |= case is bore
    expected = discrete(sim, loads, held, np.zeros_like(places))
    assert np.abs(0.5 * (moved[1] - moved[0]) - expected).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("lateral", ["smooth", "rough"])
def test_nonmatching_patch(lateral):
    """Two grids that do not match, pressed: every traction to 8 eps L / closure (oracle: contact_patch_nonmatching)."""
    p, kn, rock = 1e6, 1e11, fdem.Elastic(density=2500, young=1e10, poisson=0.2)
    scene = fdem.Scene(gravity=(0, 0, 0))
    low = scene.add(graded(LOWER, 0.0), fdem.Zoned(), rock)
    top = scene.add(graded(UPPER, 1.0), fdem.Zoned(), rock)
    scene.fix(low, "z", where=plane(2, 0.0))
    for block in (low, top):  # symmetry planes: the sides are free to widen alike
        scene.fix(block, "x", where=plane(0, 0.0))
        scene.fix(block, "y", where=plane(1, 0.0))
    scene.joint(fdem.Coulomb(kn=kn, ks=kn, friction=0 if lateral == "smooth" else 30))
    scene.apply(fdem.Traction((0, 0, -p)), top, where=plane(2, 2.0))
    sim = fdem.Simulation(scene, fdem.Static(tolerance=1e-14))
    assert sim.solve(ratio=1e-14).converged
    table = sim.contact_table()
    limit = 8 * np.finfo(float).eps * 2.0 / (p / kn)
    facing = np.abs(table["normal"][:, 2]) > 0.5
    pressure = table["traction"][facing, 0]
    assert (pressure * table["area"][facing]).sum() == pytest.approx(p, rel=limit)
    assert np.abs(pressure / pressure.mean() - 1).max() <= limit
    assert pressure.mean() == pytest.approx(p * (1 - 2 * 0.2 * p / 1e10), rel=1e-8)  # the faces widen
    for block in (low, top):
        assert np.abs(sim[block].zone_stress[:, 2] / -pressure.mean() - 1).max() <= limit
