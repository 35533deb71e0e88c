"""What a scene does not need is not computed, not imported, and said so by `describe`."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scenes import quietly, simulation

import fdem
from fdem.blocks import bounds
from fdem.contact import table

ROOT = Path(__file__).parent.parent
ROCK = fdem.Elastic(density=2500.0, young=1e9, poisson=0.2)
ZONES = "zones: left out"
STRAIN = "strain and internal forces: left out"
KINDS = {"rigid": fdem.Rigid(), "uniform": fdem.UniformStrain(), "linear": fdem.LinearStrain(), "zoned": fdem.Zoned()}
# lines that must be there, and lines that must not
SAID = {
    "rigid": ([ZONES, STRAIN], ["orientation is kept"]),
    "sphere": ([ZONES, STRAIN, "spheres: no orientation is kept", "contacts of faces with faces: left out"], []),
    "uniform": ([ZONES], [STRAIN]),
    "linear": ([ZONES], [STRAIN]),
    "zoned": (["zones: no in-situ stress, its arrays are left out"], [ZONES, STRAIN]),
}


def on_base(kind, **given):
    """One block of the kind on a fixed base."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (2, 2, 0)), fdem.Rigid(), fixed=True, name="base")
    shape = fdem.sphere(0.5, (0.5, 0.5, 0.5)) if kind == "sphere" else fdem.brick((0, 0, 0), (1, 1, 1))
    scene.add(shape, KINDS.get(kind, fdem.Rigid()), ROCK, name="block", **given)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    return scene


@pytest.mark.parametrize("kind", SAID)
def test_describe_says_what_is_left_out(kind):
    text = simulation(on_base(kind)).describe()
    there, absent = SAID[kind]
    for words in (*there, "fixed blocks: no unknowns", "contact damping: left out" if kind != "sphere" else "damping"):
        assert words in text, words
    for words in absent:
        assert words not in text, words
    # formulations that are not there
    labels = {"rigid": "rigid or driven", "uniform": "of uniform strain", "linear": "of linear strain",
              "zoned": "zoned", "sphere": "spheres without orientation"}  # fmt: skip
    (line,) = [line for line in text.splitlines() if line.startswith("blocks that are")]
    for other, label in labels.items():
        assert (label in line) == (other != kind), label


RUN = """
import sys, warnings
import fdem
from fdem.blocks import bounds
from fdem.contact import table
warnings.simplefilter("ignore")
scene = fdem.Scene()
scene.add(fdem.brick((-1, -1, -1), (9, 2, 0)), fdem.Rigid(), fixed=True, name="base")
rock = fdem.Elastic(2500.0, 1e9, 0.2)
for k, body in enumerate(({bodies})):
    scene.add(fdem.brick((2 * k, 0, 0), (2 * k + 1, 1, 1)), body, rock)
scene.add(fdem.sphere(0.5, (7.5, 0.5, 0.5)), fdem.Rigid(), rock)
scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
sim = fdem.Simulation(scene, fdem.Relaxation())
sim.cycle(20)
sim.contact_table(), sim.energy, sim.describe()
print(*{{m.split(".")[0] for m in sys.modules}})
"""


def loaded(bodies):
    code = RUN.format(bodies=bodies)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    return set(done.stdout.split())


def test_scenes_without_zones_import_no_mesher_and_no_assembly():
    """A run of rigid, uniform-strain and linear-strain blocks and spheres, results and description included."""
    heavy = {"gmsh", "skfem", "pyvista", "meshio", "matplotlib", "vtkmodules"}
    assert not heavy & loaded("fdem.Rigid(), fdem.UniformStrain(), fdem.LinearStrain()")
    assert "gmsh" in loaded("fdem.Rigid(), fdem.Zoned(size=0.5)")  # the test would see it


COMPILED = """
import sys
from pathlib import Path
import fdem
from fdem.blocks import bounds
from fdem.contact import table
import examples.incline as incline
fdem.Simulation.plot = lambda *a, **k: None
incline.main(Path(sys.argv[1]))
for name, module in sorted(sys.modules.items()):
    if name.startswith("fdem.kernels."):
        for key, value in vars(module).items():
            if n := len(getattr(value, "signatures", ())):
                print(name.removeprefix("fdem.kernels.") + "." + key, n)
"""
# all that a rigid block on a rigid base needs while it slides, with cuts, damping, energies and a history
SLIDING = {
    "blocks": {"rigid_place", "rigid_push", "rigid_pull", "rigid_accelerate", "rigid_advance"},
    "clipping": {"clip_faces"},
    "footprints": {"close_patches", "measure", "along_edges", "closed_points", "latent_reach"},
    "geometry": {"face_geometry", "face_pairs"},
    "joints": {"coulomb", "total_work"},
    "memory": {"carry_memory", "keep", "slip_energy"},
    "patches": {"weights_at", "fill_rows", "reduced_mass", "scatter", "stored_energy"},
    "upkeep": {"moved", "block_motion", "closing", "worn_pairs", "prune"},
}


def signatures(folder, **environment):
    """Kernels that the example of the sliding block calls, with the numbers of their signatures."""
    done = subprocess.run(
        [sys.executable, "-c", COMPILED, str(folder)], capture_output=True, text=True, cwd=ROOT, check=True,
        env=os.environ | environment,
    )  # fmt: skip
    return {name: int(n) for name, n in map(str.split, done.stdout.splitlines())}


