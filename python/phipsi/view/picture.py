"""Pictures of a robot as PNG or WebP, drawn with NumPy: a z-buffer, smooth shading, and a shadow on the ground. No
browser and no graphics processor are needed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image, ImageFilter
from rich.console import Console
from rich.progress import track

from .._core import Scene
from .._forces import Forces
from .arrows import COLOR, HEAD, LEAST, LENGTH, SHAFT, TIP, usual_force
from .shapes import AXES, FIELD, Shape, extent, poses, robot_size, travel

_Array = NDArray[np.float64]

#: Width and height of a picture and of an animation, px, and number of samples per pixel along each.
SIZE, MOVING, SAMPLES = (800, 600), (600, 450), 2
#: Frames per second of an animation, and their largest number.
RATE, MOST = 20.0, 240
#: Faces that meet at a smaller angle are shaded as one smooth surface: its cosine.
SMOOTH = np.cos(np.radians(40.0))
#: Candidate samples that are tested at once, and the largest extent of triangles that are tested together, samples.
CHUNK, LARGE = 1_000_000, 32
#: Gray of the background at the top and at the bottom, from 0 to 1.
SKY, FLOOR = 1.0, 0.93
#: Part of the light that a shadow removes, and its blur, px.
SHADOW, BLUR = 0.22, 5.0
#: Tiles of a ground over which the camera moves: edge relative to the size of the robot, part of the light that the dark ones remove, and the
#: distance at which they fade, relative to that of the camera.
TILE, DARK, FADE = 0.5, 0.07, 2.5


class _Surface(NamedTuple):
    """Triangles of a shape in the link frame."""

    corners: _Array
    """(n, 3, 3), m."""
    normals: _Array
    """Unit normals at the corners, (n, 3, 3)."""
    colors: _Array
    """(n, 3), from 0 to 1."""


class _Camera(NamedTuple):
    """Perspective camera."""

    eye: _Array
    size: tuple[int, int]
    """Width and height of the picture, px."""

    def seen(self, points: _Array) -> _Array:
        """Sample coordinates x, y and inverse depth, (..., 3) to (..., 3)."""
        local = (points - self.eye) @ AXES.T
        inverse = 1.0 / np.maximum(-local[..., 2], 1e-9)
        width, height = self.size
        focal = 0.5 * SAMPLES * height / np.tan(FIELD / 2.0)
        x = 0.5 * SAMPLES * width + focal * local[..., 0] * inverse
        y = 0.5 * SAMPLES * height - focal * local[..., 1] * inverse
        return np.stack([x, y, inverse], axis=-1)

    def tiles(self, height: float, edge: float) -> _Array:
        """Weight of the dark tiles of the plane z = height at each sample, (h, w), from 0 to 1."""
        wide, high = SAMPLES * self.size[0], SAMPLES * self.size[1]
        focal = 0.5 * high / np.tan(FIELD / 2.0)
        x, y = (np.arange(wide) + 0.5 - 0.5 * wide) / focal, (0.5 * high - np.arange(high) - 0.5) / focal
        # Rays of all samples, with the component along the view equal to one.
        rays = x[None, :, None] * AXES[0] + y[:, None, None] * AXES[1] - AXES[2]
        depth = (height - self.eye[2]) / np.minimum(rays[..., 2], -1e-9)
        dark = np.floor((self.eye[:2] + depth[..., None] * rays[..., :2]) / edge).sum(axis=-1) % 2
        distance = (self.eye[2] - height) / AXES[2, 2]
        return np.asarray(dark * np.clip((FADE - depth / distance) / (FADE - 1.0), 0.0, 1.0))


def write(scene: Scene, motion: Any, shapes: Sequence[Shape], file: Path) -> None:
    """Write the first configuration of a motion as PNG, or the motion as WebP."""
    moves = file.suffix.lower() == ".webp" and motion.moves
    times, _ = motion.frames()
    rows = np.zeros(1, int)
    if moves:
        count = min(max(int((times[-1] - times[0]) * RATE), 1) + 1, MOST)
        rows = np.clip(np.searchsorted(times, np.linspace(times[0], times[-1], count)), 0, len(times) - 1)
    first, *rest = _shown(frames(scene, motion, shapes, rows, MOVING if moves else SIZE), len(rows), file)
    if moves:
        each = max(round(1000.0 * float(times[-1] - times[0]) / len(rows)), 1)
        first.save(file, save_all=True, append_images=rest, duration=each, loop=0, quality=75, method=4)
    else:
        first.save(file)


def _shown(pictures: Iterator[Image.Image], count: int, file: Path) -> Iterator[Image.Image]:
    """The pictures, with a bar of the progress on a terminal if there are several."""
    if count == 1 or not sys.stderr.isatty():
        return pictures
    return iter(track(pictures, f"drawing {file.name}", count, console=Console(stderr=True), transient=True))


def frames(scene: Scene, motion: Any, shapes: Sequence[Shape], rows: Iterable[int], size: tuple[int, int] = SIZE) -> Iterator[Image.Image]:
    """Pictures of these frames of a motion."""
    _, configurations = motion.frames()
    shift = travel(scene, configurations)
    follows = bool(shift.any())
    space = extent(scene, shapes, configurations, shift) if follows else extent(scene, shapes, motion.q)
    eye = space.camera(size[0] / size[1])
    surfaces = [(shape, _surface(shape.mesh)) for shape in shapes]
    forces, reach = motion.forces(), robot_size(scene)
    for row in rows:
        placements = poses(scene, configurations[row])
        moved = [_moved(surface, placements[shape.link] @ shape.place) for shape, surface in surfaces]
        moved += _arrows(forces, row, reach)
        tile = TILE * reach if follows else 0.0
        yield _drawn(_Camera(eye + shift[row], size), _Surface(*(np.concatenate(parts) for parts in zip(*moved, strict=True))), space.low, reach, tile)


def _surface(mesh: trimesh.Trimesh) -> _Surface:
    """Triangles of a mesh with normals that are smooth except at edges."""
    corners = np.asarray(mesh.triangles, float)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(across, axis=1, keepdims=True)
    corners, across = corners[lengths[:, 0] > 0.0], across[lengths[:, 0] > 0.0]
    flat = across / np.linalg.norm(across, axis=1, keepdims=True)
    # Corners at the same position, and the faces around each.
    scale = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) if len(corners) else 1.0
    _, vertex = np.unique(np.round(corners.reshape(-1, 3) / scale * 1e6).astype(np.int64), axis=0, return_inverse=True)
    order = np.argsort(vertex.ravel(), kind="stable")
    counts = np.bincount(vertex.ravel())
    start = np.repeat(np.cumsum(counts) - counts, counts)
    count, place = np.repeat(counts, counts), np.arange(len(order)) - start
    face = order // 3
    summed = across[face]
    for shift in range(1, int(counts.max(initial=1))):
        which = np.flatnonzero(count > shift)
        other = face[start[which] + (place[which] + shift) % count[which]]
        is_smooth = np.einsum("ij,ij->i", flat[face[which]], flat[other]) > SMOOTH
        summed[which[is_smooth]] += across[other[is_smooth]]
    normals = np.empty_like(summed)
    normals[order] = summed / np.linalg.norm(summed, axis=1, keepdims=True)
    return _Surface(corners, normals.reshape(-1, 3, 3), _colors(mesh)[lengths[:, 0] > 0.0])


def _colors(mesh: trimesh.Trimesh) -> _Array:
    """Color of each face, (n, 3), from 0 to 1."""
    visual = mesh.visual
    if visual.kind == "texture":
        image = getattr(visual.material, "image", None) or getattr(visual.material, "baseColorTexture", None)
        if image is None or visual.uv is None:
            return np.broadcast_to(np.asarray(visual.material.main_color[:3], float) / 255.0, (len(mesh.faces), 3))
        visual = visual.to_color()
        visual.mesh = mesh
    return np.asarray(visual.face_colors, float)[:, :3] / 255.0


def _moved(surface: _Surface, place: _Array) -> _Surface:
    turn = place[:3, :3].T
    return _Surface(surface.corners @ turn + place[:3, 3], surface.normals @ turn, surface.colors)


def _arrows(forces: Forces | None, row: int, size: float) -> list[_Surface]:
    """Arrows of the forces of a frame, to the scale of a page."""
    usual = usual_force(forces)
    if usual is None or forces is None:
        return []
    found = []
    for at, force in zip(forces.at[row], forces.force[row], strict=True):
        length = float(np.linalg.norm(force)) * LENGTH * size / usual
        if not length >= LEAST * size:
            continue
        tip = min(TIP * size, 0.5 * length)
        shaft = trimesh.creation.cylinder(radius=SHAFT * size, segment=np.array([[0, 0, 0], [0, 0, length - tip]]))
        head = trimesh.creation.cone(radius=HEAD * size, height=tip).apply_translation([0, 0, length - tip])
        place = np.array(trimesh.geometry.align_vectors([0, 0, 1], force), float)
        place[:3, 3] = at
        for part in (shaft, head):
            surface = _moved(_surface(part), place)
            found.append(surface._replace(colors=np.broadcast_to(np.array(COLOR) / 255.0, (len(surface.corners), 3))))
    return found


def _drawn(camera: _Camera, surface: _Surface, low: float, size: float, tile: float = 0.0) -> Image.Image:
    """Picture of all triangles over their shadow on the ground, which has tiles with this edge, m, if it is positive."""
    width, height = SAMPLES * camera.size[0], SAMPLES * camera.size[1]
    right, up, toward = AXES
    light = 0.5 * toward + 0.9 * np.array([0.0, 0.0, 1.0]) - 0.45 * right
    light /= np.linalg.norm(light)
    # Normals of both sides point to the viewer, because some files have faces that are inside out.
    view = camera.eye - surface.corners
    facing = np.einsum("nij,nij->ni", surface.normals, view)
    normals = surface.normals * np.where(facing < 0.0, -1.0, 1.0)[..., None]
    shade = 0.42 + 0.58 * np.clip(normals @ light, 0.0, 1.0) + 0.06 * (normals @ up)
    values = np.clip(shade[..., None] * surface.colors[:, None, :], 0.0, 1.0)
    back = np.linspace(SKY, FLOOR, height)[:, None, None] * np.ones((1, width, 3))
    if tile > 0.0:
        back *= 1.0 - DARK * camera.tiles(low, tile)[..., None]
    fallen = surface.corners - (surface.corners[..., 2:] - (low - 1e-3 * size)) / light[2] * light
    # Blurred anyway, so that one sample per pixel is enough.
    mask = _raster(camera.seen(fallen) / [SAMPLES, SAMPLES, 1.0], np.ones((len(fallen), 3, 1)), np.zeros((camera.size[1], camera.size[0], 1)))
    blurred = Image.fromarray((255.0 * mask[..., 0]).astype(np.uint8)).filter(ImageFilter.GaussianBlur(BLUR))
    back *= 1.0 - SHADOW * np.asarray(blurred.resize((width, height)), float)[..., None] / 255.0
    picture = _raster(camera.seen(surface.corners), values, back)
    return Image.fromarray((255.0 * picture + 0.5).astype(np.uint8)).resize(camera.size, Image.Resampling.BOX)


def _raster(corners: _Array, values: _Array, back: _Array) -> _Array:
    """Nearest triangle at each sample: values at the corners, (n, 3, m), interpolated, over the background, (h, w, m)."""
    height, width, parts = back.shape
    picture, depth = back.reshape(-1, parts).copy(), np.zeros(height * width)
    low, high = np.floor(corners[..., :2].min(axis=1)), np.ceil(corners[..., :2].max(axis=1))
    low, high = np.maximum(low, 0.0), np.minimum(high, [width, height])
    span = (high - low).max(axis=1)
    visible = np.all(high > low, axis=1) & (corners[..., 2].max(axis=1) < 1e8)
    canvas = _Canvas(picture, depth, width)
    # Small triangles of similar size are tested together, each over a square of samples; a large one over its rectangle.
    side = 1
    while side <= LARGE:
        which = np.flatnonzero(visible & (span <= side) & (span > side // 2))
        step = max(CHUNK // side**2, 1)
        for first in range(0, len(which), step):
            part = which[first : first + step]
            x, y = (low[part, axis, None] + np.arange(side) + 0.5 for axis in (0, 1))
            canvas.fill(corners[part], values[part], x, y, high[part])
        side *= 2
    for at in np.flatnonzero(visible & (span > LARGE)):
        x, y = (np.arange(low[at, axis], high[at, axis])[None] + 0.5 for axis in (0, 1))
        canvas.fill(corners[at, None], values[at, None], x, y, high[at, None])
    return picture.reshape(back.shape)


class _Canvas(NamedTuple):
    """Samples that are drawn in place."""

    picture: _Array
    """(h w, m)."""
    depth: _Array
    """Inverse depths, (h w,)."""
    width: int

    def fill(self, corners: _Array, values: _Array, x: _Array, y: _Array, high: _Array) -> None:
        """Draw triangles over samples at x, (n, w), and y, (n, h), that are below high, (n, 2)."""
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (corners[:, i].T[:, :, None, None] for i in range(3))
        across, down = x[:, None, :] - ax, y[:, :, None] - ay
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
            b = across * ((cy - ay) * scale) - down * ((cx - ax) * scale)
            c = down * ((bx - ax) * scale) - across * ((by - ay) * scale)
            # False for triangles without area.
            inside = (b >= 0.0) & (c >= 0.0) & (b + c <= 1.0) & (x < high[:, :1])[:, None, :] & (y < high[:, 1:])[:, :, None]
        n, i, j = np.nonzero(inside)
        b, c = b[n, i, j], c[n, i, j]
        near = (1.0 - b - c) * az[n, 0, 0] + b * bz[n, 0, 0] + c * cz[n, 0, 0]
        sample = y[n, i].astype(np.intp) * self.width + x[n, j].astype(np.intp)
        first = np.flatnonzero(near > self.depth[sample])
        if len(corners) > 1:
            # Of repeated indices the last one counts: the nearest.
            first = first[np.argsort(near[first], kind="stable")]
        sample, n, b, c = sample[first], n[first], b[first, None], c[first, None]
        self.depth[sample] = near[first]
        self.picture[sample] = (1.0 - b - c) * values[n, 0] + b * values[n, 1] + c * values[n, 2]
