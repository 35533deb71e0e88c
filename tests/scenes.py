"""Scenes that several tests share, built the same way in every process."""

from __future__ import annotations

import warnings

import numpy as np

import fdem

STONE = fdem.Elastic(density=2500, young=1e9, poisson=0.2)


def pile(body_above=None, strain="large", damping=0.05, **given):
    """Rigid base, a zoned block on it, a rigid one that slides and leans, spinning and moving at the start."""
    scene = fdem.Scene(gravity=(2.0, 0.5, -9.0), **given)
    scene.add(fdem.brick((-2, -2, -0.5), (3, 3, 0)), fdem.Rigid(), name="base", fixed=True)
    scene.add(fdem.brick((0, 0, 0), (1, 1, 0.5)), fdem.Zoned(size=0.5, strain=strain), STONE, name="low", group="free")
    scene.add(
        fdem.brick((0.3, 0.2, 0.5), (1.1, 0.9, 1.1)), body_above or fdem.Rigid(), STONE, name="high", group="free",
        velocity=(0.3, 0.1, 0.0), angular_velocity=(0.0, 0.0, 0.4),
    )  # fmt: skip
    scene.add(fdem.brick((1.1, 0, 0), (1.5, 0.5, 0.4)), fdem.Rigid(), STONE, name="side", group="free")
    scene.joint(fdem.Coulomb(kn=5e8, ks=3e8, friction=20, cohesion=1e3, tension=1e3, damping=damping))
    return scene


def staged():
    """A jointed column with an opening cut by a shape, glued at first, under in-situ stress."""
    scene = fdem.Scene()
    scene.add(fdem.brick((0, 0, 0), (2, 1, 3)), fdem.Rigid(), STONE, name="rock")
    scene.cut(fdem.JointSet(20, 90, spacing=1.0, origin=(1, 0, 0.3), name="bed"))
    scene.cut(fdem.brick((0.6, -1, 1.0), (1.4, 2, 1.9)), name="opening")
    for i, block in enumerate(scene.blocks):
        if i % 2:
            block.body = fdem.Zoned(size=0.7)
    scene.fix(component="z", where=lambda x: np.abs(x[:, 2]) < 1e-9)
    for axis in range(2):
        scene.fix(component="xy"[axis], where=lambda x, k=axis: np.abs(x[:, k] - (1 - 0.5 * k)) > 0.999 - 0.5 * k)
    scene.joint(fdem.Coulomb(kn=2e9, ks=1e9, friction=30))
    scene.joint(fdem.Bonded(kn=4e9, ks=2e9), "opening")
    scene.apply(fdem.Stress(zz=lambda x: -2.5e4 * (5 - x[:, 2]), k=(0.5, 0.5)))
    return scene


def quietly(function, *args, **given):
    """Result of a call whose warnings do not matter here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fdem.FdemWarning)
        return function(*args, **given)


def simulation(scene, integrator=None, **options):
    return quietly(fdem.Simulation, scene, integrator or fdem.Explicit(), progress=False, **options)


def everything(sim):
    """Every array and sum that tells one state from another."""
    result = {name: getattr(sim.state, name) for name in ("q", "v", "x", "x_old")}
    result |= {"t": sim.time, "step": sim.steps, "dt": sim.dt, "lag": sim.system.lag}
    result |= {"x0": sim.x0, "turned": sim.turned, "displacement": sim.displacements(), "velocity": sim.velocity}
    result |= {"zone_stress": sim.zone_stresses(), "names": np.array(sim.model.names)}
    result |= {f"table_{k}": v for k, v in sim.contact_table().items() if k != "joint_names"}
    if sim.system.contacts is not None:
        kept = sim.system.contacts.state_arrays()
        result |= {f"contacts_{key}": kept[key] for key in kept if key.startswith(("patch", "pairs", "work", "x_"))}
    if sim.ledger is not None:
        energy = sim.energy
        result |= {f"energy_{name}": getattr(energy, name) for name in energy.__dataclass_fields__}
    return {key: np.asarray(value) for key, value in result.items()}


def assert_same_bits(first, second):
    """Compare two results of `everything` bit by bit."""
    assert first.keys() == second.keys()
    different = [
        key for key in first
        if first[key].shape != second[key].shape or first[key].tobytes() != second[key].tobytes()
    ]  # fmt: skip
    assert not different, f"differ: {', '.join(different)}"
