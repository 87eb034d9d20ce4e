"""Pictures of a robot and films of runs by Drake's VTK renderer, without a display or a GPU."""

from __future__ import annotations

import io
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydrake import geometry
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.logs.log import SimulationLog
from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.plant.model_files import on_platform
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.plant.plant_options import DrakeOptions, RodJoint
from stewart_drake.robot import RobotParameters
from stewart_drake.runs.outputs import check_ending
from stewart_drake.runs.scene import REFERENCE_COLOUR, reference_disc, viewpoint

if TYPE_CHECKING:
    from PIL.Image import Image

LENS = 32.0  # [deg] vertical field of view.
FRAMES_PER_SECOND = 20.0
MAX_FRAMES = 1200


class Studio:
    """A robot on a white floor in soft light, and a camera; width and height in pixels.

    With `film` pictures are fast: few lights, no shadows, and a translucent disc at the reference pose.
    """

    def __init__(
        self,
        robot: RobotParameters,
        width: int,
        height: int,
        rod_joint: RodJoint = "universal",
        film: bool = False,
    ) -> None:
        self.width, self.height, self._film = width, height, film
        builder = DiagramBuilder()
        self.stewart = add_plant(builder, robot, DrakeOptions(rod_joint=rod_joint), visuals=True)
        assert self.stewart.scene_graph is not None
        self._scene_graph = self.stewart.scene_graph
        source = self._scene_graph.RegisterSource("studio")
        _add_floor(self._scene_graph, source, robot)
        self._disc: geometry.FrameId | None = None
        if film:
            self._disc = self._scene_graph.RegisterFrame(source, geometry.GeometryFrame("reference"))
            shape = geometry.Cylinder(*reference_disc(robot))
            at, turn = on_platform(robot, np.zeros(3), np.zeros(3))
            place = RigidTransform(RollPitchYaw(turn), at)
            disc = geometry.GeometryInstance(place, shape, "reference")
            disc.set_perception_properties(_painted(geometry.Rgba(*REFERENCE_COLOUR)))
            self._scene_graph.RegisterGeometry(source, self._disc, disc)
        self._reference_port = self._scene_graph.get_source_pose_port(source)
        diagram = builder.Build()
        self._context = diagram.CreateDefaultContext()
        self._scene = self._scene_graph.GetMyMutableContextFromRoot(self._context)
        self._plant_context = self.stewart.plant.GetMyMutableContextFromRoot(self._context)
        # X_WC looks at the target, upright; Drake's cameras look along z with y down.
        camera, target = viewpoint(robot)
        z = (target - camera) / np.linalg.norm(target - camera)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        self._camera = RigidTransform(RotationMatrix(np.stack([x, np.cross(z, x), z], axis=-1)), camera)
        self._light: list[list[geometry.LightParameter]] = []

    def picture(
        self,
        state: np.ndarray,
        reference: np.ndarray | None = None,
        passes: int = 1,
        progress: Callable[[float], None] = lambda _: None,
    ) -> Image:
        """The robot in a state of the plant, with the reference pose (6,) [rad, m].

        VTK renders hard shadows and jagged edges. The average of `passes` pictures with different lights, shifted by
        fractions of a pixel, has soft shadows and smooth edges.
        """
        from PIL import Image

        self.stewart.plant.SetPositionsAndVelocities(self._plant_context, state)
        if self._disc is not None and reference is not None:
            poses = geometry.FramePoseVector()
            poses.set_value(self._disc, RigidTransform(RollPitchYaw(reference[:3]), reference[3:]))
            self._reference_port.FixValue(self._scene, Value(poses))
        if len(self._light) != passes:
            self._light_up(passes)
        focal = 0.5 * self.height / math.tan(math.radians(0.5 * LENS))
        total = np.zeros((self.height, self.width, 3))
        query = self._scene_graph.get_query_output_port().Eval(self._scene)
        for number, (dx, dy) in enumerate(_spread(passes) - 0.5):
            center = 0.5 * (self.width - 1) + dx, 0.5 * (self.height - 1) + dy
            lens = CameraInfo(self.width, self.height, focal, focal, *center)
            core = geometry.RenderCameraCore(
                f"studio {number}", lens, geometry.ClippingRange(0.01, 100.0), RigidTransform()
            )
            camera = geometry.ColorRenderCamera(core, False)
            image = query.RenderColorImage(camera, geometry.SceneGraph.world_frame_id(), self._camera)
            total += image.data[..., :3]
            progress(number + 1.0)
        return Image.fromarray(np.rint(total / passes).astype(np.uint8))

    def _light_up(self, passes: int) -> None:
        for number in range(len(self._light)):
            self._scene_graph.RemoveRenderer(self._scene, f"studio {number}")
        self._light = _studio_lights(passes, 1 if self._film else 5)
        for number, lights in enumerate(self._light):
            engine = geometry.RenderEngineVtkParams(
                default_clear_color=[1.0, 1.0, 1.0], lights=lights, cast_shadows=not self._film, shadow_map_size=1024
            )
            self._scene_graph.AddRenderer(self._scene, f"studio {number}", geometry.MakeRenderEngineVtk(engine))
        # A renderer added to a Context gets the poses at the next change of the state.
        plant = self.stewart.plant
        plant.SetPositions(self._plant_context, plant.GetPositions(self._plant_context).copy())


