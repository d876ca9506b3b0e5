"""The viewer: a server on this machine alone, and what its page shows."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Mapping
from contextlib import redirect_stdout
from importlib.util import find_spec
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UsageError
from skin2urdf.scene.solids import Mesh
from skin2urdf.view.actors import Actor, Play
from skin2urdf.view.recorded import Motion

HOST = "127.0.0.1"
"""Only this machine can ask."""
_LINK, _JOINT, _SU, _OTHER = (184, 191, 200), (82, 96, 109), (11, 127, 120), (230, 159, 0)
_STEP = 0.1
"""Of a slider [deg or mm]."""
_FRAMES = 30.0
"""Pictures per second while a log plays."""
_SPEEDS = ("0.25", "0.5", "1", "2", "5", "10")


def check_library() -> None:
    """Make sure that there is a viewer.

    Raises:
        UsageError: the library is missing.
    """
    if find_spec("viser") is None:
        raise UsageError("the viewer needs viser", "pip install 'skin2urdf[view]'")


class Viewer:
    """Robots in a browser, with a slider for every joint.

    Args:
        play: the robots.
        motion: of a log to play; None for none.
        port: to listen on; the next free one is taken where it is not.
    """

    def __init__(self, play: Play, motion: Motion | None = None, port: int = 8080) -> None:
        check_library()
        import viser

        self._play, self._motion = play, motion
        self._positions = play.middle
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._following = False
        with redirect_stdout(io.StringIO()):  # a banner whatever `verbose` says
            self._server = viser.ViserServer(host=HOST, port=port, label=play.title, verbose=False)
        self._server.gui.configure_theme(
            control_layout="floating", show_logo=False, show_share_button=False
        )
        self._server.scene.set_up_direction("+z")
        self._server.scene.configure_default_lights(cast_shadow=False)
        self._frames = [self._add(play.first, "first", _LINK, 1.0)]
        if play.second is not None:
            self._frames.append(self._add(play.second, "second", _OTHER, 0.55))
        self._look()
        self._chosen = self._controls()
        self._sliders = self._joint_sliders()
        self._player = self._log_controls()
        self._show()

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{HOST}:{self._server.get_port()}"

    @property
    def positions(self) -> dict[str, float]:
        """Positions of the joints that are shown [rad or m]."""
        with self._lock:
            return dict(self._positions)

    def move(self, positions: Mapping[str, float]) -> None:
        """Show the robots with some joints elsewhere; sliders follow."""
        with self._lock:
            known = {name: x for name, x in positions.items() if name in self._positions}
            self._positions |= known
            self._following = True
            for name, value in known.items():
                if name in self._sliders:
                    low, high = self._play.limits[name]
                    self._sliders[name].value = self._shown(name, float(np.clip(value, low, high)))
            self._following = False
            self._show()

    def choose(self, su: str) -> None:
        """Tell about an SU."""
        self._chosen.value = "\n".join([su, *self._play.about[su]])

    def run(self) -> None:
        """Play on until the process is interrupted."""
        while not self._ended.is_set():
            self.tick(1.0 / _FRAMES)
            time.sleep(1.0 / _FRAMES)

    def tick(self, seconds: float) -> None:
        """Go on in a log that plays.

        Args:
            seconds: time that passed.
        """
        if self._player is None or self._motion is None or not self._player["on"].value:
            return
        clock, end = self._player["time"], self._motion.duration
        ahead = clock.value + seconds * float(self._player["speed"].value)
        clock.value = ahead if ahead < end else 0.0
        self.move(self._motion.at(clock.value))

    def stop(self) -> None:
        """End the server."""
        self._ended.set()
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def _add(self, actor: Actor, root: str, colour: tuple[int, int, int], opacity: float) -> Any:
        """Put a robot into the scene; handles of its segments' frames, by joint.

        Names from URDFs may hold slashes, which would make other nodes: nodes are numbered.
        """
        scene = self._server.scene
        frames = {}
        for i, joint in enumerate(actor.moved):
            node = f"/{root}/{i}"
            frames[joint] = scene.add_frame(node, show_axes=False)
            if joint in actor.links:
                self._mesh(f"{node}/links", actor.links[joint], colour, opacity)
            if joint in actor.joints:
                self._mesh(f"{node}/joint", actor.joints[joint], _JOINT, opacity)
        places = {joint: i for i, joint in enumerate(actor.moved)}
        for k, (su, (joint, mesh)) in enumerate(actor.sus.items()):
            node = f"/{root}/{places[joint]}/su{k}"
            first = root == "first"
            handle = self._mesh(node, mesh, _SU if first else _OTHER, opacity)
            if first and handle is not None:
                handle.on_click(lambda _, su=su: self.choose(su))
                scene.add_label(
                    f"{node}/name", su, position=tuple(mesh.vertices.mean(axis=0)),
                    font_screen_scale=0.8,
                )  # fmt: skip
        return frames

    def _mesh(
        self, node: str, mesh: Mesh, colour: tuple[int, int, int], opacity: float
    ) -> Any | None:
        """Add a surface; None where there is nothing to show."""
        if not len(mesh.faces):
            return None
        return self._server.scene.add_mesh_simple(
            node,
            mesh.vertices.astype(np.float32),
            mesh.faces.astype(np.uint32),
            color=colour,
            opacity=None if opacity >= 1 else opacity,
            flat_shading=True,
            side="double",
        )

    def _look(self) -> None:
        """Look at all that is shown, and lay a floor below."""
        vertices = [
            mesh.vertices @ T[:3, :3].T + T[:3, 3]
            for actor in (self._play.first, self._play.second)
            if actor is not None
            for frames in [actor.frames(self._positions)]
            for joint, T in frames.items()
            for mesh in [actor.links.get(joint)]
            if mesh is not None and len(mesh.vertices)
        ]
        points = np.concatenate(vertices) if vertices else np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        middle, extent = 0.5 * (low + high), float(np.linalg.norm(high - low)) or 1.0
        camera = self._server.initial_camera
        camera.position = tuple(middle + extent * np.array([0.75, -0.75, 0.35]))
        camera.look_at = tuple(middle)
        self._server.scene.add_grid(
            "/floor", width=2 * extent, height=2 * extent, cell_size=0.1, section_size=0.5,
            position=(float(middle[0]), float(middle[1]), float(low[2])),
        )  # fmt: skip

    def _controls(self) -> Any:
        """What tells about the SU that was clicked, and switches."""
        gui = self._server.gui
        chosen = gui.add_text("SU", "click one", multiline=True, disabled=True)
        if self._play.second is not None:
            shown = gui.add_checkbox(self._play.second.robot.path.name, True)
            shown.on_update(lambda _: self._set_second(shown.value))
        return chosen

    def _set_second(self, visible: bool) -> None:
        """Show the other robot, or do not."""
        for frame in self._frames[1].values():
            frame.visible = visible

    def _joint_sliders(self) -> dict[str, Any]:
        """A slider for each joint, in degrees or millimetres."""
        gui, sliders = self._server.gui, {}
        with gui.add_folder("joints"):
            middle = gui.add_button("middle of all ranges")
            for name, (low, high) in self._play.limits.items():
                unit = "mm" if name in self._play.prismatic else "deg"
                ends = self._shown(name, low), self._shown(name, high)
                if ends[1] - ends[0] < _STEP:
                    continue
                slider = gui.add_slider(
                    f"{name} [{unit}]", min=ends[0], max=ends[1], step=_STEP,
                    initial_value=self._shown(name, self._positions[name]),
                )  # fmt: skip
                slider.on_update(lambda _, name=name: self._slid(name))
                sliders[name] = slider
        middle.on_click(lambda _: self.move(self._play.middle))
        return sliders

    def _log_controls(self) -> dict[str, Any] | None:
        """What plays a log; None without one."""
        if self._motion is None or self._motion.duration <= 0:
            return None
        gui = self._server.gui
        with gui.add_folder("log", order=-1):
            on = gui.add_checkbox("play", True)
            end = self._motion.duration
            clock = gui.add_slider("time [s]", min=0.0, max=end, step=0.01, initial_value=0.0)
            speed = gui.add_dropdown("speed", options=_SPEEDS, initial_value="1")
        clock.on_update(self._wound)
        return {"on": on, "time": clock, "speed": speed}

    def _wound(self, event: Any) -> None:
        """The time was changed; by hand where a browser did it."""
        if event.client is not None and self._motion is not None:
            self.move(self._motion.at(event.target.value))

    def _slid(self, name: str) -> None:
        """A slider was moved."""
        if self._following:
            return
        with self._lock:
            shown = float(self._sliders[name].value)
            factor = 1e-3 if name in self._play.prismatic else float(np.deg2rad(1.0))
            self._positions[name] = factor * shown
            self._show()

    def _shown(self, name: str, value: float) -> float:
        """A position in what its slider shows [deg or mm], to one of its steps."""
        return round(float(1e3 * value if name in self._play.prismatic else np.rad2deg(value)), 1)

    def _show(self) -> None:
        """Put all segments where the joints say."""
        actors = [self._play.first, self._play.second]
        with self._server.atomic():
            for actor, frames in zip(actors, self._frames, strict=False):
                if actor is None:
                    continue
                for joint, T in actor.frames(self._positions).items():
                    _put(frames[joint], T)


def _put(frame: Any, T: F64) -> None:
    """Move a frame of the scene to (4, 4) T."""
    from viser.transforms import SO3

    frame.wxyz = SO3.from_matrix(T[:3, :3]).wxyz
    frame.position = tuple(T[:3, 3])
