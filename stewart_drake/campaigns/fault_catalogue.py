"""The faults of the table."""

from __future__ import annotations

from typing import Any

from stewart_drake.campaigns.fault import AT_ONCE, ONSET, STOPPED, THROUGH, TICK, Fault
from stewart_drake.campaigns.fault_sensors import SENSOR_FAULTS
from stewart_drake.safety import SafetyOptions


def _push(kind: str, **keys: Any) -> dict[str, Any]:
    return {"disturbances": [{"kind": kind, **keys}]}


def _command(**keys: Any) -> dict[str, Any]:
    return {"link": {"faults": [{"time": ONSET, **keys}]}}


def _motor(kind: str, since: float = ONSET, **keys: Any) -> dict[str, Any]:
    return {"motors": {"faults": [{"kind": kind, "leg": 0, "time": since, **keys}]}}


_SILENT = 2 * TICK
"""[s] of `safety.deadline`."""

FAULTS: tuple[Fault, ...] = (
    # --- the world ---
    Fault("push_5N", "5 N sideways, for good", _push("step", wrench=[0, 0, 0, 5, 0, 0], time=ONSET), THROUGH),
    Fault("blow_0.5Ns", "blow of 0.5 N s", _push("impulse", impulse=[0, 0, 0, 0, 0.5, 0], time=ONSET), THROUGH),
    Fault("shaking_5Hz", "sine of 3 N at 5 Hz", _push("sine", wrench=[0, 0, 0, 3, 0, 0], frequency=5), THROUGH),
    Fault(
        "noise_1N",
        "noise of 1 N and 20 N mm rms on each axis, 0.5 to 50 Hz",
        _push("noise", rms=[0.02] * 3 + [1.0] * 3, seed=1),
        THROUGH,
    ),
    Fault(
        "push_150N",
        "150 N sideways: more than the motors can",
        _push("step", wrench=[0, 0, 0, 150, 0, 0], time=ONSET),
        STOPPED,
        ("following_error", "torque_limit"),
    ),
    Fault(
        "payload_0.3kg",
        "0.3 kg, 50 mm off centre, that nobody told the controller of",
        {"plant.payload_mass": 0.3, "plant.payload_position": [0.05, 0, 0.02]},
        THROUGH,
        since=0.0,
    ),
    Fault(
        "payload_1kg",
        "1 kg, as heavy as the platform",
        {"plant.payload_mass": 1.0, "plant.payload_position": [0.03, 0, 0.05]},
        THROUGH,
        since=0.0,
    ),
    # --- the robot is not what the controller believes ---
    Fault(
        "mass_minus_20",
        "model 20 % too light",
        {"model_robot": {"platform_mass": 0.8, "rod_mass": 0.064, "platform_inertia": [0.0024, 0.0024, 0.0048]}},
        THROUGH,
        since=0.0,
    ),
    Fault(
        "rods_plus_1mm",
        "rods 1 mm longer than in the model",
        {"model_robot": {"rod_length": 0.403}},
        THROUGH,
        since=0.0,
        encoders={},
    ),
    Fault("friction", "0.08 N m of dry friction in every motor", {"plant.motor_friction": 0.08}, THROUGH, since=0.0),
    # --- motors ---
    Fault(
        "ripple",
        "torque ripple of 0.02 N m, 12 periods a turn",
        {"motors": {"ripple": 0.02}},
        THROUGH,
        since=0.0,
    ),
    Fault("torque_steps", "torque in steps of 0.01 N m", {"motors": {"resolution": 0.01}}, THROUGH, since=0.0),
    Fault(
        "dead_motor_0",
        "motor 0 without torque",
        {"motors": {"dead": {"leg": 0, "time": ONSET}}},
        STOPPED,
        ("following_error",),
    ),
    Fault(
        "dead_motor_3",
        "motor 3 without torque",
        {"motors": {"dead": {"leg": 3, "time": ONSET}}},
        STOPPED,
        ("following_error",),
    ),
    Fault(
        "broken_rod_2",
        "rod 2 comes off the platform",
        {"plant.broken_rod": {"leg": 2, "time": ONSET}},
        STOPPED,
        ("following_error",),
    ),
    Fault(
        "motor_reversed",
        "motor 0 turns the other way",
        _motor("reversed"),
        STOPPED,
        ("crank_speed", "following_error"),
    ),
    Fault(
        "motor_wired_reversed",
        "motor 0 turns the other way, from the start",
        _motor("reversed", since=0.0),
        STOPPED,
        ("crank_speed", "following_error"),
        since=0.0,
    ),
    Fault(
        "motors_swapped",
        "motors 0 and 3 give each other's torque; while both ask for the same nothing tells",
        _motor("swapped", other=3),
        STOPPED,
        ("crank_speed", "following_error"),
    ),
    *SENSOR_FAULTS,
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
        within=_SILENT,
    ),
    Fault("late_half", "every other tick is a period late", {"link": {"late_probability": 0.5}}, THROUGH, since=0.0),
    Fault("delay_3", "every command 3 ticks late", {"command_delay": 3}, THROUGH, since=0.0),
    Fault(
        "controller_hangs",
        "no command any more",
        {"link": {"stop_time": ONSET}},
        ("ramped",),
        ("deadline",),
        within=_SILENT,
    ),
    Fault(
        "command_nan_10ms",
        "NaN for 10 ms",
        _command(kind="nan", leg=3, duration=0.01),
        ("held",),
        ("command_not_finite",),
        within=AT_ONCE,
    ),
    Fault("command_nan", "NaN", _command(kind="nan", leg=3), ("ramped",), ("command_not_finite",), within=AT_ONCE),
    Fault(
        "command_inf",
        "infinite torque",
        _command(kind="inf", leg=3),
        ("ramped",),
        ("command_not_finite",),
        within=AT_ONCE,
    ),
    Fault(
        "command_1e6",
        "1e6 N m at one motor",
        _command(kind="offset", leg=3, size=1e6),
        ("ramped",),
        ("torque_limit",),
        within=AT_ONCE,
    ),
    Fault(
        "command_full",
        "20 N m at all motors: full torque, and to stay",
        _command(kind="offset", size=20.0),
        STOPPED,
        ("following_error", "crank_speed", "torque_rate"),
        within=SafetyOptions.torque_limit_time,
    ),
    Fault(
        "command_chatter",
        "4.5 N m more and less, tick by tick",
        _command(kind="chatter", size=4.5),
        ("ramped",),
        ("torque_rate",),
        within=SafetyOptions.torque_rate_time,
    ),
    Fault(
        "command_offset",
        "0.3 N m too much at one motor, which the integral takes back",
        _command(kind="offset", leg=2, size=0.3),
        THROUGH,
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
