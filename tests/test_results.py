"""Histories, files and pictures, on a view made by hand: two zoned cubes on a rigid brick."""

from __future__ import annotations

import io
import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fdem.errors import SceneError
from fdem.results import datasets, surfaces
from fdem.results.history import NEVER, Every, History, as_every, quantity
from fdem.results.output import Checkpoint, Frames
from fdem.results.progress import Progress
from fdem.results.scales import limits_of, readable

CUBE = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
FACES = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
TRIANGLES = np.concatenate([FACES[:, [0, 1, 2]], FACES[:, [0, 2, 3]]]).astype(np.int32)
ZONES = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]], dtype=np.int32)


def make_view(blocks: int = 3, scale: float = 1.0) -> SimpleNamespace:
    """Cubes at x = 0 and 1 (the second only of three blocks), on a brick from z = -1 to 0."""
    corners = [CUBE, CUBE + np.array([1, 0, 0]), CUBE * [2, 1, 1] - [0, 0, 1]]
    corners = [corners[0], corners[2]] if blocks == 2 else corners
    zoned = np.array([True] * (blocks - 1) + [False])
    X = scale * np.concatenate(corners)
    ids = np.arange(blocks, dtype=np.int32)
    model = SimpleNamespace(
        names=[f"b{i}" for i in range(blocks)], groups=["wall"] * (blocks - 1) + [None],
        gp_block=np.repeat(ids, 8), X=X,
        zones=np.concatenate([ZONES + 8 * i for i in range(blocks - 1)]).astype(np.int32),
        zone_block=np.repeat(ids[:-1], 6),
        triangles=np.concatenate([TRIANGLES + 8 * i for i in range(blocks)]).astype(np.int32),
        triangle_block=np.repeat(ids, 12), triangle_tag=np.tile([0, 0, -1, -1, 1, 1], 2 * blocks).astype(np.int32),
        tags=["bed", "cross"], zoned=zoned, fixed=~zoned, origin=np.zeros(3),
        balls=np.zeros(0, dtype=np.int32), ball_radius=np.zeros(0),
    )  # fmt: skip
    u = np.where(X[:, 2:] > 0, 1e-3 * scale, 0.0) * [1.0, 0.0, 2.0]
    normal = np.array([[1.0, 0, 0], [0, 0, -1], [0, 0, -1]])
    table = dict(
        block_a=np.array([0, 0, 1], np.int32), block_b=np.array([1, 2, 2], np.int32), joint=np.zeros(3, np.int32),
        joint_names=["rough"], normal=normal, gap=scale * np.array([1e-4, -1e-6, -2e-6]),
        area=scale**2 * np.ones(3), traction=np.array([[0.0, 0, 0], [1e5, 2e4, 0], [2e5, 0, 1e4]]),
        force=-normal * 1e5, slip=scale * np.array([0.0, 1e-3, 2e-3]), state=np.array([3, 2, 1], np.int8),
        position=scale * np.array([[1, 0.5, 0.5], [0.5, 0.5, 0], [1.5, 0.5, 0]]),
        patch=np.arange(3, dtype=np.int32),
    )  # fmt: skip
    stress = np.tile([1.0, 2, 3, 4, 5, 6], (len(model.zones), 1)) * 1e5
    inner = np.full((blocks, 6), np.nan)
    return SimpleNamespace(
        model=model, time=0.5, steps=10, positions=lambda: X + u, displacements=lambda: u, velocities=lambda: 10 * u,
        zone_stresses=lambda: stress, block_stress=lambda: inner, contact_table=lambda: table,
        gridpoint_stress=lambda: inner[model.gp_block],
        surface_stress=lambda rows: inner[model.triangle_block[rows]],
    )  # fmt: skip


# -- triggers, quantities, histories ----------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [{}, {"steps": 1, "time": 1.0}, {"steps": 0}, {"steps": 1.5}, {"time": -1.0},
                                 {"time": math.inf}, {"steps": True}])  # fmt: skip
def test_every_rejects(bad):
    with pytest.raises(SceneError, match="Every"):
        Every(**bad)


def test_every_steps_and_time():
    assert [Every(steps=10).next(s, 0.0, 1e-3) for s in (0, 9, 10, 13)] == [10, 1, 10, 7]
    assert Every(time=0.01).next(0, 0.0, 0.1) == 1
    assert Every(time=0.01).next(0, 0.0, 0.0) == NEVER
    assert as_every(5) == Every(steps=5) and as_every(None) == Every(steps=1)
    with pytest.raises(SceneError, match=r"Every\(time=0.1\)"):
        as_every(0.1)


