"""Table of the signals of a log: columns, units, text, title, and the loop's signal that they come from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from stewart_drake.base.tables import AXES
from stewart_drake.control.policy import NAMES
from stewart_drake.plant.plant_options import ANGLES, BALL, POSE, RATE

LEG_NAMES = tuple(map(str, range(6)))
ALL = slice(None)
DISPLAY_UNITS = ("deg",) * 3 + ("mm",) * 3  # Units of a pose in tables and figures.
SCALES = np.array([180.0 / np.pi] * 3 + [1e3] * 3)  # Factors from [rad, m] to `DISPLAY_UNITS`.


class Signal(NamedTuple):
    """A signal of a log."""

    components: tuple[str, ...]  # Empty for a scalar.
    units: tuple[str, ...]
    text: str
    source: str | None = None  # Name of the loop's signal; None for the same name.
    part: slice = ALL  # Columns of the source.
    title: str = ""  # Title of a figure.

    def of(self, values: np.ndarray) -> np.ndarray | None:
        """Values (n, k) of the signal from those of its source; None if the number of columns differs."""
        columns = values if values.ndim == 1 else values[:, self.part]
        return columns if not self.components or columns.shape[1] == len(self.components) else None


def _axes(angle: str, length: str, text: str, source: str | None = None, part: slice = ALL, title: str = "") -> Signal:
    return Signal(AXES, (angle,) * 3 + (length,) * 3, text, source, part, title)


def _legs(unit: str, text: str, source: str | None = None, part: slice = ALL, title: str = "") -> Signal:
    return Signal(LEG_NAMES, (unit,) * 6, f"{text}, by leg 0..5", source, part, title)


def _numbers(components: tuple[str, ...], text: str, source: str | None = None, title: str = "") -> Signal:
    return Signal(components, ("1",) * len(components), text, source, title=title)


def _on_plate(unit: str, text: str, source: str | None = None, first: int | None = None) -> Signal:
    start = 0 if first is None else first + (BALL.start if source == "measured" else 0)
    return Signal(("x", "y"), (unit,) * 2, text, source, ALL if first is None else slice(start, start + 2))


_DENSITY = (*(f"error_{axis}" for axis in AXES), *(f"torque_{leg}" for leg in LEG_NAMES))
_OUTSIDE = "decades of a tuner's setting above the base, and the distance of its inputs from their training range"
_LEARNT = ("mass", "delay", *(f"{what}_{leg}" for what in ("drive", "viscous", "coulomb") for leg in LEG_NAMES))
_LEARNT_UNITS = ("kg", "s", *("1",) * 6, *("N m s/rad",) * 6, *("N m",) * 6)
_PLACE = (*"xyz", *(f"{axis}_half_width" for axis in "xyz"))
_BASE = (*(f"{name}_{axis}" for name in ("force", "rate", "acceleration") for axis in "xyz"), "roll", "pitch", "yaw")
_BASE_UNITS = ("m/s^2",) * 3 + ("rad/s",) * 3 + ("rad/s^2",) * 3 + ("rad",) * 3
_WRENCH = ("mx", "my", "mz", "fx", "fy", "fz")
_IMU = tuple(f"{what}_{axis}" for what in ("rate", "force") for axis in "xyz")
_JOINTS = ("viscous", "dry", "viscous_half_width", "dry_half_width")
SIGNALS: Mapping[str, Signal] = {
    "time": Signal((), ("s",), "simulated time"),
    "pose": _axes("rad", "m", "pose of the platform, P in B; measured on a machine", "measured", POSE),
    "pose_rate": _axes("rad/s", "m/s", "Euler rates and velocity of the platform", "measured", RATE),
    "reference": _axes("rad", "m", "reference pose", "reference", POSE),
    "reference_rate": _axes("rad/s", "m/s", "rate of the reference", "reference", RATE),
    "reference_acceleration": _axes("rad/s^2", "m/s^2", "acceleration of the reference", "reference", slice(12, 18)),
    "error": _axes("rad", "m", "pose minus reference at the latest tick, or when its command acts", title="Error"),
    "integral": _axes("rad s", "m s", "integral state z after the latest tick", title="Integral state"),
    "torque": _legs("N m", "torque commanded by the controller, about the motor axis", title="commanded"),
    "commanded_angle": _legs("rad", "angle commanded to motors with position control"),
    "commanded_current": _legs("A", "current commanded to motors with current control"),
    "torque_applied": _legs("N m", "torque at the motors, delayed and within their limit", title="applied"),
    "crank_angle": _legs("rad", "true angle of a simulated crank, from the horizontal", "measured", ANGLES),
    "reading": _legs("rad", "angle of a crank as read by the controller; NaN without a reading"),
    "imu": Signal(
        _IMU, ("rad/s",) * 3 + ("m/s^2",) * 3, "rates and specific force of the inertial sensor; NaN if not new"
    ),
    "weights": _numbers(("omega_q", "omega_r"), "weights in use"),
    "block_weights": _numbers(
        ("q_pose", "q_rate", "q_integral", "r"), "block weights in use, in place of `weights`", "weights"
    ),
    "setting": _numbers((*NAMES, "outside"), _OUTSIDE, title="Tuner"),
    "density": _numbers(_DENSITY, "density features"),
    "lateness": Signal((), ("s",), "lateness of a tick on a machine"),
    "reading_age": Signal((), ("s",), "age of a machine's reading when it was used"),
    "loop_gap": _legs("m", "distance from rod end to platform joint"),
    "measured_pose": _axes("rad", "m", "measured or estimated pose, if not the true one", "measurement", POSE),
    "measured_pose_rate": _axes("rad/s", "m/s", "rate of `measured_pose`", "measurement", RATE),
    "pose_reading": _axes("rad", "m", "pose as read from a sensor", part=POSE),
    "pose_rate_reading": _axes("rad/s", "m/s", "rate of `pose_reading`", "pose_reading", RATE),
    "innovation": _legs("rad", "readings minus the observer's predictions"),
    "disturbance": Signal(_WRENCH, ("N m",) * 3 + ("N",) * 3, "external wrench on the platform"),
    "ball": _on_plate("m", "place of the ball on the plate, its centre in P", "measured", 0),
    "ball_velocity": _on_plate("m/s", "velocity of the ball on the plate", "measured", 2),
    "ball_reading": _on_plate("m", "place of the ball as read; NaN if not new"),
    "ball_target": _on_plate("m", "target of the ball at the time for which a tilt is decided", "ball_target", 0),
    "ball_estimate": _on_plate("m", "estimated place of the ball at that time", "ball_estimate", 0),
    "base_motion": Signal(
        _BASE, _BASE_UNITS, "motion of the base, as an inertial unit on it reads it, and its attitude"
    ),
    "lost_encoder": _numbers(("leg",), "leg whose encoder the inertial sensor replaces; -1 for none"),
    "safety": _numbers(("level", "monitor", "leg"), "indices in safety.LEVELS and safety.MONITORS; leg or -1"),
    "learnt": Signal(_LEARNT, _LEARNT_UNITS, "learnt parameters of head and motors: see docs/adaptation.md"),
    "learnt_half_width": Signal(_LEARNT, _LEARNT_UNITS, "half widths of the 95 % intervals of `learnt`"),
    "learnt_center_of_mass": Signal(_PLACE, ("m",) * 6, "learnt centre of mass of the head, in the tool's frame or P"),
    "learnt_joints": Signal(_JOINTS, ("N m s/rad", "N m") * 2, "learnt friction of the rods' ball joints"),
    "plant_state": Signal((), (), "positions and velocities of the MultibodyPlant"),
}
"""All signals of logs; a log has those of its scenario. `block_weights` replace `weights`. A tuner of settings gives
`setting`, an observer `innovation`; the measured pose is logged if encoders, an observer or a faulty sensor make it
differ from the true one. `plant_state` has one column per entry of the plant's state, named by Drake."""


def signals_of(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Signals of a log by name, from the values (n, k) of the loop's signals."""
    sources = {name: signal.source or name for name, signal in SIGNALS.items()}
    signals = {name: SIGNALS[name].of(values[source]) for name, source in sources.items() if source in values}
    return {name: columns for name, columns in signals.items() if columns is not None}
