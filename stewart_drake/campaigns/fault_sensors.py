"""Faults of the table: sensors."""

from __future__ import annotations

from typing import Any

from stewart_drake.campaigns.fault import AT_ONCE, MOVING, ONSET, STOPPED, THROUGH, TICK, Fault
from stewart_drake.hardware.estimator import EncoderOptions

_BLIND = EncoderOptions.hold_ticks * TICK
"""[s] for which the estimator bridges readings that it cannot believe."""


def _encoder(**keys: Any) -> dict[str, Any]:
    return {"faults": [{"time": ONSET, "leg": 1, **keys}]}


def _pose(**keys: Any) -> dict[str, Any]:
    return {"sensors": {"kind": "ideal", "faults": [{"time": ONSET, **keys}]}}


SENSOR_FAULTS: tuple[Fault, ...] = (
    Fault("encoder_noise", "noise of 0.1 mrad", {}, THROUGH, since=0.0, encoders={"noise": 1e-4, "noise_seed": 1}),
    Fault("encoder_12bit", "encoders of 12 bits", {}, THROUGH, since=0.0, encoders={"resolution_bits": 12}),
    Fault(
        "homing_2mrad",
        "encoder 0 homed 2 mrad wrong",
        {},
        THROUGH,
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
        THROUGH,
        encoders=_encoder(kind="nan", duration=0.005),
    ),
    Fault(
        "encoder_nan_20ms",
        "encoder 1 says NaN for 20 ms",
        {},
        ("held",),
        ("sensor_failed",),
        encoders=_encoder(kind="nan", duration=0.02),
        within=_BLIND,
    ),
    Fault(
        "encoder_nan",
        "encoder 1 says NaN",
        {},
        ("ended",),
        ("sensor_failed",),
        encoders=_encoder(kind="nan"),
        within=_BLIND,
    ),
    Fault(
        "encoder_slips",
        "encoder 1 off by 5 mrad from one tick to the next",
        {},
        THROUGH,
        encoders=_encoder(kind="jump", size=0.005),
    ),
    Fault(
        "encoder_jumps",
        "encoder 1 off by 0.2 rad",
        {},
        STOPPED,
        ("sensor_failed", "crank_speed"),
        encoders=_encoder(kind="jump", size=0.2),
        within=_BLIND,
    ),
    Fault(
        "encoder_drifts",
        "encoder 1 drifts by 1 mrad/s: whatever six readings for six freedoms say fits, and the robot follows; no "
        "monitor sees that, at any size",
        {},
        THROUGH,
        encoders=_encoder(kind="drift", size=0.001),
    ),
    Fault(
        "encoder_drifts_far",
        "encoder 1 drifts by 0.3 rad/s: as little to be seen, and out of bounds",
        {},
        ("unnoticed",),
        encoders=_encoder(kind="drift", size=0.3),
    ),
    Fault(
        "encoder_reversed",
        "encoder 1 counts backwards",
        {},
        STOPPED,
        MOVING,
        encoders=_encoder(kind="reversed"),
    ),
    Fault(
        "encoder_wired_reversed",
        "encoder 1 counts backwards, from the start",
        {},
        STOPPED,
        MOVING,
        since=0.0,
        encoders=_encoder(kind="reversed", time=0.0),
    ),
    Fault(
        "encoder_inverted",
        "encoder 1 says the negative angle",
        {},
        STOPPED,
        ("sensor_failed", "crank_speed"),
        encoders=_encoder(kind="inverted"),
        within=_BLIND,
    ),
    Fault(
        "encoders_swapped",
        "encoders 1 and 4 say each other's angle; at rest at home, where those are the same, nothing tells until the "
        "loop has swung up",
        {},
        STOPPED,
        ("sensor_failed", *MOVING),
        encoders=_encoder(kind="swapped", other=4),
    ),
    Fault(
        "encoder_late_5ms",
        "encoder 1 says what it read 5 ms ago",
        {},
        THROUGH,
        encoders=_encoder(kind="late", delay=0.005),
    ),
    Fault(
        "encoder_late_20ms",
        "encoder 1 says what it read 20 ms ago; at rest only the swing that the loop builds up tells",
        {},
        STOPPED,
        MOVING,
        encoders=_encoder(kind="late", delay=0.02),
    ),
    Fault(
        "encoders_late_2ms",
        "all encoders say what they read 2 ms ago",
        {},
        THROUGH,
        encoders=_encoder(kind="late", leg=None, delay=0.002),
    ),
    Fault(
        "encoders_late_20ms",
        "all encoders say what they read 20 ms ago; at rest only the swing that the loop builds up tells, and what is "
        "measured of it is late too: the robot is out of bounds before a monitor sees it",
        {},
        STOPPED,
        MOVING,
        encoders=_encoder(kind="late", leg=None, delay=0.02),
    ),
    Fault(
        "pose_nan", "pose sensor says NaN", _pose(kind="nan"), ("ended",), ("measurement_not_finite",), within=AT_ONCE
    ),
    Fault(
        "pose_nan_10ms",
        "pose sensor says NaN for 10 ms",
        _pose(kind="nan", duration=0.01),
        ("held",),
        ("measurement_not_finite",),
        within=AT_ONCE,
    ),
    Fault(
        "pose_frozen",
        "pose sensor repeats itself",
        _pose(kind="freeze"),
        ("ridden through", "ended"),
        ("sensor_failed",),
    ),
    Fault(
        "pose_late_20ms",
        "pose sensor says what it read 20 ms ago; at rest only the swing that the loop builds up tells",
        _pose(kind="late", delay=0.02),
        STOPPED,
        MOVING,
    ),
)
"""In the order of the table."""