def render_png(
    robot: RobotParameters,
    pose: np.ndarray,
    path: Path,
    *,
    width: int = 1200,
    height: int = 900,
    passes: int = 16,
    progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Writes a PNG of the robot at a pose (6,) [rad, m]; more `passes` give softer shadows and smoother edges.

    `progress` gets the number of finished passes. The system's libEGL is needed.
    """
    studio = Studio(robot, width, height)
    studio.picture(studio.stewart.assemble(pose), passes=passes, progress=progress).save(path)


def write_film(
    log: SimulationLog,
    path: str | Path,
    *,
    frames_per_second: float = FRAMES_PER_SECOND,
    width: int = 480,
    progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Writes the motion of a run as a film, with time and error.

    Args:
        log: A run, completed or not.
        path: Ends in .gif, or in .mp4 if the program ffmpeg is installed.
        frames_per_second: [1/s]; lower if there would be more than `MAX_FRAMES`.
        width: [px].
        progress: Gets the time [s] of the latest frame.

    Raises:
        ConfigurationError: Another ending, no ffmpeg, no row of finite state, or a folder that cannot be written to.
        DrakeCheckError: Drake cannot render here.
    """
    path = Path(path)
    check_film(path)
    frames, rate = film_frames(log, frames_per_second=frames_per_second, width=width, progress=progress)
    save_film(frames, rate, path)


def film_frames(
    log: SimulationLog,
    *,
    frames_per_second: float = FRAMES_PER_SECOND,
    width: int = 480,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[list[Image], float]:
    """Frames of a film and their rate [1/s]; arguments and errors as in `write_film`."""
    states = log.signals.get("plant_state")
    usable = np.flatnonzero(np.isfinite(log["pose"] if states is None else states).all(axis=1))
    if len(usable) == 0:
        raise ConfigurationError("log", f"{len(log.time)} rows", "a log with at least one row of finite state")
    end = float(log.time[usable[-1]])
    rate = min(frames_per_second, MAX_FRAMES / max(end, 1e-9))
    rows = usable[
        np.searchsorted(log.time[usable], np.arange(0.0, end + 0.5 / rate, 1.0 / rate)).clip(max=len(usable) - 1)
    ]
    rotation, position = log.error_norms
    frames: list[Image] = []
    with drake_guard("rendering the film"):
        # Rendered at twice the size, for smooth edges.
        size = width, width * 5 // 6
        studio = Studio(log.scenario.robot, 2 * size[0], 2 * size[1], log.scenario.plant.rod_joint, film=True)
        for row in rows:
            state = studio.stewart.assemble(log["pose"][row]) if states is None else states[row]
            image = studio.picture(state, log["reference"][row]).resize(size)
            frames.append(_captioned(image, log.scenario.name, log.time[row], rotation[row], position[row]))
            progress(float(log.time[row]))
    return frames, rate


def save_film(frames: list[Image], rate: float, path: Path) -> None:
    """Writes frames at a rate [1/s] as .gif or .mp4."""
    write_atomically(path, _gif(frames, rate) if path.suffix == ".gif" else _mp4(frames, rate))


def check_film(path: Path) -> None:
    """Raises a `ConfigurationError` for a path that `write_film` cannot write."""
    check_ending("film", path, ".gif", ".mp4")
    if path.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise ConfigurationError("film", str(path), "a name that ends in .gif, or an installation of ffmpeg for .mp4")


def _captioned(image: Image, name: str, time: float, rotation: float, position: float) -> Image:
    from PIL import ImageDraw, ImageFont

    draw, size = ImageDraw.Draw(image), image.width // 34
    font, grey = ImageFont.load_default(size), (70, 70, 70)
    error = f"error {rotation:.3f} deg, {position:.3f} mm"
    draw.text((size, size), f"{name}   t = {time:.2f} s", grey, font)
    draw.text((size, image.height - 2 * size), error, grey, font)
    return image


def _gif(frames: list[Image], rate: float) -> bytes:
    from PIL import Image

    # One palette for all frames, without dithering: pixels at rest do not change, which keeps the file small.
    palette = frames[len(frames) // 2].quantize(128, method=Image.Quantize.MEDIANCUT)
    reduced = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    stream = io.BytesIO()
    # A GIF counts time in hundredths of a second.
    reduced[0].save(
        stream,
        "GIF",
        save_all=True,
        append_images=reduced[1:],
        duration=10 * round(100.0 / rate),
        loop=0,
        optimize=True,
    )
    return stream.getvalue()


def _mp4(frames: list[Image], rate: float) -> bytes:
    width, height = (size - size % 2 for size in frames[0].size)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "film.mp4"
        command = ["ffmpeg", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        command += ["-r", f"{rate:g}", "-i", "-", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(out)]
        content = b"".join(frame.crop((0, 0, width, height)).tobytes() for frame in frames)
        done = subprocess.run(command, input=content, capture_output=True, check=False)
        if done.returncode != 0:
            raise ConfigurationError("film", done.stderr.decode(errors="replace")[-200:], "an ffmpeg that writes MP4")
        return out.read_bytes()


def _painted(color: geometry.Rgba) -> geometry.PerceptionProperties:
    paint = geometry.PerceptionProperties()
    paint.AddProperty("phong", "diffuse", color)
    paint.AddProperty("label", "id", geometry.RenderLabel.kDontCare)
    return paint


def _add_floor(scene_graph: geometry.SceneGraph, source: geometry.SourceId, robot: RobotParameters) -> None:
    """A white disc just below the base, or below the cranks if they are lower at home."""
    tips = robot.shaft_positions[:, 2] + robot.crank_lengths * leg_geometry(robot, robot.home_pose).crank[:, 2]
    top = min(robot.base_height - 6.0 * robot.link_radius, float(tips.min()) - 3.0 * robot.link_radius)
    thickness = 0.01
    floor = geometry.GeometryInstance(
        RigidTransform([0.0, 0.0, top - 0.5 * thickness]),
        geometry.Cylinder(3.5 * robot.base_radius, thickness),
        "floor",
    )
    floor.set_perception_properties(_painted(geometry.Rgba(1.0, 1.0, 1.0, 1.0)))
    scene_graph.RegisterAnchoredGeometry(source, floor)


def _studio_lights(passes: int, per_pass: int) -> list[list[geometry.LightParameter]]:
    """Lights by pass: samples of a lamp above, of a lamp around the camera, and of a bright sky."""
    spread = _spread(passes * per_pass)
    angle = 2.0 * np.pi * spread[:, 1]
    disc = np.sqrt(spread[:, :1]) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    one = np.ones((len(disc), 1))
    # Directions of the light; those of the sky fill a hemisphere, denser towards its top (Lambert's law). With these
    # intensities the floor is as white as the background.
    sky = 0.97 * disc
    groups = (
        ("world", 0.56, np.hstack([0.1 * disc + [-0.3, 0.38], -one])),
        ("world", 0.64, np.hstack([sky, -np.sqrt(1.0 - np.sum(sky**2, axis=1, keepdims=True))])),
        ("camera", 0.42, np.hstack([0.5 * disc, one])),
    )
    return [
        [
            geometry.LightParameter(
                type="directional", frame=frame, direction=direction, intensity=intensity / per_pass
            )
            for frame, intensity, directions in groups
            for direction in directions[start::passes]
        ]
        for start in range(passes)
    ]


def _spread(count: int) -> np.ndarray:
    """(count, 2) points that fill the unit square evenly: Roberts' R2 sequence, after powers of the plastic number."""
    plastic = 1.324717957244746
    index = np.arange(1, count + 1)[:, None]
    points: np.ndarray = (0.5 + index / np.array([plastic, plastic**2])) % 1.0
    return points
