"""Drawing: layers of triangles and lines into an image (pyvista), image and key into a file (matplotlib)."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdem._jit import held_off
from fdem.errors import UnsupportedError
from fdem.results.scales import NEUTRAL, PALETTE, readable

__all__ = ["Layer", "compose", "curves", "render"]

Array = NDArray[np.float64]
Ints = NDArray[np.int32]

_ANGLE = 18.0  # of the lens [degrees]: little distortion, some depth
_INK = "#22262a"

# directions in the frame of the eye (right, up, to the eye) and strengths: colours of faces seen at an
# angle of up to 45 degrees come out nearly as those of the scale, and a flat picture shows them as they are
_LIGHTS = (((-0.2, 1.0, 0.6), 0.3), ((0.9, 0.1, 0.7), 0.12), ((0.0, 0.0, 1.0), 0.38))
_FLAT_LIGHTS = (((0.0, 0.0, 1.0), 0.47),)


@dataclass(frozen=True)
class Layer:
    """Triangles (m, 3) or lines (m, 2) on points (n, 3), in one colour, by `values` or by `index`.

    Parameters
    ----------
    points, cells : arrays
        Geometry.
    values : (n,) or (m,) array, optional
        Numbers at points or cells, coloured by `cmap` between `limits`.
    index : (m,) int array, optional
        Number of the colour in `colors` of each cell; -1 is neutral.
    color : str, optional
        One colour for all.
    width : float, optional
        Of lines [pixels].
    lit : bool, optional
        Shade faces by their direction.
    """

    points: Array
    cells: Ints
    values: Array | None = None
    limits: tuple[float, float] | None = None
    cmap: str = "viridis"
    index: Ints | None = None
    colors: Sequence[str] = ()
    color: str = NEUTRAL
    opacity: float = 1.0
    width: float = 1.5
    lit: bool = True


@contextmanager
def _window_class() -> Iterator[None]:
    """Make VTK open its windows without a display, where there is none, as long as this lasts."""
    key = "VTK_DEFAULT_OPENGL_WINDOW"
    silent = sys.platform == "linux" and not os.environ.get("DISPLAY") and key not in os.environ
    if silent:
        os.environ[key] = "vtkEGLRenderWindow"
    try:
        yield
    finally:
        if silent:
            del os.environ[key]


def _can_render() -> bool:
    """Whether VTK finds a way to render; it falls back from EGL to OSMesa itself, but not on to an error."""
    import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (registers the kinds of windows)
    from vtkmodules.vtkRenderingCore import vtkRenderWindow

    name = vtkRenderWindow().GetClassName()
    if name != "vtkOSOpenGLRenderWindow":
        return True
    # rendering without the library ends the process, and SupportsOpenGL does not tell
    for library in ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return True
    return False


def render(
    layers: Sequence[Layer], direction: Array, *, parallel: bool, window_size: tuple[int, int] | None
) -> NDArray[np.uint8]:
    """Image (height, width, 3) of layers seen from a direction.

    Raises
    ------
    UnsupportedError
        If no way to render works on this machine.
    """
    try:
        with held_off():
            from pyvista import Plotter
    except ImportError:
        raise UnsupportedError("plot needs pyvista: pip install 'fdem[plot]'") from None
    size = _fit_window(layers, direction, window_size)
    with _window_class():
        if not _can_render():
            raise UnsupportedError(
                "plot: this machine cannot render (no OpenGL by display, EGL or OSMesa); "
                "on Debian: apt install libegl1 libgl1-mesa-dri, or libosmesa6"
            )
        plotter = Plotter(off_screen=True, window_size=list(size), lighting="none")
        try:
            return _draw(plotter, layers, direction, parallel, size)
        finally:
            plotter.close()


def _draw(
    plotter: Any, layers: Sequence[Layer], direction: Array, parallel: bool, size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Fill the plotter and take the picture."""
    import pyvista as pv

    plotter.set_background("white")
    for place, strength in _FLAT_LIGHTS if parallel else _LIGHTS:
        plotter.add_light(pv.Light(position=place, intensity=strength, light_type="camera light"))
    for layer in layers:
        _add(plotter, layer)
    _aim(
        plotter.camera,
        np.concatenate([layer.points[np.unique(layer.cells)] for layer in layers if len(layer.cells)]),
        direction,
        parallel,
        size[0] / size[1],
    )
    plotter.renderer.ResetCameraClippingRange()
    plotter.enable_anti_aliasing("ssaa")
    image = plotter.screenshot(None, return_img=True)
    return np.asarray(image)[:, :, :3]