@pytest.mark.parametrize("dt", [1e-3, 7.3e-4, 0.1 / 3])
def test_every_time_comes_once_per_period(dt):
    every, t, step, seen = Every(time=0.1), 0.0, 0, []
    while t < 2.0:
        for _ in range(every.next(step, t, dt)):
            t += dt
            step += 1
        seen.append(t)
    period = np.floor(np.array(seen) / 0.1 + 1e-5 * dt)
    assert (np.diff(period) == 1.0).all()
    assert (np.array(seen) / 0.1 - period < dt / 0.1 + 1e-9).all()


def test_quantity_components_and_units():
    view = SimpleNamespace(
        displacement=np.arange(3.0), stress=np.arange(12.0).reshape(2, 6), rotation=np.arange(9.0).reshape(3, 3),
        energy=SimpleNamespace(kinetic=7.0), ratio=1e-3,
    )  # fmt: skip
    for name, component, value, unit in (
        ("displacement", None, [0, 1, 2], "m"), ("displacement", "z", 2, "m"), ("displacement", 1, 1, "m"),
        ("displacement", "magnitude", math.sqrt(5), "m"), ("stress", "zx", [4, 10], "Pa"), ("rotation", "yx", 3, "-"),
        ("kinetic", None, 7, "J"), ("unbalanced ratio", None, 1e-3, "-"), ("ratio", None, 1e-3, "-"),
    ):  # fmt: skip
        getter, found = quantity(name, component)
        np.testing.assert_array_equal(getter(view), value)
        assert found == unit
    for name, component in (("speed", None), ("displacement", "xx"), ("displacement", 3), ("kinetic", "x")):
        with pytest.raises(SceneError, match="history"):
            quantity(name, component)


def test_history_grows_and_keeps_shape():
    history = History(lambda view: [view.time, 2.0], every=2, name="pair", unit="m")
    view = SimpleNamespace(time=0.0, steps=0)
    assert history.values.shape == (0,) and len(history) == 0
    for k in range(200):
        view.time, view.steps = 0.1 * k, 2 * k
        history.record(view)
        history.record(view)  # twice at one step is once
    assert len(history) == 200 and history.values.shape == (200, 2) and history.to_numpy().shape == (200, 3)
    np.testing.assert_array_equal(history.steps, 2 * np.arange(200))
    np.testing.assert_array_equal(history.values[:, 0], history.time)
    assert history.next(3, 0.0, 1.0) == 1 and history.unit == "m"


def test_progress():
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    view = SimpleNamespace(steps=0, time=0.0, ratio=1.0)
    silent = Progress(steps=10, stream=io.StringIO())
    assert silent.next(0, 0.0, 1.0) == NEVER
    silent.record(view)
    silent.finish()
    assert silent._stream.getvalue() == ""
    shown = Progress(steps=10, stream=Terminal())
    shown.start(view)
    view.steps = 5
    assert shown.next(0, 0.0, 1.0) >= 1
    shown.record(view)
    shown.finish()
    # asked again from the step before, an observer says whether it was due
    due = 5 + shown.next(5, 0.0, 1.0)
    assert shown.next(due - 1, 0.0, 1.0) == 1 and shown.next(due + 7, 0.0, 1.0) == 1
    text = shown._stream.getvalue()
    assert "50.0 %" in text and "left" in text and "steps/s" in text and text.endswith("\n")
    falling = Progress(ratio=1e-4, show=True, stream=io.StringIO())
    falling.start(view)
    for ratio in (1.0, 1e-2):
        view.ratio = ratio
        falling.record(view)
    assert "50.0 %" in falling._stream.getvalue()


# -- files ------------------------------------------------------------------------------------------------------------


def read_frames(path):
    """Frames of a file as VTK, and with it ParaView, reads them."""
    pv = pytest.importorskip("pyvista")
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(reader.GetExecutive().TIME_STEPS())
    frames = []
    for t in times:
        reader.UpdateTimeStep(t)
        frames.append(pv.wrap(reader.GetOutput()).copy())
    return times, frames


