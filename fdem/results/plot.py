"""Pictures of a simulation: blocks, fields and joints, without a display; curves of histories.

pyvista computes the image of the blocks, matplotlib sets it beside its scale. Neither is imported
before a picture is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem.errors import SceneError
from fdem.results import surfaces
from fdem.results.datasets import contacts, group_ids, mesh
from fdem.results.history import History
from fdem.results.picture import Picture, Sheet
from fdem.results.render import Layer, compose, curves, render
from fdem.results.scales import NEUTRAL, PALETTE, STONES, limits_of, readable

__all__ = ["contacts", "history_plot", "mesh", "plot"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

_VECTORS = {"displacement": "m", "velocity": "m/s"}
_CONTACTS = {"gap": "m", "slip": "m", "traction": "Pa"}
_SEQUENTIAL = {"displacement": "YlOrRd", "velocity": "YlGnBu", "stress": "Spectral_r"}
_NAMED = ("block", "group", "joint")
_VOIGT = {"xx": 0, "yy": 1, "zz": 2, "yz": 3, "zx": 4, "xy": 5, "zy": 3, "xz": 4, "yx": 5}


def plot(
    view: Any,
    path: str | Path,
    scalars: str = "displacement",
    warp: float | str = 1.0,
    *,
    component: str | None = None,
    clip: tuple[Sequence[float], Sequence[float]] | None = None,
    hide: Sequence[str | int] = (),
    camera: str | Sequence[float] | None = None,
    limits: tuple[float, float] | None = None,
    cmap: str | None = None,
    edges: bool = True,
    title: str | None = None,
    window_size: tuple[int, int] | None = None,
) -> Path:
    """Draw the blocks as they stand into an image file.

    Parameters
    ----------
    view : Simulation
        What is drawn.
    path : path
        File to write; its ending says the format (.png).
    scalars : str, optional
        What colours show: "displacement", "velocity" (magnitude, or a `component`), "stress" (von Mises,
        or a `component`), "block", "group", "joint" (the joint set that made a face), or of the joints
        "gap", "slip", "traction" (normal, compression positive; `component` "shear").
    warp : float or "auto", optional
        Displacements are drawn so many times; "auto" makes the largest a twentieth of the scene.
    component : str, optional
        "x", "y", "z" of a vector; "xx" ..., "mean", "major" (most tensile), "minor" (most compressive)
        of the stress; "normal" or "shear" of the traction.
    clip : (normal, origin), optional
        Plane that opens the model; what lies on the side its normal (3,) points to is taken away.
    hide : sequence of str or int, optional
        Blocks not drawn: numbers, names or groups, patterns allowed.
    camera : str or (3,) sequence, optional
        Where one looks from: "x", "-y", "iso", ..., or a direction. None looks along the thin axis of
        a flat scene, at the opened side of a clipped one, and from a corner otherwise.
    limits : (float, float), optional
        Ends of the colour scale, SI units.
    cmap : str, optional
        Name of a matplotlib colour map.
    edges : bool, optional
        Draw the edges of blocks.
    title : str, optional
        Heading.
    window_size : (int, int), optional
        Width and height of the image in pixels; None fits it to what is seen.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SceneError
        If an option is not one of the above or nothing is left to draw.
    UnsupportedError
        If this machine cannot render; says what to install.
    """
    if scalars not in (*_VECTORS, *_CONTACTS, *_NAMED, "stress"):
        known = ", ".join((*_VECTORS, "stress", *_NAMED, *_CONTACTS))
        raise SceneError(f"plot: unknown scalars {scalars!r}; known: {known}")
    picture = Picture(view, warp, hide, clip)
    joints = scalars in _CONTACTS
    if joints and picture.clip is None and picture.thin is not None:
        # joints of a flat scene are seen edge on: cut it in its middle and show their traces
        picture.clip = (picture.look(None), picture.points[picture.used].mean(axis=0))
    sheet = picture.sheet(_nodal(view, scalars)[picture.gridpoint])
    layers: list[Layer]
    scale: Scale | None
    if joints:
        layers, scale = _joint_layers(picture, view, scalars, component, limits, cmap, sheet)
    elif scalars in _NAMED:
        layers, scale = _named_layer(picture, scalars, sheet)
    else:
        layers, scale = _field_layer(scalars, component, limits, cmap, sheet)
    ghost = joints and picture.clip is None
    if edges:
        points, lines, tag = picture.outlines()
        if scalars == "joint":
            lines = lines[tag < 0]
        layers.append(Layer(points, lines, color="#8b9095" if ghost else "#23272b", width=0.8 if ghost else 1.6))
    direction = picture.look(camera)
    image = render(layers, direction, parallel=picture.flat_look(camera), window_size=window_size)
    caption = f"t = {view.time:.4g} s, step {view.steps}"
    if picture.factor != 1.0:
        caption += f", displacements drawn \N{MULTIPLICATION SIGN} {picture.factor:.4g}"
    caption += picture.note
    compose(image, Path(path), scale, direction=direction, caption=caption, title=title, window_size=window_size)
    return Path(path)


def history_plot(
    histories: History | Sequence[History], path: str | Path, *, against: str = "time", title: str | None = None
) -> Path:
    """Draw histories over time, one panel for each unit.

    Parameters
    ----------
    histories : History or sequence of History
        What is drawn; the components of a vector are curves of their own.
    path : path
        File to write; its ending says the format (.png, .pdf, .svg).
    against : {"time", "steps"}, optional
        Horizontal axis.
    title : str, optional
        Heading.

    Returns
    -------
    Path
        The file.
    """
    if against not in ("time", "steps"):
        raise SceneError(f"history_plot: against must be 'time' or 'steps', got {against!r}")
    items = [histories] if isinstance(histories, History) else list(histories)
    panels: dict[str, list[tuple[str, Array, Array]]] = {}
    for item in items:
        across = item.time if against == "time" else item.steps.astype(np.float64)
        columns = item.values.reshape(len(across), -1) if len(across) else np.empty((0, 1))
        for k, values in enumerate(columns.T):
            suffix = ""
            if columns.shape[1] > 1:
                suffix = " " + ("xyz"[k] if columns.shape[1] == 3 else str(k))
            panels.setdefault(item.unit, []).append((item.name + suffix, across, np.asarray(values)))
    if not panels:
        raise SceneError("history_plot: no histories given")
    curves(panels, Path(path), "time [s]" if against == "time" else "step", title)
    return Path(path)


# ---------------------------------------------------------------------------------------------------------------------
# how it is coloured


@dataclass(frozen=True)
class Scale:
    """Key of a picture: a colour bar (`limits`) or names with their colours (`entries`)."""

    title: str
    limits: tuple[float, float] | None = None
    cmap: str = ""
    extend: str = "neither"
    entries: tuple[tuple[str, str], ...] = ()


def _nodal(view: Any, scalars: str) -> Array:
    """Values (n_gp, k) at gridpoints that the colours are computed from."""
    model = view.model
    n = len(model.X)
    if scalars == "displacement":
        return np.asarray(view.displacements())
    if scalars == "velocity":
        return np.asarray(view.velocities())
    if scalars != "stress":
        return np.zeros((n, 1))
    # a gridpoint of a zoned block shows the mean of the zones around it
    stress = np.array(view.gridpoint_stress(), dtype=np.float64)
    if len(model.zones):
        zones = model.zones.ravel()
        count = np.bincount(zones, minlength=n)
        values = np.repeat(view.zone_stresses(), 4, axis=0)
        total = np.stack([np.bincount(zones, weights=values[:, k], minlength=n) for k in range(6)], axis=1)
        stress[count > 0] = total[count > 0] / count[count > 0, None]
    return stress


def _field_layer(
    scalars: str, component: str | None, limits: Any, cmap: str | None, sheet: Sheet
) -> tuple[list[Layer], Scale]:
    """Blocks coloured by a field."""
    if scalars == "stress":
        values, label, signed = _stress(sheet.values, component)
        unit = "Pa"
    else:
        unit = _VECTORS[scalars]
        signed = component is not None
        if component is None:
            values, label = np.linalg.norm(sheet.values, axis=1), scalars
        elif component in ("x", "y", "z"):
            values, label = sheet.values[:, "xyz".index(component)], f"{scalars} {component}"
        else:
            raise SceneError(f"plot: {scalars} has no component {component!r}; allowed: x, y, z")
    values, scale = _scaled(
        values, values[np.unique(sheet.triangles)], label, unit, signed, limits, cmap, _SEQUENTIAL[scalars]
    )
    return [Layer(sheet.points, sheet.triangles, values=values, limits=scale.limits, cmap=scale.cmap)], scale


def _stress(values: Array, component: str | None) -> tuple[Array, str, bool]:
    """Wanted measure of stresses (n, 6) [Pa], its label and whether it has a sign."""
    if component in _VOIGT:
        return values[:, _VOIGT[component]], f"stress {component}", True
    mean = values[:, :3].mean(axis=1)
    if component == "mean":
        return mean, "mean stress", True
    if component in ("major", "minor"):
        full = np.nan_to_num(values)[:, [0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(-1, 3, 3)
        principal = np.linalg.eigvalsh(full)[:, 2 if component == "major" else 0]
        return np.where(np.isnan(mean), np.nan, principal), f"{component} principal stress", True
    if component not in (None, "mises"):
        raise SceneError(f"plot: stress has no component {component!r}; allowed: xx ... xy, mean, major, minor, mises")
    deviator = values[:, :3] - mean[:, None]
    squares = 1.5 * (deviator**2).sum(axis=1) + 3.0 * (values[:, 3:] ** 2).sum(axis=1)
    return np.sqrt(squares), "von Mises stress", False


def _scaled(
    values: Array, seen: Array, label: str, unit: str, signed: bool, limits: Any, cmap: str | None, sequential: str
) -> tuple[Array, Scale]:
    """Values in a readable unit and the scale for them; `seen` are those the limits are chosen by."""
    finite = seen[np.isfinite(seen)]
    high, low = (max(0.0, float(side.max(initial=0.0))) for side in (finite, -finite))
    mixed = signed and min(low, high) > 0.05 * max(low, high)
    if limits is None:
        low, high, extend = limits_of(seen, symmetric=mixed)
    else:
        low, high, extend = float(limits[0]), float(limits[1]), "neither"
        if not high > low:
            raise SceneError(f"plot: limits must rise, got {limits!r}")
    factor, shown_unit = readable(unit, max(abs(low), abs(high)))
    name = cmap or ("RdBu_r" if mixed else sequential)
    return factor * values, Scale(f"{label} [{shown_unit}]", (factor * low, factor * high), name, extend)


def _named_layer(picture: Picture, scalars: str, sheet: Sheet) -> tuple[list[Layer], Scale | None]:
    """Blocks coloured by number, group or joint set."""
    model = picture.model
    if scalars == "block":
        # a stride that visits all colours keeps neighbours, which have near numbers, apart
        colors = [STONES[(3 * b + b // len(STONES)) % len(STONES)] for b in range(len(model.names))]
        return [Layer(sheet.points, sheet.triangles, index=sheet.block, colors=colors)], None
    if scalars == "group":
        group, names = group_ids(model)
        index = group[sheet.block]
    else:
        index, names = sheet.tag, [str(tag) for tag in model.tags]
    traces = None
    if scalars == "joint":
        points, lines, tag = picture.outlines()
        traces = (points, lines[tag >= 0], tag[tag >= 0])
    seen = np.unique(index if traces is None else np.concatenate([index, traces[2]]))
    names = [name or "no group" for name in names]
    rank = {int(k): i for i, k in enumerate(k for k in seen if k >= 0)}
    colors = [PALETTE[rank.get(k, 0) % len(PALETTE)] for k in range(len(names))]
    entries = [(names[k], colors[k]) for k in rank]
    if (seen < 0).any():
        entries.append(("other faces", NEUTRAL))
    layers = [Layer(sheet.points, sheet.triangles, index=index, colors=colors)]
    if traces is not None and len(traces[1]):
        # where joints meet a face that is none of them, their traces say which they are
        layers.append(Layer(traces[0], traces[1], index=traces[2], colors=colors, width=8.0))
    return layers, Scale("joint set" if scalars == "joint" else "group", entries=tuple(entries))


def _joint_layers(
    picture: Picture, view: Any, scalars: str, component: str | None, limits: Any, cmap: str | None, sheet: Sheet
) -> tuple[list[Layer], Scale]:
    """Joints painted on the faces they act on, or on their traces in the cut."""
    table = view.contact_table()
    values, label = np.asarray(table[scalars], dtype=np.float64), scalars
    signed = scalars == "gap"
    if scalars == "traction":
        if component not in (None, "normal", "shear"):
            raise SceneError(f"plot: traction has no component {component!r}; allowed: normal, shear")
        shear = component == "shear"
        values = np.hypot(values[:, 1], values[:, 2]) if shear else values[:, 0]
        label, signed = ("shear traction", False) if shear else ("normal traction", True)
    elif component is not None:
        raise SceneError(f"plot: {scalars} has no components, got {component!r}")
    values, scale = _scaled(values, values, label, _CONTACTS[scalars], signed, limits, cmap, "plasma_r")
    painter = _traces if picture.clip is not None else _patches
    patches = np.flatnonzero(table["patch"] >= 0)
    columns = ("area", "position", "normal", "block_a", "block_b")
    points, cells, contact = painter(picture, {name: np.asarray(table[name])[patches] for name in columns})
    shown = values[patches[contact]]
    assert scale.limits is not None
    # the small would hide the large behind it
    least = 0.05 * max(abs(scale.limits[0]), abs(scale.limits[1])) if scalars != "traction" else 0.0
    if picture.clip is None and len(shown):
        least = max(least, float(np.quantile(np.abs(shown), 0.75)))
    large = np.abs(shown) >= least
    cells, shown = cells[large], shown[large]
    if least > 0.0:
        unit = scale.title[scale.title.index("[") + 1 : -1]
        picture.note = f", joints from {least:.2g} {unit} on shown"
    opacity = 1.0 if picture.clip is not None else 0.05
    layers = [Layer(sheet.points, sheet.triangles, color="#dedcd6", opacity=opacity)]
    if len(cells) and picture.clip is not None:
        points, cells, shown = _ribbons(picture, points, cells, shown)
    if len(cells):
        lit = picture.clip is None
        layers.append(Layer(points, cells, values=shown, limits=scale.limits, cmap=scale.cmap, lit=lit))
    points, cells, contact = _chains(picture, table)
    if len(cells):
        layers.append(Layer(points, cells, values=values[contact], limits=scale.limits, cmap=scale.cmap, width=4.0))
    return layers, scale


def _patches(picture: Picture, table: Any) -> tuple[Array, Ints, Ints]:
    """Pieces of faces that carry a contact: points, triangles, contact of each; one of the two sides."""
    # contacts are where blocks are, faces are drawn where `warp` puts them: both places side by side
    places = np.hstack([picture.positions, picture.points])
    lower = np.isin(picture.block, table["block_a"])
    lower[picture.n_faces :] = False
    triangles, block = picture.triangles[lower], picture.block[lower]
    outward = surfaces.normals(picture.positions, triangles)
    size = 0.8 * float(np.sqrt(np.median(table["area"]))) if len(table["area"]) else 0.0
    extent = float(np.ptp(picture.points[picture.used], axis=0).max())
    places, pieces, parent = surfaces.refine(places, triangles, max(size, 0.005 * extent))
    reference = places[pieces, :3].mean(axis=1)
    contact = surfaces.paint(table, reference, outward[parent], block[parent])
    good = contact >= 0
    good[good] = np.asarray(table["block_a"])[contact[good]] == block[parent][good]
    return np.ascontiguousarray(places[:, 3:]), pieces[good], contact[good]


def _chains(picture: Picture, table: Any) -> tuple[Array, Ints, Ints]:
    """Contacts of spheres as lines from the contact into the spheres: points, lines, contact of each."""
    balls = np.zeros(len(picture.shown), dtype=bool)
    balls[picture.model.gp_block[picture.model.balls]] = True
    position, a, b = (np.asarray(table[name]) for name in ("position", "block_a", "block_b"))
    # contacts have no displacement that could be drawn larger
    seen = (table["patch"] < 0) & picture.shown[a] & picture.shown[b] & (picture.factor == 1.0)
    if picture.clip is not None:
        seen &= (position - picture.clip[1]) @ picture.clip[0] <= 0.0
    contact = np.flatnonzero(seen).astype(np.int32)
    arm: Array = np.sqrt(table["area"][contact] / np.pi)[:, None] * table["normal"][contact]
    ends = [position[contact] - balls[a[contact], None] * arm, position[contact] + balls[b[contact], None] * arm]
    lines = np.arange(2 * len(contact), dtype=np.int32).reshape(-1, 2)
    return np.concatenate(ends, axis=1).reshape(-1, 3), lines, contact


def _traces(picture: Picture, table: Any) -> tuple[Array, Ints, Ints]:
    """Traces of joints in the cut: points, lines, contact of each."""
    normal, origin = picture.clip
    cut = surfaces.section(picture.points, picture.triangles, normal, origin)
    places = cut.interpolate(np.hstack([picture.positions, picture.points]))
    outward = surfaces.normals(picture.positions, picture.triangles)[cut.triangle]
    block = picture.block[cut.triangle]
    a, b = places[cut.segments[:, 0]], places[cut.segments[:, 1]]
    # pieces of about a contact's size, so that each shows its own
    size = float(np.sqrt(np.median(table["area"]))) if len(table["area"]) else np.inf
    extent = float(np.ptp(picture.points[picture.used], axis=0).max())
    length = np.linalg.norm((b - a)[:, :3], axis=1)
    n = np.maximum(1, np.ceil(length / max(0.5 * size, 0.002 * extent))).astype(int)
    which = np.repeat(np.arange(len(n)), n)
    place = (np.arange(len(which)) - np.repeat(np.cumsum(n) - n, n))[:, None]
    start = a[which] + place / n[which, None] * (b - a)[which]
    end = a[which] + (place + 1) / n[which, None] * (b - a)[which]
    contact = surfaces.paint(table, 0.5 * (start + end)[:, :3], outward[which], block[which])
    good = contact >= 0
    lines = np.arange(2 * int(good.sum()), dtype=np.int32).reshape(-1, 2)
    return np.stack([start[good, 3:], end[good, 3:]], axis=1).reshape(-1, 3), lines, contact[good]


def _ribbons(picture: Picture, points: Array, lines: Ints, values: Array) -> tuple[Array, Ints, Array]:
    """Lines of the cut as bands of triangles that lie on it, the larger values above the smaller."""
    normal = picture.clip[0]
    extent = float(np.ptp(picture.points[picture.used], axis=0).max())
    half = 0.0028 * extent
    a, b = points[lines[:, 0]], points[lines[:, 1]]
    along = b - a
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    across = half * np.cross(normal, along)
    rank = np.argsort(np.argsort(np.abs(values), kind="stable"), kind="stable") / max(1, len(values))
    lift = (1e-3 * extent * (1.0 + rank))[:, None] * normal
    a, b = a + lift - 0.5 * half * along, b + lift + 0.5 * half * along
    corners = np.stack([a - across, b - across, b + across, a + across], axis=1).reshape(-1, 3)
    first = 4 * np.arange(len(lines), dtype=np.int32)[:, None]
    cells = np.concatenate([first + np.array([[0, 1, 2]]), first + np.array([[0, 2, 3]])]).astype(np.int32)
    return corners, cells, np.tile(values, 2)