def _add(plotter: Any, layer: Layer) -> None:
    """Add one layer."""
    import pyvista as pv

    if not len(layer.cells):
        return
    lines = layer.cells.shape[1] == 2
    used, local = np.unique(layer.cells, return_inverse=True)
    points, local = layer.points[used], local.reshape(layer.cells.shape)
    if lines:
        prefixed = np.column_stack([np.full(len(local), 2), local])
        data = pv.PolyData(points, lines=prefixed)
        options: dict[str, Any] = {"line_width": layer.width, "lighting": False}
    else:
        data = pv.PolyData.from_regular_faces(points, local)
        options = {"ambient": 0.56, "diffuse": 0.9, "specular": 0.0, "smooth_shading": False, "lighting": True}
    if not lines and not layer.lit:
        options |= {"ambient": 0.0, "diffuse": 1.0, "lighting": False}
    options |= {"opacity": layer.opacity, "show_scalar_bar": False, "copy_mesh": False}
    if layer.values is not None:
        at_points = len(layer.values) == len(layer.points) != len(layer.cells)
        where = data.point_data if at_points else data.cell_data
        where["values"] = layer.values[used] if at_points else layer.values
        options |= {
            "scalars": "values",
            "cmap": layer.cmap,
            "clim": layer.limits,
            "nan_color": NEUTRAL,
            "interpolate_before_map": True,
        }
    elif layer.index is not None:
        rgb = np.array([_rgb(color) for color in (*layer.colors, NEUTRAL)], dtype=np.uint8)
        data.cell_data["colors"] = rgb[layer.index]
        options |= {"scalars": "colors", "rgb": True}
    else:
        options["color"] = layer.color
    actor = plotter.add_mesh(data, **options)
    mapper = actor.GetMapper()
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    # faces step back a little, so that lines on them are not swallowed
    mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(*((-1.0, -1.0) if lines else (1.0, 1.0)))
    if lines:
        mapper.SetRelativeCoincidentTopologyLineOffsetParameters(-1.0, -2.0)