def test_a_sliding_block_needs_few_kernels_and_each_for_one_layout_of_its_arrays(tmp_path):
    """What this costs at the first start: a kernel more is half a second, a second layout its kernel once more."""
    found = {name: n for name, n in signatures(tmp_path).items() if "._" not in name}  # helpers: below
    assert set(found) <= {f"{file}.{name}" for file, names in SLIDING.items() for name in names}
    assert set(found.values()) == {1}
    assert {"clipping.clip_faces", "memory.keep", "joints.coulomb"} <= set(found)  # the test sees them


@pytest.mark.long
def test_a_first_start_compiles_no_helper_twice_nor_those_of_other_bodies(tmp_path):
    """Helpers too, which a warm start does not show: of convex blocks none that only other ones need."""
    found = signatures(tmp_path, FDEM_CACHE="0")
    assert {name: n for name, n in found.items() if n > 1} == {}
    assert "clipping._cut" in found
    others = ("clipping._rival", "clipping._owns", "clipping._upright", "clipping._near", "geometry._sort")
    assert not set(others) & set(found)


def test_stiffness_by_numpy_is_that_of_the_kernels(monkeypatch):
    """Both of joints as rigid blocks feel them, to the last bit, and of gridpoints, to the order of sums."""
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (2, 2, 1)), fdem.Rigid(), fdem.Elastic(2500.0), fixed=True)
    for x in (0.1, 1.1):
        scene.add(fdem.brick((x, 0.1, 1), (x + 1, 1.3, 2)), fdem.Rigid(), fdem.Elastic(2500.0))
        scene.add(fdem.brick((x, 0.2, 2), (x + 1, 1.1, 3)), fdem.UniformStrain(), fdem.Elastic(2500.0, 1e9, 0.2))
    scene.joint(fdem.Coulomb(kn=1e9, ks=5e8, friction=30))
    sim = fdem.Simulation(scene, fdem.Explicit(), progress=False)
    contacts, x = sim.system.contacts, sim.state.x
    rows, block = contacts.stiffness(x), np.repeat(np.arange(5), 8)
    place, mobile = np.array([-1, 0, -1, 1, -1]), np.arange(5) > 0
    centre = np.array([x[block == b].mean(axis=0) for b in (1, 3)])
    found = []
    for few in (10**6, 0):
        monkeypatch.setattr(bounds, "FEW", few)
        monkeypatch.setattr(table, "FEW", few)
        joints = bounds.joint_stiffness(rows, x, block, mobile, place, centre)
        found.append((joints, contacts.potential_k_gp(x, mobile[block])))
    assert found[0][0].any()
    assert found[0][1].any()
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-14)


def test_rigid_blocks_have_no_strain_and_spheres_no_orientation(monkeypatch):
    """No step asks them for internal forces; the configuration of a sphere is its centre."""
    from fdem.blocks.rigid import RigidBlocks
    from fdem.blocks.spheres import SphereBlocks

    def never(*_):
        raise AssertionError("internal forces of a rigid block")

    for batch in (RigidBlocks, SphereBlocks):
        monkeypatch.setattr(batch, "internal", never)
    for kind, coordinates in (("rigid", 7), ("sphere", 3)):
        sim = simulation(on_base(kind, angular_velocity=(0.0, 0.0, 1.0)))
        sim.cycle(10)
        assert len(sim.state.q) == coordinates and len(sim.state.v) == 6
        for name in ("strain", "stress"):
            with pytest.raises(fdem.UnsupportedError, match=name):
                getattr(sim["block"], name)
    with pytest.raises(fdem.UnsupportedError, match="orientation"):
        _ = sim["block"].rotation


def columns(body, extra):
    """Sixty blocks that move, and so many fixed ones around them."""
    scene = fdem.Scene()
    scene.add(fdem.brick((-1, -1, -1), (21, 2, 0)), fdem.Rigid(), fixed=True)
    for place in np.ndindex(20, 3):
        low = np.array([place[0], 0.0, place[1]])
        scene.add(fdem.brick(low, low + np.array([0.9, 1, 1])), body, ROCK)
    for k in range(extra):
        low = np.array([k // 32, 3 + k % 32, -1.0])
        scene.add(fdem.brick(low, low + 1), fdem.Rigid(), fixed=True)
    scene.joint(fdem.Coulomb(kn=1e9, ks=1e9, friction=30))
    return quietly(fdem.Simulation, scene, fdem.Explicit(), progress=False)


@pytest.mark.parametrize("kind", ["rigid", "uniform"])
def test_nothing_is_computed_for_fixed_blocks(kind):
    """1000 fixed blocks more: the same unknowns, motion and batches, and a step that costs the same.

    In processor time, the median of ratios of runs by turns: 1.08 times, most of it for clearing the forces of 8000
    gridpoints; it was 1.6 times when every step looked whether fixed blocks had moved. A busy machine is given room.
    """
    few, many = (columns(KINDS[kind], extra) for extra in (0, 1000))
    for sim in (few, many):
        sim.cycle(50)
    assert len(few.state.v) == len(many.state.v)
    np.testing.assert_allclose(many.state.v, few.state.v, atol=1e-9 * np.abs(few.state.v).max())  # another origin
    assert [b.n_blocks for b in few.model.batches] == [b.n_blocks for b in many.model.batches] == [60]
    assert few.system.contacts.n_patches == many.system.contacts.n_patches
    steps, times = 200, {few: [], many: []}
    for _ in range(7):
        for sim, spent in times.items():
            start = time.process_time()
            sim.cycle(steps)
            spent.append((time.process_time() - start) / steps)
    assert np.median(np.divide(times[many], times[few])) <= 1.35
