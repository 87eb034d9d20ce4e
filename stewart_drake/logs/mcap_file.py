"""A log as an MCAP file: signals and poses as messages of ROS 2, for Rerun, Foxglove and others; joints and a scene.

The scene of cranks and rods, and the joints, are JSON with the names in
docs.foxglove.dev/docs/visualization/message-schemas, and drawn by Foxglove alone. Times start from zero.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.base.errors import installed_with
from stewart_drake.logs.outcomes import is_measured
from stewart_drake.logs.signals import SIGNALS
from stewart_drake.mechanics.kinematics import leg_geometry, quaternion

if TYPE_CHECKING:
    from stewart_drake.logs.log import SimulationLog

_FRAME = "base"  # Frame B.
_SCENE_RATE = 30.0  # [1/s] of the scene's updates, at most.
_POSES = ("pose", "reference", "measured_pose")
_COLOURS = {"cranks": (0.84, 0.37, 0.0), "rods": (0.5, 0.52, 0.58), "platform": (0.0, 0.45, 0.7)}
_LINE_LIST, _LINE_LOOP = 2, 1  # Types of foxglove.LinePrimitive.
_CDR = b"\x00\x01\x00\x00"  # Before a message: little-endian.
_STAMPED = "\n".join(
    (
        "std_msgs/Header header\ngeometry_msgs/Pose pose",
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
        "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
        "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z",
        "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    )
).replace("\nMSG", f"\n{80 * '='}\nMSG")
_TIME = '{"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}'
_LIST = '{"type": "array", "items": {"type": "object"}}'
_JOINTS = (
    f'{{"title": "foxglove.JointStates", "type": "object", "properties": {{"timestamp": {_TIME}, "joints": {_LIST}}}}}'
)
_SCENE = f'{{"title": "foxglove.SceneUpdate", "type": "object", "properties": {{"entities": {_LIST}}}}}'


def check_mcap() -> None:
    """Raises a MissingPackageError if a log cannot be written as MCAP."""
    with installed_with("stewart-drake[mcap]", "a log can be saved as .parquet or .csv without it"):
        import mcap.writer  # noqa: F401


def to_mcap(log: SimulationLog) -> bytes:
    """The log as MCAP: a topic per signal, poses in the base, `/joint_states`, and `/scene` at most 30 times a second.

    Raises:
        MissingPackageError: The package mcap is missing.
    """
    check_mcap()
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library="stewart_drake")
    writer.add_metadata("stewart_drake", {"scenario": log.scenario.name, "status": log.status})
    times = [round(1e9 * float(time)) for time in log.time]
    for topic, name, schema, messages in _topics(log):
        language, coding = ("jsonschema", "json") if schema.startswith("{") else ("ros2msg", "cdr")
        channel = writer.register_channel(topic, coding, writer.register_schema(name, language, schema.encode()))
        for row, message in messages:
            writer.add_message(channel, times[row], message, times[row])
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


_Stamps = list[dict[str, int]]  # Seconds and nanoseconds by row.
_Message = tuple[int, bytes]  # Row of the log, and message: JSON, or of ROS 2.
_Topic = tuple[str, str, str, Iterator[_Message]]


def _topics(log: SimulationLog) -> Iterator[_Topic]:
    """Name, name of the schema, the schema, of JSON or of ROS 2, and messages of the topics."""
    stamps = [{"sec": int(time), "nsec": round(1e9 * (float(time) % 1.0)) % 10**9} for time in log.time]
    for name, values in log.signals.items():
        columns = log.state_names if name == "plant_state" else SIGNALS[name].components or ("value",)
        # Messages have time stamps.
        if columns and name != "time":
            # A name of ROS 2 begins with a letter.
            fields = [f"float64 {f'leg_{column}' if column.isdigit() else column}" for column in columns]
            yield f"/{name}", f"stewart_drake/msg/{name.title().replace('_', '')}", "\n".join(fields), _numbers(values)
    for name in _POSES:
        if name in log:
            yield f"/{name}_in_base", "geometry_msgs/msg/PoseStamped", _STAMPED, _poses(stamps, log[name])
    angles = log.signals.get("crank_angle", log.signals.get("reading"))
    if angles is not None and is_measured(log.signals):
        yield "/joint_states", "foxglove.JointStates", _JOINTS, _joints(stamps, log, angles)
    if "pose" in log:
        yield "/scene", "foxglove.SceneUpdate", _SCENE, _scene(stamps, log)


def _numbers(values: np.ndarray) -> Iterator[_Message]:
    for row, numbers in enumerate(values):
        yield row, _CDR + numbers.astype("<f8").tobytes()


def _point(xyz: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", map(float, xyz), strict=True))


def _poses(stamps: _Stamps, poses: np.ndarray) -> Iterator[_Message]:
    frame = _FRAME.encode() + b"\0"
    for row, (rotation, pose) in enumerate(zip(quaternion(poses[:, :3]), poses, strict=True)):
        if np.isfinite(pose).all():
            header = struct.pack("<iII", *stamps[row].values(), len(frame)) + frame
            # Numbers are at multiples of eight bytes.
            numbers = np.concatenate([pose[3:], np.roll(rotation, -1)]).astype("<f8")
            yield row, _CDR + header + bytes(-len(header) % 8) + numbers.tobytes()


def _joints(stamps: _Stamps, log: SimulationLog, angles: np.ndarray) -> Iterator[_Message]:
    torques = log.signals.get("torque_applied")
    # JSON has no NaN.
    for row in np.flatnonzero(np.isfinite(angles).all(axis=1)).tolist():
        positions = angles[row].tolist()
        joints = [{"name": f"motor_{i}", "position": angle} for i, angle in enumerate(positions)]
        if torques is not None:
            joints = [{**joint, "effort": float(torques[row, i])} for i, joint in enumerate(joints)]
        yield row, json.dumps({"timestamp": stamps[row], "joints": joints}).encode()


def _scene(stamps: _Stamps, log: SimulationLog) -> Iterator[_Message]:
    """Lines from shaft to tip, from tip to joint, and around the joints of the platform."""
    robot, next_time = log.scenario.robot, -np.inf
    for row, time in enumerate(log.time):
        if time < next_time - 1e-9 or not np.isfinite(log["pose"][row]).all():
            continue
        next_time, legs = time + 1.0 / _SCENE_RATE, leg_geometry(robot, log["pose"][row])
        tips = robot.shaft_positions + robot.crank_lengths[:, None] * legs.crank
        ends = log["pose"][row, 3:] + legs.arm
        lines = (
            ("cranks", _LINE_LIST, np.stack([robot.shaft_positions, tips], axis=1).reshape(-1, 3)),
            ("rods", _LINE_LIST, np.stack([tips, ends], axis=1).reshape(-1, 3)),
            ("platform", _LINE_LOOP, ends),
        )
        entity = {"timestamp": stamps[row], "frame_id": _FRAME, "id": "robot", "lifetime": {"sec": 0, "nsec": 0}}
        thickness = {"thickness": 0.05 * robot.characteristic_length, "scale_invariant": False}
        base = {"position": _point(np.zeros(3)), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        drawn = [
            {"type": kind, "pose": base, "points": [_point(p) for p in points], "color": _colour(name), **thickness}
            for name, kind, points in lines
        ]
        entities = [{**entity, "frame_locked": False, "metadata": [], "lines": drawn}]
        yield row, json.dumps({"deletions": [], "entities": entities}).encode()


def _colour(name: str) -> dict[str, float]:
    return {**dict(zip("rgb", _COLOURS[name], strict=True)), "a": 1.0}