def _rgb(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def _axes(direction: Array) -> tuple[Array, Array]:
    """Right and up of the picture; up is z, or y seen along z."""
    up = np.array([0.0, 1.0, 0.0]) if abs(direction[2]) > 0.99 else np.array([0.0, 0.0, 1.0])
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    return right, np.cross(direction, right)


def _extent(points: Array, direction: Array) -> tuple[Array, Array]:
    """Coordinates (n, 3) to the right, up and to the eye about the centre, and the centre."""
    frame = np.stack([*_axes(direction), direction])
    seen = points @ frame.T
    centre = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    return seen - centre, frame.T @ centre


def _fit_window(layers: Sequence[Layer], direction: Array, window_size: tuple[int, int] | None) -> tuple[int, int]:
    """Width and height of the rendered part of the image in pixels."""
    if window_size is not None:
        return round(window_size[0] * 0.84), round(window_size[1] * 0.92)
    points = np.concatenate([layer.points[np.unique(layer.cells)] for layer in layers if len(layer.cells)])
    width, height, _ = np.ptp(_extent(points, direction)[0], axis=0)
    ratio = min(3.2, max(0.5, width / height)) if height > 0.0 else 3.2
    return (1500, round(1500 / ratio)) if ratio > 1.15 else (round(1300 * ratio), 1300)


def _aim(camera: Any, points: Array, direction: Array, parallel: bool, ratio: float) -> None:
    """Place the camera so that all points just fit."""
    seen, centre = _extent(points, direction)
    margin = 1.03
    half = np.maximum(np.abs(seen[:, 1]), np.abs(seen[:, 0]) / ratio) * margin
    # a point fits if its height is less than the opening at its distance
    tangent = np.tan(np.radians(0.5 * _ANGLE))
    distance = float((seen[:, 2] + half / tangent).max())
    camera.view_angle = _ANGLE
    camera.focal_point = centre
    camera.position = centre + distance * direction
    camera.up = _axes(direction)[1]
    camera.parallel_projection = parallel
    camera.parallel_scale = float(half.max())


# ---------------------------------------------------------------------------------------------------------------------
# paper


def compose(
    image: NDArray[np.uint8],
    path: Path,
    scale: Any,
    *,
    direction: Array,
    caption: str,
    title: str | None,
    window_size: tuple[int, int] | None,
) -> None:
    """Set an image beside its key and write it."""
    with held_off():
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize
        from matplotlib.figure import Figure
        from matplotlib.patches import Patch

    if window_size is None:
        image = _trimmed(image)
    height, width = image.shape[:2]
    key, head, foot = 0 if scale is None else 250, 70 if title else 20, 60
    if window_size is not None:
        key, foot = window_size[0] - width, window_size[1] - height - head
    page = (width + key, height + head + foot)
    dpi = 160
    figure = Figure(figsize=(page[0] / dpi, page[1] / dpi), dpi=dpi, facecolor="white")
    axes = figure.add_axes((0.0, foot / page[1], width / page[0], height / page[1]))
    axes.imshow(image, interpolation="none", aspect="auto")
    axes.set_axis_off()
    if scale is not None and scale.limits is not None:
        tall = min(0.62 * height, 700.0)
        box = ((width + 30) / page[0], (foot + 0.5 * (height - tall)) / page[1], 30 / page[0], tall / page[1])
        mappable = ScalarMappable(Normalize(*scale.limits), scale.cmap)
        bar = figure.colorbar(mappable, cax=figure.add_axes(box), extend=scale.extend)
        bar.ax.tick_params(labelsize=10, length=3, colors=_INK)
        bar.outline.set_linewidth(0.5)
        bar.set_label(scale.title, size=11, color=_INK, labelpad=8)
    elif scale is not None:
        handles = [Patch(facecolor=color, edgecolor=_INK, linewidth=0.5, label=name) for name, color in scale.entries]
        anchor = ((width + 10) / page[0], (foot + 0.5 * height) / page[1])
        figure.legend(
            handles=handles,
            title=scale.title,
            loc="center left",
            bbox_to_anchor=anchor,
            frameon=False,
            fontsize=10,
            title_fontsize=11,
            alignment="left",
            borderaxespad=0.0,
        )
    _triad(figure, direction, page)
    figure.text(20 / page[0], 0.4 * foot / page[1], caption, size=8.5, color="#666b70", va="center")
    if title:
        figure.text(20 / page[0], 1.0 - 0.5 * head / page[1], title, size=14, color=_INK, va="center")
    figure.savefig(path, dpi=dpi)


def _triad(figure: Any, direction: Array, page: tuple[int, int]) -> None:
    """Draw the directions of x, y, z in the lower right corner."""
    side = 120
    corner = figure.add_axes((1.0 - (side + 10) / page[0], 10 / page[1], side / page[0], side / page[1]))
    corner.set_axis_off()
    corner.set_xlim(-1.5, 1.5)
    corner.set_ylim(-1.5, 1.5)
    ends = np.stack(_axes(direction), axis=1)  # (3, 2): unit vectors as they are seen
    for name, end, color in zip("xyz", ends, ("#b5574f", "#5a9e6f", "#4c78a8"), strict=True):
        if np.hypot(*end) < 0.05:
            continue
        arrow = {
            "arrowstyle": "-|>,head_width=0.15,head_length=0.3",
            "color": color,
            "lw": 1.3,
            "shrinkA": 0,
            "shrinkB": 0,
        }
        corner.annotate("", xy=end, xytext=(0.0, 0.0), arrowprops=arrow)
        label = end * (1.0 + 0.3 / np.hypot(*end))
        corner.text(*label, name, size=8, color=color, ha="center", va="center")


def _trimmed(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Image without the empty margin."""
    ink = np.any(image < 250, axis=2)
    rows, columns = np.flatnonzero(np.any(ink, axis=1)), np.flatnonzero(np.any(ink, axis=0))
    if not len(rows):
        return image
    pad = 12
    return image[max(0, rows[0] - pad) : rows[-1] + pad, max(0, columns[0] - pad) : columns[-1] + pad]


def curves(panels: dict[str, list[tuple[str, Array, Array]]], path: Path, across: str, title: str | None) -> None:
    """Panels of curves (label, abscissa, values), one panel for each unit."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 1.2 + 2.6 * len(panels)), dpi=160, layout="constrained")
    stack = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (unit, items) in zip(stack, panels.items(), strict=True):
        largest = max((float(np.nanmax(np.abs(y))) for _, _, y in items if len(y)), default=0.0)
        factor, shown = readable(unit, largest)
        for k, (label, x, y) in enumerate(items):
            axes.plot(x, factor * y, color=PALETTE[k % len(PALETTE)], linewidth=1.4, label=label or None)
        names = [label for label, _, _ in items if label]
        single = len(items) == 1 and names
        axes.set_ylabel(f"{names[0] if single else 'value'} [{shown}]")
        if names and not single:
            axes.legend(frameon=False, fontsize=9)
        values = np.concatenate([y for _, _, y in items])
        if unit == "-" and len(values) and values.min() > 0.0 and values.max() > 1e3 * values.min():
            axes.set_yscale("log")
        axes.grid(color="#e3e5e7", linewidth=0.7)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.01)
    stack[-1].set_xlabel(across)
    if title:
        figure.suptitle(title, size=13)
    figure.savefig(path)