def test_frames_read_back_also_after_excavation(tmp_path):
    pytest.importorskip("h5py")
    frames = Frames(tmp_path / "run.vtkhdf", every=Every(time=0.1))
    views = [make_view(), make_view(), make_view(2), make_view(2)]
    views[1].model, views[3].model = views[0].model, views[2].model
    for k, view in enumerate(views):
        view.time, view.steps = 0.25 * k, 5 * k
        view.positions = lambda k=k, old=view.positions: old() + 1e6 * k
        frames.record(view)
        frames.record(view)
    times, found = read_frames(frames.path)
    assert len(frames) == 4 and times == (0.0, 0.25, 0.5, 0.75)
    for k, (view, grid) in enumerate(zip(views, found, strict=True)):
        expected = datasets.mesh(view)
        np.testing.assert_array_equal(grid.points, view.positions())
        assert grid.points.dtype == np.float64
        for name in ("celltypes", "cell_connectivity"):
            np.testing.assert_array_equal(getattr(grid, name), getattr(expected, name))
        for name in ("block", "group", "stress"):
            np.testing.assert_allclose(grid.cell_data[name], expected.cell_data[name], rtol=1e-6)
        for name in ("displacement", "velocity"):
            np.testing.assert_allclose(grid.point_data[name], expected.point_data[name], rtol=1e-6)
        assert list(grid.field_data["block_names"]) == view.model.names
        assert list(grid.field_data["group_names"]) == ["wall", ""]
        assert grid.field_data["step"][0] == 5 * k


def test_frames_write_the_mesh_once(tmp_path):
    h5py = pytest.importorskip("h5py")
    frames, view = Frames(tmp_path / "a.vtkhdf", axis="step"), make_view()
    for k in range(3):
        view.steps = k
        frames.record(view)
    with h5py.File(frames.path) as file:
        root = file["VTKHDF"]
        assert len(root["Types"]) == 24 and len(root["CellData/block"]) == 24
        assert len(root["Points"]) == 72 and list(root["Steps/Values"]) == [0, 1, 2]
    with pytest.raises(SceneError, match="vtkhdf"):
        Frames("run.pvd")


def test_checkpoint_keeps_the_newest(tmp_path):
    view = SimpleNamespace(n=0)
    view.save = lambda path: path.write_text(str(view.n))
    checkpoint = Checkpoint(tmp_path / "state", every=10, keep=2)
    for view.n in range(3):
        checkpoint.record(view)
    found = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert found == {"state.npz": "2", "state.1.npz": "1"} and checkpoint.next(3, 0.0, 1.0) == 7
    with pytest.raises(SceneError, match="keep"):
        Checkpoint("a.npz", keep=0)


# -- datasets ---------------------------------------------------------------------------------------------------------


def test_mesh_and_tensor_layout():
    pytest.importorskip("pyvista")
    grid = datasets.mesh(make_view())
    assert grid.n_cells == 12 + 12 and grid.n_points == 24
    # xx xy xz / yx yy yz / zx zy zz of xx yy zz yz zx xy = 1 2 3 4 5 6
    np.testing.assert_array_equal(grid.cell_data["stress"][0], 1e5 * np.array([1, 6, 5, 6, 2, 4, 5, 4, 3]))
    assert np.isnan(grid.cell_data["stress"][12:]).all()
    np.testing.assert_array_equal(grid.cell_data["block"], np.repeat([0, 1, 2], [6, 6, 12]))
    np.testing.assert_array_equal(grid.cell_data["group"], np.repeat([0, 1], 12))
    assert abs(grid.compute_cell_sizes()["Volume"].sum() - 2.004) < 1e-3


def test_contacts():
    pytest.importorskip("pyvista")
    cloud = datasets.contacts(make_view())
    assert cloud.n_points == cloud.n_verts == 3
    assert list(cloud.field_data["state_names"]) == ["intact", "closed", "slipping", "open"]
    for name in ("block_a", "block_b", "joint", "normal", "gap", "area", "traction", "force", "slip", "state"):
        np.testing.assert_array_equal(cloud.point_data[name], make_view().contact_table()[name])


# -- geometry of pictures ---------------------------------------------------------------------------------------------


def test_feature_edges_of_cubes():
    model = make_view().model
    assert len(surfaces.feature_edges(model.X, model.triangles)[0]) == 3 * 12
    edges, sides = surfaces.feature_edges(model.X, model.triangles[:1])
    assert len(edges) == 3 and (sides == 0).all()


@pytest.mark.parametrize("height", [0.0, 0.5, 1.0 - 1e-12])
def test_section_and_cap_of_a_cube(height):
    pytest.importorskip("pyvista")
    normal = np.array([0.0, 0.0, 1.0])
    cut = surfaces.section(CUBE, TRIANGLES, normal, np.array([0.0, 0.0, height]))
    points = cut.interpolate(CUBE)
    np.testing.assert_allclose(points[:, 2], height, atol=1e-15)
    assert (np.bincount(cut.segments.ravel()) == 2).all()
    filled = points[surfaces.cap(points, cut.segments, normal)]
    area = 0.5 * np.cross(filled[:, 1] - filled[:, 0], filled[:, 2] - filled[:, 0])[:, 2].sum()
    assert abs(area - 1.0) < 1e-12


