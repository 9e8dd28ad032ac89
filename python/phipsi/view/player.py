"""The robot in a browser with viser: a pose with sliders, a motion with a play button, or a motion as a self-contained
page.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import io
import json
import os
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import viser
import viser.transforms
from numpy.typing import ArrayLike, NDArray

from .. import _core, _forces
from .._core import Scene
from .._forces import Forces
from .._motion import Trajectory
from ..errors import ArgumentError, ShapeError
from . import picture
from .arrows import Arrows, below
from .shapes import FIELD, FOLLOWED, Shape, extent, name_of, poses, robot_size, shapes_of, translucent, travel

_Array = NDArray[np.float64]

#: Frames per second of a recorded motion, and their largest number.
RATE, MOST = 30.0, 1800
#: Largest number of joints with sliders.
SLIDERS = 64
#: Range of the sliders of joints without limits, rad or m.
UNLIMITED = np.pi
#: Smallest step of a slider, rad or m, and number of steps for smaller ranges.
STEP, STEPS = 1e-3, 30
#: Address of the server, accessible only from this machine.
HOST = "127.0.0.1"
#: Addresses that stand for all addresses of this machine.
ANY = ("0.0.0.0", "")
#: Height of the robot below a cell of a notebook, px.
HEIGHT = 480
#: Number of ports that are tried if a port is in use.
PORTS = 100
#: File name extensions of pages and of pictures.
PAGES, PICTURES = (".html", ".htm"), (".png", ".webp")
#: Moves the camera of a page so far away that the robot fits in its window, before the viewer starts.
FIT = """<script>(() => {
  const found = CAMERAS.filter(([aspect]) => aspect <= innerWidth / innerHeight).pop(), get = URLSearchParams.prototype.get;
  if (found) URLSearchParams.prototype.get = function (name) { return name === "initialCameraPosition" ? found[1].join() : get.call(this, name); };
})()</script>"""
#: A page is dark if the browser is, as the report around it.
NIGHT = 'darkMode:matchMedia("(prefers-color-scheme: dark)").matches'
#: Color of the lines of the ground, visible on white and on black.
LINES = (140, 140, 140)
#: Ratios of width to height for which a page has a position of the camera, ascending.
ASPECTS = (0.1, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5)


class Motion:
    """Configurations, (k, nq), at times, (k,), s; a pose is a single configuration."""

    def __init__(self, scene: Scene, motion: Any, t: ArrayLike | None, forces: tuple[ArrayLike, ArrayLike] | None = None) -> None:
        self._path = motion if isinstance(motion, Trajectory) else None
        given = scene.initial() if motion is None else motion
        if isinstance(given, Trajectory):
            if t is not None:
                raise ArgumentError("t: found times in addition to a Trajectory; expected None, because a Trajectory has times")
            self.t, self.q, name = given.t, given.q, "motion"
        else:
            name = "q"
            self.q = np.array(_core._numbers(name, given, scene, True))
            if t is None and self.q.ndim == 2:
                raise ArgumentError(f"t: found None for {len(self.q)} configurations; expected their times, (k,), s")
            self.t = np.zeros(1) if t is None else np.array(_core._numbers("t", t))
            if self.q.ndim == 1:
                self.q = self.q[None]
        if self.q.ndim != 2 or self.q.shape[1] != scene.nq:
            raise ShapeError(f"{name}: found shape {self.q.shape}; expected ({scene.nq},) or (k, {scene.nq}), a motion of one state")
        if scene.link_names:
            # Raises for values that are not finite, with the index of the state.
            scene.placement(self.q, scene.link_names[-1])
        if self.t.shape != (len(self.q),) or not np.isfinite(self.t).all() or np.any(np.diff(self.t) < 0.0):
            raise ArgumentError(f"t: found shape {self.t.shape}; expected ({len(self.q)},), finite times in ascending order")
        self._given = None if forces is None else _forces.given(*forces, len(self.q))

    @property
    def moves(self) -> bool:
        """Whether there is more than one pose."""
        return len(self.q) > 1 and float(self.t[-1]) > float(self.t[0])

    def frames(self) -> tuple[_Array, _Array]:
        """Equidistant times, s, and the configurations of the nearest rows, at the frame rate."""
        times, rows = self._frames()
        return times, self.q[rows]

    def forces(self) -> Forces | None:
        """Forces at the times of frames(), if there are any."""
        rows = self._frames()[1]
        if self._given is not None:
            return self._given._replace(at=self._given.at[rows], force=self._given.force[rows])
        return None if self._path is None else _forces.of_motion(self._path, rows)

    def _frames(self) -> tuple[_Array, NDArray[np.int_]]:
        """Times, s, and the nearest rows."""
        if not self.moves:
            return self.t[:1], np.zeros(1, int)
        length = float(self.t[-1] - self.t[0])
        even = np.linspace(self.t[0], self.t[-1], min(max(int(length * RATE), 1) + 1, MOST))
        rows = np.clip(np.searchsorted(self.t, even), 0, len(self.t) - 1)
        before = np.maximum(rows - 1, 0)
        rows = np.where(even - self.t[before] < self.t[rows] - even, before, rows)
        return even, rows


class _Stage:
    """A robot on a viser server: one frame per link with its meshes, the ground, the center of mass, force arrows."""

    def __init__(self, scene: Scene, shapes: Sequence[Shape], port: int, motion: Motion, host: str = HOST) -> None:
        self.scene, self.size, rows = scene, robot_size(scene), motion.frames()[1]
        # The way of the camera, for the rows of the motion.
        self.way = travel(scene, rows)
        self.extent = extent(scene, shapes, rows, self.way) if self.way.any() else extent(scene, shapes, motion.q)
        size, low, middle = self.size, self.extent.low, self.extent.middle
        # Suppresses the printed address, which is returned to the caller.
        with _quiet():
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        drawn = dict.fromkeys(shape.link for shape in shapes)
        # The parents of links and of arrows, which move instead of the camera, so that a visitor can rotate it.
        self.parents = [self.server.scene.add_frame(name, show_axes=False) for name in ("/robot", "/forces")]
        self.arrows = Arrows.of(self.server, motion.forces(), size, middle, low)
        self.links = {link: self.server.scene.add_frame(f"/robot/{i}", show_axes=False) for i, link in enumerate(drawn)}
        index = {link: i for i, link in enumerate(drawn)}
        for i, shape in enumerate(shapes):
            mesh = shape.mesh if self.arrows is None else translucent(shape.mesh)
            place = viser.transforms.SE3.from_matrix(shape.place)
            self.server.scene.add_mesh_trimesh(
                f"/robot/{index[shape.link]}/{i}", mesh, wxyz=place.rotation().wxyz, position=place.translation()
            )
        self.center = self.server.scene.add_icosphere("/center_of_mass", radius=0.02 * size, color=(220, 60, 40), visible=False)
        wide = 6 * size + 2 * float(np.abs(self.way).max(initial=0.0))
        self.tile, self.beneath, self.shift = below(size), np.array((*middle[:2], low)), np.zeros(3)
        self.ground = self.server.scene.add_grid("/ground", width=wide, height=wide, cell_size=below(size / 5), section_size=self.tile, cell_color=LINES, cell_thickness=0.5, section_color=LINES, position=tuple(self.beneath))
        camera = self.server.initial_camera
        camera.fov = float(FIELD)
        camera.position = tuple(self.extent.camera(ASPECTS[-1]))
        camera.look_at = tuple(middle)
        self.server.on_client_connect(self._fit)
        self.start = self._middle_of(rows[0])
        self.update(rows[0], np.zeros(3))

    def _fit(self, client: viser.ClientHandle) -> None:
        """Move the camera of a narrow window away."""
        if client.camera.aspect < ASPECTS[-1]:
            client.camera.position = tuple(self.extent.camera(client.camera.aspect))
            client.camera.look_at = tuple(self.extent.middle)

    def update(self, q: _Array, shift: _Array | None = None) -> None:
        """Move all links and the center of mass to the configuration q, (nq,), and the world by -shift, (3,), m; None: no farther than the robot needs to stay near the middle."""
        placements, center = poses(self.scene, q), self._middle_of(q)
        if shift is None:
            apart = (center - self.start - self.shift) * [1.0, 1.0, 0.0]
            shift = self.shift + apart * max(0.0, 1.0 - FOLLOWED * self.size / max(float(np.linalg.norm(apart)), 1e-300))
        with self.server.atomic():
            for link, frame in self.links.items():
                self._move(frame, placements[link])
            if not np.array_equal(shift, self.shift):
                self.follow(shift)
            if self.center.visible:
                self.center.position = tuple(center - shift)

    def follow(self, shift: _Array) -> None:
        """Move the world by -shift, (3,), m; the ground by less than one of its tiles."""
        self.shift = np.array(shift)
        for part in self.parents:
            part.position = tuple(-shift)
        self.ground.position = tuple(self.beneath - np.fmod(shift, self.tile))

    def _middle_of(self, q: _Array) -> _Array:
        """Center of mass, (3,), m; zero without masses."""
        return self.scene.center_of_mass(q) if self.scene.total_mass > 0.0 else np.zeros(3)

    @staticmethod
    def _move(frame: Any, place: _Array) -> None:
        frame.position = tuple(place[:3, 3])
        frame.wxyz = tuple(viser.transforms.SO3.from_matrix(place[:3, :3]).wxyz)

    def html(self, motion: Motion, title: str) -> str:
        """The motion as one page that needs no server."""
        times, rows = motion.frames()
        placements = poses(self.scene, rows)
        line = None
        if len(rows) > 1 and self.scene.total_mass > 0.0:
            self.center.visible, centers = True, self.scene.center_of_mass(rows)
            line = self.server.scene.add_line_segments(
                "/path", np.stack([centers[:-1], centers[1:]], axis=1), colors=(220, 60, 40), thickness=2.0, thickness_units="screen"
            )
        serializer = self.server.get_scene_serializer()
        for i in range(len(rows)):
            for link, frame in self.links.items():
                # A link at rest is written only once.
                if i == 0 or not np.array_equal(placements[link][i], placements[link][i - 1]):
                    self._move(frame, placements[link][i])
            if self.center.visible:
                self.center.position = tuple(centers[i] - self.way[i])
            if self.way.any():
                self.follow(self.way[i])
                if line is not None:
                    line.position = tuple(-self.way[i])
            if self.arrows is not None:
                self.arrows.show(i)
            serializer.insert_sleep(float(times[i + 1] - times[i]) if i + 1 < len(times) else 0.0)
        script = FIT.replace("CAMERAS", json.dumps([(aspect, list(self.extent.camera(aspect))) for aspect in ASPECTS]))
        page = str(serializer.as_html()).replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1).replace("darkMode:false", NIGHT, 1)
        return page.replace("<head>", f"<head>{script}", 1)

    def close(self) -> None:
        with _quiet():
            self.server.stop()


class Viewer:
    """A robot in a browser until close() is called; returned by Scene.show. It is also a context manager.

    A notebook displays it below the cell, as a page that stays in the saved notebook.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> with scene.show(browser=False) as viewer:  # doctest: +SKIP
    ...     viewer.update([0.3] * 6)
    """

    url: str
    """Address of the viewer: of a page that needs no server in a script, otherwise of the server."""

    def __init__(
        self, scene: Scene, motion: Motion, shapes: Sequence[Shape], port: int, title: str | None, host: str = HOST, page: bool = False
    ) -> None:
        self._scene, self._shapes, self._title = scene, shapes, title or name_of(scene)
        self._motion, self._q = motion, motion.q[0].copy()
        self._at, self._served, self._closed = (port, host), False, threading.Event()
        if page:
            file = Path(tempfile.mkdtemp(prefix="phipsi-")) / "motion.html"
            file.write_text(_html(scene, self._shapes, motion, self._title), encoding="utf-8")
            self.url = file.as_uri()
        else:
            self._serve()

    def _serve(self) -> None:
        """Start the server."""
        port, host = self._at
        self._stage = _Stage(self._scene, self._shapes, port, self._motion, host)
        self._served = True
        self.url = f"http://{HOST if host in ANY else host}:{self._stage.server.get_port()}"
        self._stage.server.gui.set_panel_label(self._title)
        if self._scene.total_mass > 0.0:
            self._add_center_of_mass()
        if self._motion.moves:
            self._add_player()
        else:
            self._add_sliders()

    def _serve_script(self) -> None:
        """Replace the page of a script by a server, which moves the robot and has sliders."""
        if not self._served and not self._closed.is_set():
            self._serve()
            _open(self)

    def update(self, q: ArrayLike) -> None:
        """Show the robot at a configuration.

        Parameters
        ----------
        q : array_like, (nq,)
            Configuration.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            If q is not a valid configuration.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> viewer = scene.show(browser=False)  # doctest: +SKIP
        >>> viewer.update([0.3] * 6)  # doctest: +SKIP
        """
        scene = self._scene
        found: _Array = np.array(_core._numbers("q", q, scene, True))
        if found.shape != (scene.nq,):
            raise ShapeError(f"q: found shape {found.shape}; expected ({scene.nq},)")
        self._q = found
        self._serve_script()
        if self._served:
            self._stage.update(found)

    def wait(self) -> None:
        """Serve the viewer until it is closed, or until Ctrl-C.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> scene.show(browser=True).wait()  # doctest: +SKIP
        """
        self._serve_script()
        with contextlib.suppress(KeyboardInterrupt):
            while not self._closed.wait(0.5):
                pass
        self.close()

    def close(self) -> None:
        """Stop the server; the browser shows that the connection is closed.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> scene.show(browser=False).close()  # doctest: +SKIP
        """
        if not self._closed.is_set():
            self._closed.set()
            if self._served:
                self._stage.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<phipsi.view.Viewer: {self.url}{', closed' if self._closed.is_set() else ''}>"

    def _repr_html_(self) -> str:
        """The configuration or the motion as a page within a notebook."""
        html = _html(self._scene, self._shapes, self._displayed(), self._title)
        return f'<iframe title="{escape(self._title)}" srcdoc="{escape(html)}" style="width: 100%; height: {HEIGHT}px; border: 1px solid #d9dde1"></iframe>'

    def _repr_png_(self) -> bytes:
        """A picture of the configuration, or of the first one of the motion, where a saved notebook shows no pages."""
        stream = io.BytesIO()
        next(picture.frames(self._scene, self._displayed(), self._shapes, [0], picture.MOVING)).save(stream, "png")
        return stream.getvalue()

    def _displayed(self) -> Motion:
        return self._motion if self._motion.moves else Motion(self._scene, self._q, None)

    def _add_center_of_mass(self) -> None:
        shown = self._stage.server.gui.add_checkbox("center of mass", False)

        def turn(_: Any) -> None:
            self._stage.center.visible = shown.value
            self._stage.update(self._q, self._stage.shift)

        shown.on_update(turn)

    def _add_player(self) -> None:
        gui, (times, rows) = self._stage.server.gui, self._motion.frames()
        speed = gui.add_slider("speed", 0.1, 4.0, 0.1, 1.0)
        playing = gui.add_checkbox("play", True)
        at = gui.add_slider("time, s", float(times[0]), float(times[-1]), max(float(times[-1] - times[0]) / 1000.0, 1e-9), float(times[0]))

        stage, arrows = self._stage, self._stage.arrows
        follows = gui.add_checkbox("follow", True) if stage.way.any() else None
        frame = 0

        def seek(_: Any) -> None:
            nonlocal frame
            frame = int(np.clip(np.searchsorted(times, at.value), 0, len(times) - 1))
            self._q = rows[frame]
            stage.update(self._q, stage.way[frame] if follows is not None and follows.value else np.zeros(3))
            if arrows is not None:
                arrows.show(frame)

        at.on_update(seek)
        if follows is not None:
            follows.on_update(seek)
        if arrows is not None:
            shown = gui.add_checkbox("forces", True)
            shown.on_update(lambda _: arrows.turn(shown.value, frame))

        def play() -> None:
            while not self._closed.wait(1.0 / RATE):
                if playing.value:
                    ahead = at.value + speed.value / RATE
                    at.value = float(times[0]) if ahead > times[-1] else ahead

        threading.Thread(target=play, name="phipsi viewer", daemon=True).start()

    def _add_sliders(self) -> None:
        scene, gui = self._scene, self._stage.server.gui
        single = [joint for joint in scene.joint_names if _is_single(scene, joint)][:SLIDERS]
        joints, sliders = scene.joints, {}
        for name in single:
            at, joint = scene.q_index(name).start, joints[name]
            lower = joint.lower if np.isfinite(joint.lower) else -UNLIMITED
            upper = joint.upper if np.isfinite(joint.upper) else UNLIMITED
            value = float(self._q[at])
            step = min(STEP, 10.0 ** np.floor(np.log10(max(upper - lower, 1e-9) / STEPS)))
            # Multiples of the step within the limits, so that the sliders show few digits.
            low, high = np.ceil(min(lower, value) / step - 1e-9) * step, np.floor(max(upper, value) / step + 1e-9) * step
            unit = "m" if joint.type == "prismatic" else "rad"
            sliders[at] = gui.add_slider(f"{name}, {unit}", float(low), float(max(high, low + step)), float(step), float(np.clip(value, low, high)))

        def moved(_: Any) -> None:
            q = self._q.copy()
            for at, slider in sliders.items():
                q[at] = slider.value
            self._q = q
            self._stage.update(q)

        for slider in sliders.values():
            slider.on_update(moved)


def _is_single(scene: Scene, joint: str) -> bool:
    """Whether a joint has one coordinate."""
    at = scene.q_index(joint)
    return bool(at.stop - at.start == 1)


def _free(port: Any, host: Any) -> int:
    """The port of the host, or the next free one; zero means any port."""
    if not isinstance(host, str):
        raise ArgumentError(f"host: found {host!r}; expected the address of this machine as a str, such as {HOST!r} or {ANY[0]!r}")
    if isinstance(port, bool) or not isinstance(port, int | np.integer) or not 0 <= port < 65536:
        raise ArgumentError(f"port: found {port!r}; expected an integer from 1 to 65535, or 0 for any free port")
    reason = ""
    for found in range(int(port), min(int(port) + PORTS, 65536)):
        with socket.socket() as probe:
            # Same option as servers, which can reuse a recently closed port.
            if os.name == "posix":
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, found))
            except socket.gaierror:
                raise ArgumentError(f"host: found {host!r}, which is not an address; expected that of this machine, such as {HOST!r} or {ANY[0]!r}") from None
            except OSError as error:
                if error.errno == errno.EADDRNOTAVAIL:
                    raise ArgumentError(f"host: found {host!r}, which is not an address of this machine; expected {HOST!r}, or {ANY[0]!r} for all its addresses") from None
                reason = error.strerror or str(error)
                continue
            return found
    raise ArgumentError(f"port: found {port}, which cannot be used ({reason}), nor can the following ones; expected another port, or 0 for any free port")


def page(
    scene: Scene,
    motion: Trajectory | ArrayLike | None = None,
    *,
    t: ArrayLike | None = None,
    forces: tuple[ArrayLike, ArrayLike] | None = None,
    urdf: str | os.PathLike[str] | None = None,
    shapes: Sequence[Shape] | None = None,
    title: str | None = None,
) -> str:
    """HTML of a pose or a motion as a self-contained page.

    Parameters
    ----------
    scene : Scene
        The scene.
    motion : Trajectory or array_like, optional
        Trajectory of one state, configurations (k, nq), or one configuration (nq,); None: scene.initial().
    t : array_like, (k,), optional
        Times of the configurations, s.
    forces : tuple of array_like, optional
        Points of application, (k, n, 3), m, and forces, (k, n, 3), N, in the base frame, as arrows.
    urdf : path, optional
        File with the shapes; None: the file of the scene.
    shapes : sequence of Shape, optional
        Shapes instead of those of a file.
    title : str, optional
        Title of the page; None: the name of the robot.

    Returns
    -------
    str
        HTML.

    Raises
    ------
    ShapeError, NotFiniteError, ArgumentError
        If an argument is invalid.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> html = phipsi.view.page(scene, [0.3] * 6)  # doctest: +SKIP
    """
    return _html(scene, shapes_of(scene, urdf) if shapes is None else shapes, Motion(scene, motion, t, forces), title or name_of(scene))


def _html(scene: Scene, shapes: Sequence[Shape], motion: Motion, title: str) -> str:
    """HTML of a motion."""
    stage = _Stage(scene, shapes, 0, motion)
    try:
        return stage.html(motion, title)
    finally:
        stage.close()


def show(
    scene: Scene,
    motion: Trajectory | ArrayLike | None = None,
    *,
    t: ArrayLike | None = None,
    forces: tuple[ArrayLike, ArrayLike] | None = None,
    urdf: str | os.PathLike[str] | None = None,
    to: str | os.PathLike[str] | None = None,
    port: int = 0,
    host: str = HOST,
    title: str | None = None,
    browser: bool | None = None,
    collision: bool = False,
) -> Viewer | Path:
    """Implementation of Scene.show."""
    shapes = shapes_of(scene, urdf, collision)
    if to is not None:
        file, kind = Path(to), Path(to).suffix.lower()
        if kind in PAGES:
            file.write_text(page(scene, motion, t=t, forces=forces, shapes=shapes, title=title), encoding="utf-8")
        elif kind in PICTURES:
            picture.write(scene, Motion(scene, motion, t, forces), shapes, file)
        else:
            raise ArgumentError(f"to: found {str(to)!r}; expected a path that ends in {', '.join((*PAGES, *PICTURES))}")
        return file
    # A server ends with its script, before the browser has shown the robot. A port or a host asks for the server.
    as_page = browser is None and not port and host == HOST and not _in_notebook() and not _at_prompt()
    viewer = Viewer(scene, Motion(scene, motion, t, forces), shapes, _free(port, host), title, host, as_page)
    if as_page:
        _open(viewer)
    elif browser or (browser is None and not _in_notebook()):
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(viewer.url)
    return viewer


def _open(viewer: Viewer) -> None:
    """Open the viewer of a script in a browser, and print its address: nothing else shows it there."""
    print(viewer.url, flush=True)
    with contextlib.suppress(webbrowser.Error):
        webbrowser.open(viewer.url)


def _quiet() -> contextlib.AbstractContextManager[Any]:
    """Suppresses messages of viser, which a notebook would show as output of a cell."""
    if _in_notebook():
        found: contextlib.AbstractContextManager[Any] = importlib.import_module("IPython.utils.capture").capture_output()
        return found
    return contextlib.redirect_stdout(io.StringIO())


def _at_prompt() -> bool:
    """Whether statements are entered one by one, so that the server outlives this one."""
    ipython = sys.modules.get("IPython")
    return hasattr(sys, "ps1") or bool(sys.flags.interactive) or (ipython is not None and ipython.get_ipython() is not None)


def _in_notebook() -> bool:
    """Whether the code runs in a notebook, which displays a viewer below its cell."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and shell.has_trait("kernel")
