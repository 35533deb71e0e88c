"""Reading: OBJ groups, STL, PLY, volume meshes with names, other libraries' meshes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fdem.errors import MeshError, SceneError
from fdem.scene.generate import brick, icosphere
from fdem.scene.reading import as_shape, read, tet_blocks
from fdem.scene.shapes import Polyhedron, Surface, TetMesh

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
TUNNEL = ROOT / "meshes" / "tunnel.msh"

OBJ = """# two boxes
o first
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 1 4 3 2
f 5/1 6/2 7/3 8/4
f 1//1 2//1 6//1 5//1
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
g second
v 2 0 0
v 3 0 0
v 2 1 0
v 2 0 1
f -4 -2 -3
f -4 -3 -1
f -3 -2 -1
f -2 -4 -1
"""

# two tetrahedra on each side of x = 0
POINTS = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0], [1, 1, 1]], dtype=float)
TETS = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [1, 2, 3, 5]])


def data(name):
    path = DATA / name / "blocks.obj"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    return path


def test_obj_groups_indices_and_scale(tmp_path):
    path = tmp_path / "two.obj"
    path.write_text(OBJ)
    box, corner = read(path, scale=0.5)
    assert (box.name, corner.name) == ("first", "second")
    assert box.volume == pytest.approx(0.125)
    assert corner.volume == pytest.approx(1 / 48)
    assert len(box.faces) == 6


def test_obj_without_groups_falls_into_parts(tmp_path):
    path = tmp_path / "plain.obj"
    path.write_text("\n".join(line for line in OBJ.splitlines() if line[:1] not in "og"))
    assert sorted(round(s.volume, 9) for s in read(path)) == [round(1 / 6, 9), 1.0]


def test_obj_with_its_own_vertices_per_face_and_a_warped_quad(tmp_path):
    box = brick((0, 0, 0), (1, 1, 1))
    rows, faces = [], []
    for face in box.faces:
        start = len(rows) + 1
        rows += [f"v {x} {y} {z if (x, y, z) != (1, 1, 1) else 1.01}" for x, y, z in box.points[face]]
        faces.append("f " + " ".join(str(start + k) for k in range(4)))
    path = tmp_path / "soup.obj"
    path.write_text("\n".join(rows + faces))
    (shape,) = read(path)
    assert len(shape.points) == 8
    assert len(shape.triangles) == 12
    # one corner is 1 % higher, so that quads are not planar: a third of a per cent of volume
    assert shape.volume == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0\nf 1 1 1", "line 1: v"),
        ("v 0 0 x\n", "line 1: v"),
        ("v 0 0 0\nf 1 2 3", "line 2: face index 2 out of range"),
        ("v 0 0 0\nf 1 a 3", "line 2: f"),
        ("v 0 0 0\nv 1 0 0\nf 1 2", "fewer than three"),
        ("v 0 0 0\n", "empty mesh"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "open at edge"),
        ("o a\nv 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", r"'a'.*points\[0\]"),
    ],
)
def test_bad_obj_names_file_and_line(tmp_path, text, message):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(MeshError, match=f"bad.obj.*{message}"):
        read(path)


def test_missing_unknown_and_bad_scale(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        read(tmp_path / "none.stl")
    path = tmp_path / "what.stl"
    path.write_text("not a mesh")
    with pytest.raises(SceneError, match=r"what\.stl"):
        read(path)
    with pytest.raises(SceneError, match="scale"):
        read(path, scale=0.0)


@pytest.mark.parametrize("suffix", ["stl", "ply", "off"])
def test_surface_files(tmp_path, suffix):
    meshio = pytest.importorskip("meshio")
    one, two = icosphere(1.0, (0, 0, 0), 1), icosphere(1.0, (5, 0, 0), 1)
    points = np.vstack([one.points, two.points])
    cells = np.vstack([one.triangles, two.triangles + len(one.points)])
    path = tmp_path / f"balls.{suffix}"
    meshio.write(path, meshio.Mesh(points, [("triangle", cells)]))
    shapes = read(path, scale=2.0)
    assert len(shapes) == 2
    assert sum(s.volume for s in shapes) == pytest.approx(16 * one.volume, rel=1e-5)


def test_open_surface_on_request(tmp_path):
    path = tmp_path / "terrain.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (terrain,) = read(path, surface=True)
    assert isinstance(terrain, Surface)


def test_vault_volumes_agree_with_the_reference():
    shapes = read(data("barrel_vault"))
    assert len(shapes) == 121
    assert all(s.is_convex for s in shapes)
    reference = json.loads((DATA / "barrel_vault" / "lmgc90_reference.json").read_text())
    np.testing.assert_allclose([s.volume for s in shapes], reference["block_volume"], rtol=1e-6)


def test_crossvault_and_wall():
    vault = read(data("crossvault"), scale=0.0254)
    assert len(vault) == 184
    assert all(s.volume > 0.0 for s in vault)
    assert max(s.report().concavity for s in vault) > 0.2
    bricks = read(data("wall"))
    assert len(bricks) == 38
    assert sum(b.volume for b in bricks) == pytest.approx(4.365625, rel=1e-12)


def test_tunnel_splits_along_the_fault():
    pytest.importorskip("meshio")
    blocks = tet_blocks(TUNNEL, split="fault")
    assert [group for _, group in blocks] == ["rock", "rock", "stage_1", "stage_2", "stage_3"]
    assert sum(shape.volume for shape, _ in blocks) == pytest.approx(4000.0, rel=1e-12)
    left, right = (shape for shape, group in blocks if group == "rock")
    assert len(left.facet_tags["fault"]) == len(right.facet_tags["fault"]) > 50
    assert None not in left.surface.face_tags
    assert "rock|stage_1" in left.facet_tags
    # the crown is a vertex of the rock
    assert np.linalg.norm(left.points - [0, 0, -100], axis=1).min() < 1e-9
    assert len(tet_blocks(TUNNEL)) == 4
    with pytest.raises(SceneError, match="'nowhere' is no surface of the mesh; it has"):
        tet_blocks(TUNNEL, split="nowhere")
    with pytest.raises(SceneError, match="boundary"):
        tet_blocks(TUNNEL, split=["outer"])


def physical_mesh(surface):
    meshio = pytest.importorskip("meshio")
    return meshio.Mesh(
        POINTS,
        [("triangle", np.array(surface)), ("tetra", TETS)],
        cell_data={"gmsh:physical": [np.full(len(surface), 7), np.array([1, 1, 1])]},
        field_data={"seam": np.array([7, 2]), "rock": np.array([1, 3])},
    )


def test_split_between_and_surface_that_ends_inside():
    blocks = tet_blocks(physical_mesh([[0, 1, 2]]), split="seam")
    assert [len(shape.tets) for shape, _ in blocks] == [2, 1]
    assert {group for _, group in blocks} == {"rock"}
    assert blocks[1][0].surface.face_tags.count("seam") == 1
    meshio = pytest.importorskip("meshio")
    # a fan of four around an axis: one facet alone does not separate it
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
    fan = [[0, 1, 2, 3], [0, 1, 3, 4], [0, 1, 4, 5], [0, 1, 5, 2]]
    mesh = meshio.Mesh(
        points, [("triangle", [[0, 1, 2]]), ("tetra", fan)], cell_sets={"crack": [[0], []], "all": [[], [0, 1, 2, 3]]}
    )
    with pytest.raises(SceneError, match="'crack' ends inside the body"):
        tet_blocks(mesh, split="crack")
    ((shape, group),) = tet_blocks(mesh)
    assert group == "all"
    assert shape.volume == pytest.approx(4 / 6)


@pytest.mark.parametrize("file_format", ["gmsh22", "gmsh"])
def test_msh_versions(tmp_path, file_format):
    meshio = pytest.importorskip("meshio")
    mesh = physical_mesh([[0, 1, 2]])
    mesh.cell_data["gmsh:geometrical"] = [np.array([7]), np.array([1, 1, 1])]
    path = tmp_path / "two.msh"
    if file_format == "gmsh22":
        meshio.write(path, mesh, file_format=file_format, binary=False)
    else:
        _write_with_gmsh(path)
    blocks = tet_blocks(path, split="seam")
    assert len(blocks) == 2
    assert {g for _, g in blocks} == {"rock"}
    shapes = read(path, scale=10.0)
    assert sum(s.volume for s in shapes) == pytest.approx(1000.0 * sum(s.volume for s, _ in blocks))


def _write_with_gmsh(path):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        occ = gmsh.model.occ
        boxes = [(3, occ.addBox(0, 0, 0, 1, 1, 1)), (3, occ.addBox(1, 0, 0, 1, 1, 1))]
        occ.fragment(boxes[:1], boxes[1:])
        occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [t for _, t in gmsh.model.getEntities(3)], name="rock")
        seam = [t for d, t in gmsh.model.getEntities(2) if len(gmsh.model.getAdjacencies(d, t)[0]) == 2]
        gmsh.model.addPhysicalGroup(2, seam, name="seam")
        gmsh.option.setNumber("Mesh.MeshSizeMin", 1.0)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def test_cell_sets_of_abaqus_and_numbers_of_vtu(tmp_path):
    meshio = pytest.importorskip("meshio")
    mesh = meshio.Mesh(POINTS, [("tetra", TETS)], cell_sets={"hard": [np.array([0, 2])], "soft": [np.array([1])]})
    meshio.write(tmp_path / "sets.inp", mesh)
    assert sorted(g for _, g in tet_blocks(tmp_path / "sets.inp")) == ["hard", "soft"]
    mesh = meshio.Mesh(POINTS, [("tetra", TETS)], cell_data={"material": [np.array([3, 4, 3])]})
    meshio.write(tmp_path / "numbers.vtu", mesh)
    assert [(g, len(s.tets)) for s, g in tet_blocks(tmp_path / "numbers.vtu")] == [("3", 2), ("4", 1)]


def test_inverted_tets_are_oriented():
    meshio = pytest.importorskip("meshio")
    shape = as_shape(meshio.Mesh(POINTS, [("tetra", TETS[:, [1, 0, 2, 3]])]))
    edges = shape.points[shape.tets[:, 1:]] - shape.points[shape.tets[:, :1]]
    assert (np.linalg.det(edges) > 0).all()
    with pytest.raises(SceneError, match="hexahedron"):
        as_shape(meshio.Mesh(np.random.default_rng(0).random((9, 3)), [("tetra", TETS), ("hexahedron", [range(8)])]))


def test_shapes_of_other_libraries():
    box = brick((0, 0, 0), (1, 1, 1))
    assert as_shape(box) is box
    skfem = pytest.importorskip("skfem")
    mesh = skfem.MeshTet().refined(1).with_boundaries({"floor": lambda x: x[2] == 0.0})
    shape = as_shape(mesh)
    assert isinstance(shape, TetMesh)
    assert shape.volume == pytest.approx(1.0)
    assert shape.surface.face_tags.count("floor") == len(shape.facet_tags["floor"]) > 0
    pyvista = pytest.importorskip("pyvista")
    cube = as_shape(pyvista.Cube(center=(1, 2, 3)))
    assert isinstance(cube, Polyhedron)
    assert cube.volume == pytest.approx(1.0)
    with pytest.raises(MeshError, match="open"):
        as_shape(pyvista.Plane())
    grid = pyvista.UnstructuredGrid({10: TETS}, POINTS)
    assert isinstance(as_shape(grid), TetMesh)
    with pytest.raises(SceneError, match="shape = str"):
        as_shape("block")
