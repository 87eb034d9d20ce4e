"""The faults of the table: each a change of the scenario, and what is expected of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from stewart_drake.scenario import Scenario, load_scenario

Reaction = Literal["refused", "ridden through", "held", "ramped", "ended", "unnoticed"]
"""refused: before the start. ridden through: no monitor tripped, and none had to. unnoticed: none tripped, but the true
pose went farther from the reference than `safety.following_error` allows. held: the last good command
bridged it. ramped: a safe hold, then the end. ended: without one, since the robot could not be held; brakes are all
that is left."""

ONSET = 0.5
"""[s] when every fault begins."""
DURATION = 2.0
"""[s] of each run; assumed long enough for what a fault does to show."""

HOME = [0.0, 0.0, 0.0, 0.0, 0.0, 0.3]
MOTIONS: Mapping[str, Mapping[str, Any]] = {
    "hold": {"kind": "hold", "pose": HOME},
    "breathing": {"kind": "breathing", "phase": 0.0},
    "paper": {"kind": "sine"},
}
"""Breathing begins at end-inhale, so that it moves when the fault comes."""


@dataclass(frozen=True)
class Fault:
    """A row of the table.

    Attributes:
        name: Stable name.
        text: One line.
        changes: Scenario keys; `reference` is the motion's, whatever they say.
        drift: (6,) [rad, m] by which the reference wanders off; None for not at all.
        drift_time: [s] in which it does.
        checked: Whether the run is checked beforehand, as a user's is.
        expected: Reactions allowed.
        monitors: Monitors allowed to trip first; empty where none may.
        since: [s] from which it acts; 0 for what is wrong from the start.
        encoders: Keys of `sensors`, for a loop with encoders and commands a tick late; None for ideal sensors.
    """

    name: str
    text: str
    changes: Mapping[str, Any]
    expected: tuple[Reaction, ...]
    monitors: tuple[str, ...] = ()
    drift: tuple[float, ...] | None = None
    drift_time: float = 0.8
    checked: bool = True
    since: float = ONSET
    encoders: Mapping[str, Any] | None = field(default=None)

    def scenario(self, motion: str) -> Scenario:
        """The run of this fault during a motion of `MOTIONS`."""
        reference: Mapping[str, Any] = MOTIONS[motion]
        if self.drift is not None:
            away = [a + b for a, b in zip(HOME, self.drift, strict=True)]
            path = {"kind": "minimum_jerk", "poses": [HOME, away], "durations": [self.drift_time], "dwell": [ONSET]}
            reference = {"kind": "sum", "parts": [reference, path]}
        changes: dict[str, Any] = {"name": f"{self.name} {motion}", "reference": dict(reference), **self.changes}
        if self.encoders is not None:
            # Commands of a real drive are a tick old; with encoders it has to be shown that the loop bears both.
            changes |= {"sensors": {"kind": "encoders", **self.encoders}, "command_delay": 1}
        return base().replace(changes)


def base() -> Scenario:
    """The exact-model LQI of `exact_fig7` behind the safety layer, as it stands by default."""
    return load_scenario("exact_fig7").replace({"duration": DURATION, "safety": {}})


def _push(kind: str, **keys: Any) -> dict[str, Any]:
    return {"disturbances": [{"kind": kind, **keys}]}


def _command(**keys: Any) -> dict[str, Any]:
    return {"link": {"faults": [{"time": ONSET, **keys}]}}


def _encoder(**keys: Any) -> dict[str, Any]:
    return {"faults": [{"time": ONSET, "leg": 1, **keys}]}


_THROUGH: tuple[Reaction, ...] = ("ridden through",)
_STOPPED: tuple[Reaction, ...] = ("ramped", "ended")

FAULTS: tuple[Fault, ...] = (
    # --- the world ---
    Fault("push_5N", "5 N sideways, for good", _push("step", wrench=[0, 0, 0, 5, 0, 0], time=ONSET), _THROUGH),
    Fault("blow_0.5Ns", "blow of 0.5 N s", _push("impulse", impulse=[0, 0, 0, 0, 0.5, 0], time=ONSET), _THROUGH),
    Fault("shaking_5Hz", "sine of 3 N at 5 Hz", _push("sine", wrench=[0, 0, 0, 3, 0, 0], frequency=5), _THROUGH),
    Fault(
        "noise_1N",
        "noise of 1 N and 20 N mm rms on each axis, 0.5 to 50 Hz",
        _push("noise", rms=[0.02] * 3 + [1.0] * 3, seed=1),
        _THROUGH,
    ),
    Fault(
        "push_150N",
        "150 N sideways: more than the motors can",
        _push("step", wrench=[0, 0, 0, 150, 0, 0], time=ONSET),
        _STOPPED,
        ("following_error", "torque_limit"),
    ),
    Fault(
        "payload_0.3kg",
        "0.3 kg, 50 mm off centre, that nobody told the controller of",
        {"plant.payload_mass": 0.3, "plant.payload_position": [0.05, 0, 0.02]},
        _THROUGH,
        since=0.0,
    ),
    Fault(
        "payload_1kg",
        "1 kg, as heavy as the platform",
        {"plant.payload_mass": 1.0, "plant.payload_position": [0.03, 0, 0.05]},
        _THROUGH,
        since=0.0,
    ),
    # --- the robot is not what the controller believes ---
    Fault(
        "mass_minus_20",
        "model 20 % too light",
        {"model_robot": {"platform_mass": 0.8, "rod_mass": 0.064, "platform_inertia": [0.0024, 0.0024, 0.0048]}},
        _THROUGH,
        since=0.0,
    ),
    Fault(
        "rods_plus_1mm",
        "rods 1 mm longer than in the model",
        {"model_robot": {"rod_length": 0.403}},
        _THROUGH,
        since=0.0,
        encoders={},
    ),
    Fault("friction", "0.08 N m of dry friction in every motor", {"plant.motor_friction": 0.08}, _THROUGH, since=0.0),
    # --- motors ---
    Fault(
        "ripple",
        "torque ripple of 0.02 N m, 12 periods a turn",
        {"motors": {"ripple": 0.02}},
        _THROUGH,
        since=0.0,
    ),
    Fault("torque_steps", "torque in steps of 0.01 N m", {"motors": {"resolution": 0.01}}, _THROUGH, since=0.0),
    Fault(
        "dead_motor_0",
        "motor 0 without torque",
        {"motors": {"dead": {"leg": 0, "time": ONSET}}},
        _STOPPED,
        ("following_error",),
    ),
    Fault(
        "dead_motor_3",
        "motor 3 without torque",
        {"motors": {"dead": {"leg": 3, "time": ONSET}}},
        _STOPPED,
        ("following_error",),
    ),
    Fault(
        "broken_rod_2",
        "rod 2 comes off the platform",
        {"plant.broken_rod": {"leg": 2, "time": ONSET}},
        _STOPPED,
        ("following_error",),
    ),
    # --- sensors ---
    Fault("encoder_noise", "noise of 0.1 mrad", {}, _THROUGH, since=0.0, encoders={"noise": 1e-4, "noise_seed": 1}),
    Fault("encoder_12bit", "encoders of 12 bits", {}, _THROUGH, since=0.0, encoders={"resolution_bits": 12}),
    Fault(
        "homing_2mrad",
        "encoder 0 homed 2 mrad wrong",
        {},
        _THROUGH,
        since=0.0,
        encoders={"offset": [0.002, 0, 0, 0, 0, 0]},
    ),
    Fault(
        "encoder_frozen",
        "encoder 1 repeats its last reading",
        {},
        ("unnoticed", "ended"),
        ("sensor_failed",),
        encoders=_encoder(kind="freeze"),
    ),
    Fault(
        "encoder_nan_5ms",
        "encoder 1 says NaN for 5 ms",
        {},
        _THROUGH,
        encoders=_encoder(kind="nan", duration=0.005),
    ),
    Fault(
        "encoder_nan_20ms",
        "encoder 1 says NaN for 20 ms",
        {},
        ("held",),
        ("sensor_failed",),
        encoders=_encoder(kind="nan", duration=0.02),
    ),
    Fault("encoder_nan", "encoder 1 says NaN", {}, ("ended",), ("sensor_failed",), encoders=_encoder(kind="nan")),
    Fault(
        "encoder_slips",
        "encoder 1 off by 5 mrad from one tick to the next",
        {},
        _THROUGH,
        encoders=_encoder(kind="jump", size=0.005),
    ),
    Fault(
        "encoder_jumps",
        "encoder 1 off by 0.2 rad",
        {},
        _STOPPED,
        ("sensor_failed", "crank_speed"),
        encoders=_encoder(kind="jump", size=0.2),
    ),
    Fault(
        "pose_nan",
        "pose sensor says NaN",
        {"sensors": {"kind": "ideal", "faults": [{"kind": "nan", "time": ONSET}]}},
        ("ended",),
        ("measurement_not_finite",),
    ),
    Fault(
        "pose_nan_10ms",
        "pose sensor says NaN for 10 ms",
        {"sensors": {"kind": "ideal", "faults": [{"kind": "nan", "time": ONSET, "duration": 0.01}]}},
        ("held",),
        ("measurement_not_finite",),
    ),
    Fault(
        "pose_frozen",
        "pose sensor repeats itself",
        {"sensors": {"kind": "ideal", "faults": [{"kind": "freeze", "time": ONSET}]}},
        ("ridden through", "ended"),
        ("sensor_failed",),
    ),
    # --- commands ---
    Fault(
        "dropped_10_percent",
        "a tick in ten is lost",
        {"link": {"drop_probability": 0.1, "seed": 1}},
        ("ridden through", "held"),
        ("deadline",),
        since=0.0,
    ),
    Fault(
        "dropped_15",
        "15 ticks lost in a row",
        {"link": {"dropped": list(range(500, 515))}},
        ("held",),
        ("deadline",),
    ),
    Fault("late_half", "every other tick is a period late", {"link": {"late_probability": 0.5}}, _THROUGH, since=0.0),
    Fault("delay_3", "every command 3 ticks late", {"command_delay": 3}, _THROUGH, since=0.0),
    Fault("controller_hangs", "no command any more", {"link": {"stop_time": ONSET}}, ("ramped",), ("deadline",)),
    Fault(
        "command_nan_10ms",
        "NaN for 10 ms",
        _command(kind="nan", leg=3, duration=0.01),
        ("held",),
        ("command_not_finite",),
    ),
    Fault("command_nan", "NaN", _command(kind="nan", leg=3), ("ramped",), ("command_not_finite",)),
    Fault("command_inf", "infinite torque", _command(kind="inf", leg=3), ("ramped",), ("command_not_finite",)),
    Fault(
        "command_1e6",
        "1e6 N m at one motor",
        _command(kind="offset", leg=3, size=1e6),
        ("ramped",),
        ("torque_limit",),
    ),
    Fault(
        "command_full",
        "20 N m at all motors: full torque, and to stay",
        _command(kind="offset", size=20.0),
        _STOPPED,
        ("following_error", "crank_speed", "torque_rate"),
    ),
    Fault(
        "command_chatter",
        "4.5 N m more and less, tick by tick",
        _command(kind="chatter", size=4.5),
        ("ramped",),
        ("torque_rate",),
    ),
    Fault(
        "command_offset",
        "0.3 N m too much at one motor, which the integral takes back",
        _command(kind="offset", leg=2, size=0.3),
        _THROUGH,
    ),
    # --- a reference that leads into trouble ---
    Fault(
        "reference_refused",
        "a reference that ends in a parallel singularity, checked",
        {},
        ("refused",),
        drift=(0.0, -1.18, 0.0, 0.0, 0.0, 0.0),
        since=0.0,
    ),
    Fault(
        "to_dead_centre",
        "the reference sinks to the cranks' dead centres, unchecked",
        {"safety.workspace": None},
        ("ramped",),
        ("serial_singularity",),
        drift=(0.0, 0.0, 0.0, 0.0, 0.0, -0.117),
        checked=False,
    ),
    Fault(
        "to_parallel",
        "the reference tilts into a parallel singularity, unchecked",
        {"safety.workspace": None},
        ("ramped",),
        ("parallel_singularity", "serial_singularity"),
        drift=(0.0, -1.18, 0.0, 0.0, 0.0, 0.0),
        checked=False,
    ),
    Fault(
        "out_of_workspace",
        "the reference leaves the workspace, unchecked",
        {},
        ("ramped",),
        ("workspace", "serial_singularity"),
        drift=(0.0, 0.0, 0.0, 0.15, 0.0, 0.0),
        checked=False,
    ),
    Fault(
        "too_fast",
        "the reference swings faster than the cranks may turn",
        {"safety.crank_speed": 2.0},
        ("ramped",),
        ("crank_speed",),
        drift=(0.0, 0.0, 0.0, 0.0, 0.0, 0.09),
        drift_time=0.3,
        checked=False,
    ),
)
"""In the order of the table."""
