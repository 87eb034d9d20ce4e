"""A run of the fault table, and its row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from typing import Any

import numpy as np

from stewart_drake.campaigns.fault import BY_NAME, FAULTS, MOTIONS, Fault, Reaction
from stewart_drake.campaigns.one_run import simulate
from stewart_drake.errors import ConfigurationError, UnreachablePoseError
from stewart_drake.hardware.motors import HoldableLoad, holdable_load
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metric_table import Column, Kind
from stewart_drake.logs.tally import pose_distance
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.safety import RAMP
from stewart_drake.scenario import Scenario


def _column(unit: str, text: str, kind: Kind = "number", **default: Any) -> Any:
    return field(metadata={"unit": unit, "text": text, "kind": kind}, **({"default": None} | default))


@dataclass(frozen=True)
class FaultRow:
    """A row; see `COLUMNS` for what each column says."""

    fault: str = _column("", "name in fault.FAULTS", "text", default=MISSING)
    motion: str = _column("", "name in fault.MOTIONS", "text", default=MISSING)
    reaction: str = _column(
        "", "see fault.Reaction; broke where the run ended without the safety layer", "text", default=MISSING
    )
    safety_monitor: str | None = _column("", "monitor that tripped first, null for none", "text")
    safety_cause: str | None = _column("", "of the trip, where an estimator or controller failed", "text")
    safety_leg: int | None = _column("", "leg 0..5 to which the trip belongs", "whole")
    latency_ms: float | None = _column("ms", "from the fault to the trip")
    status: str | None = _column("", "of the run", "text")
    reason: str | None = _column("", "stable name of what ended it", "text")
    end_time: float | None = _column("s", "simulated time reached")
    peak_error_deg: float | None = _column(
        "deg", "largest angle from the reference after the fault, while the controller was in charge"
    )
    peak_error_mm: float | None = _column("mm", "largest distance likewise")
    travel_deg: float | None = _column("deg", "largest angle turned after the safety layer took over")
    travel_mm: float | None = _column("mm", "largest distance moved likewise")
    peak_torque: float | None = _column("N m", "largest torque given to a motor after the fault, within its limit")
    holds_weight: bool | None = _column(
        "", "whether the motors that are left carry the robot's weight at rest; null without a dead motor", "flag"
    )
    support_newton: float | None = _column("N", "smallest outside force with which they would")
    force_newton: float | None = _column("N", "largest outside force that they hold; null where not even the weight")
    moment_newton_metre: float | None = _column("N m", "largest outside moment likewise")
    message: str | None = _column("", "one line on it", "text")
    warnings: str | None = _column("", "names of the warnings, null for none", "text")

    def plain(self) -> dict[str, Any]:
        """Column -> value."""
        return asdict(self)

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> FaultRow:
        """Inverse of `plain`; other keys are left aside."""
        return cls(**{each.name: values[each.name] for each in fields(cls)})


COLUMNS = tuple(Column(each.name, **each.metadata) for each in fields(FaultRow))
"""Columns of the table."""

_WORST: dict[str, Reaction] = {"hold": "held", "ramp": "ramped", "safe_hold": "ramped", "end": "ended"}


def fault_row(fault: Fault, motion: str) -> FaultRow:
    """Runs a fault during a motion.

    Args:
        fault: Of `fault.FAULTS`, or one of the caller's.
        motion: Of `fault.MOTIONS`.
    """
    try:
        log = simulate(fault.scenario(motion), check=fault.checked)
    except ConfigurationError as error:
        return FaultRow(fault.name, motion, "refused", reason=error.reason, message=str(error))
    return measured_row(fault, motion, log)


def named_row(name: str, motion: str) -> FaultRow:
    """`fault_row` by the fault's name; for workers."""
    return fault_row(BY_NAME[name], motion)


def measured_row(fault: Fault, motion: str, log: SimulationLog) -> FaultRow:
    """The row of a run that is done."""
    trip = log.safety
    # Rows at which a log stands are those of the safety layer's ticks.
    after = log.time >= fault.since - 1e-9
    taken = log["safety"][:, 0] >= RAMP if "safety" in log.signals else np.zeros(len(log.time), dtype=bool)
    turned, moved = pose_distance(log["pose"], log["reference"])
    charge = after & ~taken
    left = log["pose"][int(taken.argmax()) if taken.any() else len(taken) :]
    angle, way = pose_distance(left, left[:1])
    if trip is not None:
        reaction: str = _WORST[trip["worst"]]
        if log.status == "failed":
            # The layer gave up, or the plant broke under it: a crank that has lost its rod may spin up to that.
            reaction = "ended"
    elif log.status == "failed":
        reaction = "broke"
    else:
        allowed = log.scenario.safety and log.scenario.safety.following_error
        far = allowed and (turned[charge].max() > allowed[0] or moved[charge].max() > allowed[1])
        reaction = "unnoticed" if far else "ridden through"
    load = _holdable(log.scenario, log)
    return FaultRow(
        fault.name,
        motion,
        reaction,
        safety_monitor=None if trip is None else trip["monitor"],
        safety_cause=None if trip is None else trip["cause"],
        safety_leg=None if trip is None else trip["leg"],
        latency_ms=None if trip is None else 1e3 * (trip["time"] - fault.since),
        status=log.status,
        reason=log.reason,
        end_time=log.end_time,
        peak_error_deg=_largest(np.degrees(turned[charge])),
        peak_error_mm=_largest(1e3 * moved[charge]),
        travel_deg=_largest(np.degrees(angle)),
        travel_mm=_largest(1e3 * way),
        peak_torque=_largest(np.abs(log["torque_applied"][after])),
        holds_weight=None if load is None else load.weight,
        support_newton=None if load is None else load.support,
        force_newton=None if load is None else load.force,
        moment_newton_metre=None if load is None else load.moment,
        message=log.message,
        warnings=", ".join(each["name"] for each in log.warnings) or None,
    )


def _largest(values: np.ndarray) -> float | None:
    return float(values.max()) if values.size else None


def all_rows() -> list[tuple[str, str]]:
    """Fault and motion of each row, in the order of the table."""
    return [(fault.name, motion) for fault in FAULTS for motion in MOTIONS]


def _holdable(scenario: Scenario, log: SimulationLog) -> HoldableLoad | None:
    """What five motors hold where the platform stood as the sixth died."""
    dead = scenario.motors.dead
    if dead is None:
        return None
    row = min(int(np.searchsorted(log.time, dead.time - 1e-9)), len(log.time) - 1)
    pose, robot = log["pose"][row], scenario.robot
    try:
        weight = static_torque(robot, pose, scenario.gravity)
        return holdable_load(weight, twist_jacobian(robot, pose), robot.effort_limit, dead.leg)
    except (UnreachablePoseError, np.linalg.LinAlgError):
        return None