def test_paint_and_refine():
    view = make_view()
    points, triangles, parent = surfaces.refine(CUBE, TRIANGLES, 0.5)
    assert len(triangles) == 12 * 4**2 and np.array_equal(np.bincount(parent), np.full(12, 16))
    outward = surfaces.normals(CUBE, TRIANGLES)[parent]
    found = surfaces.paint(view.contact_table(), points[triangles].mean(axis=1), outward, np.zeros(len(parent), int))
    np.testing.assert_array_equal(found, np.select([outward[:, 0] > 0.5, outward[:, 2] < -0.5], [0, 1], -1))


def test_scales():
    assert readable("m", 0.012)[1] == "mm" and readable("m", 25.0) == (1.0, "m")
    assert readable("Pa", 3e6)[1] == "MPa" and readable("rad", 1e-3) == (1.0, "rad")
    low, high, extend = limits_of(np.append(np.linspace(0, 1, 1000), 50.0), symmetric=False)
    assert low == 0.0 and high < 1.1 and extend == "max"
    assert limits_of(np.zeros(3), False)[2] == "neither" and limits_of(np.full(2, np.nan), False)[:2] == (0.0, 1.0)


# -- pictures ---------------------------------------------------------------------------------------------------------


def draw(view, path, **options):
    """Draw, and read the image back."""
    pytest.importorskip("pyvista")
    from matplotlib.image import imread

    from fdem.results.plot import plot

    plot(view, path, **options)
    return imread(path)[:, :, :3]


CLIP = ((0.0, -1.0, 0.0), (0.0, 0.4, 0.0))


@pytest.mark.parametrize("options", [
    {}, {"scalars": "velocity", "component": "z", "warp": "auto"}, {"scalars": "stress", "clip": CLIP},
    {"scalars": "stress", "component": "minor"}, {"scalars": "block", "camera": "-y"}, {"scalars": "group"},
    {"scalars": "joint", "title": "joints"}, {"scalars": "slip"}, {"scalars": "gap", "clip": CLIP},
    {"scalars": "traction", "component": "shear", "hide": ["b0"]},
])  # fmt: skip
def test_plot(tmp_path, options):
    image = draw(make_view(), tmp_path / "a.png", window_size=(480, 400), **options)
    ink = (image < 0.95).any(axis=2)
    assert 0.05 < ink.mean() < 0.95
    assert len(np.unique((image * 255).astype(np.uint8).reshape(-1, 3), axis=0)) > 20


def test_plot_fits_its_size_to_what_is_seen(tmp_path):
    image = draw(make_view(), tmp_path / "a.png", camera="-y")
    ink = (image < 0.95).any(axis=2)
    assert image.shape[1] > 800 and ink[:, :50].any() and ink[:50].any()


def test_plot_has_the_size_asked_for_and_the_same_bits_at_another_scale(tmp_path):
    a = draw(make_view(), tmp_path / "a.png", window_size=(640, 480))
    b = draw(make_view(scale=2.0**10), tmp_path / "b.png", window_size=(640, 480))
    assert a.shape == (480, 640, 3)
    drawn = slice(40, 420), slice(0, 500)  # beside the scale, whose numbers differ
    assert np.abs(a[drawn] - b[drawn]).max() < 0.02


def test_plot_errors(tmp_path):
    pytest.importorskip("pyvista")
    from fdem.results.plot import history_plot, plot

    for options in ({"scalars": "mood"}, {"component": "xx"}, {"camera": "left"}, {"hide": ["nobody"]}, {"hide": "*"},
                    {"clip": ((0, 0, 0), (0, 0, 0))}, {"clip": ((0, 0, 1), (0, 0, -5))}, {"limits": (1, 0)},
                    {"scalars": "stress", "component": "x"}, {"scalars": "slip", "component": "x"},
                    {"warp": "much"}):  # fmt: skip
        with pytest.raises(SceneError, match="plot"):
            plot(make_view(), tmp_path / "a.png", **options)
    with pytest.raises(SceneError, match="no histories"):
        history_plot([], tmp_path / "a.png")


def test_history_plot(tmp_path):
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    from fdem.results.plot import history_plot

    crown = History(lambda view: 1e-3 * math.sin(view.time), name="crown", unit="m")
    force = History(lambda view: [view.time, 2.0, 3.0], name="force", unit="N")
    for k in range(50):
        for history in (crown, force):
            history.record(SimpleNamespace(time=0.1 * k, steps=k))
    image = imread(history_plot([crown, force], tmp_path / "h.png", title="two"))
    assert image.std() > 0.02


def test_imports_are_lazy():
    code = (
        "import sys, fdem.results.plot, fdem.results.output, fdem.results.history, fdem.results.progress;"
        "print([m for m in ('pyvista', 'h5py', 'matplotlib', 'scipy', 'numba', 'vtkmodules') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
