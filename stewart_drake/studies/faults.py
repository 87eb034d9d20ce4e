"""The fault table: every fault of `faults.yaml` during every motion, and the reaction of the safety layer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import combinations, product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Flag, NotNegative, Section, Text, Vector6
from stewart_drake.base.errors import StewartDrakeError, UnreachablePoseError
from stewart_drake.base.families import given_keys
from stewart_drake.base.markdown import TextTable
from stewart_drake.base.yaml_files import parse_yaml
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import Column
from stewart_drake.logs.metrics import columns as run_columns
from stewart_drake.logs.outcomes import pose_distance
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.plant.closed_form import ClosedForm
from stewart_drake.plant.plant_options import CRANK_RATES, POSE, MechanismOptions
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.safety import RAMP
from stewart_drake.scenario.scenario import Scenario, load_scenario
from stewart_drake.studies.experiment import Experiment, Keys, Tables, pivot, trial_of
from stewart_drake.studies.robots import scale_to_robot
from stewart_drake.studies.runs import Row, measure_all, simulate, simulate_unchecked

Reaction = Literal["refused", "ridden through", "held", "ramped", "ended", "unnoticed"]
"""Reaction of the safety layer to a fault, explained in `REACTIONS`."""
REACTIONS: Mapping[str, str] = {
    "refused": "In the table of `faults`: the run was refused before it began.",
    "ridden through": "In the table of `faults`: no monitor tripped, and none had to.",
    "unnoticed": "In the table of `faults`: no monitor tripped, but the true pose went farther from the reference than "
    "`safety.following_error` allows.",
    "held": "In the table of `faults`: the last good command bridged the fault.",
    "ramped": "In the table of `faults`: the safety layer brought the robot to a safe hold, then the run ended.",
    "ended": "In the table of `faults`: the run ended without a safe hold, since the robot could not be held. Brakes "
    "are all that is left.",
}

_FILE = parse_yaml(Path(__file__).with_name("faults.yaml").read_text(encoding="utf-8"), "faults.yaml")
ONSET: float = _FILE["onset"]  # [s]
DURATION: float = _FILE["duration"]  # [s]
MOTIONS: Mapping[str, Mapping[str, object]] = _FILE["motions"]  # Name -> keys of `reference`.


class FaultCase(Section):
    name: Text
    text: Text
    changes: Keys = Field(default_factory=dict)
    """Scenario key -> value. The motion replaces a `reference` among them."""
    expected: tuple[Reaction, ...] = ("ridden through",)
    monitors: tuple[Text, ...] = ()
    drift: Vector6 | None = None
    """[rad, m] drift of the reference; null for none."""
    drift_time: NotNegative = 0.8
    """[s] duration of the drift."""
    checked: Flag = True
    """Whether the motion is checked before the run, as in a user's run."""
    since: NotNegative = ONSET
    """[s] onset of the fault; 0 for a fault from the start."""
    encoders: Keys | None = None
    """Keys of `sensors`, for a loop with encoders and a command delay of one tick; null for ideal sensors."""
    imu: Keys | None = None
    """Keys of `sensors.imu`, for a robot that has one: other robots do not have this fault."""
    within: NotNegative | None = None
    """[s] largest latency of the trip, if the limits of the safety layer determine it; null if it depends on motion
    and robot."""

    def in_motion(self, motion: str, base: Scenario) -> dict[str, object]:
        """Scenario key -> value for this fault during a motion of `MOTIONS`, scaled to the robot of `base`."""
        reference = scale_to_robot({"reference": MOTIONS[motion]}, base)["reference"]
        if self.drift is not None:
            home = base.robot.home_pose.tolist()
            away = [a + b for a, b in zip(home, LENGTH.value(self.drift, base.robot), strict=True)]
            path = {"kind": "minimum_jerk", "poses": [home, away], "durations": [self.drift_time], "dwell": [ONSET]}
            reference = {"kind": "sum", "parts": [reference, path]}
        changes = {"reference": reference, **scale_to_robot(self.changes, base)}
        if self.encoders is not None or self.imu is not None:
            # A real drive has encoders and commands that are a tick late.
            imu = None if base.sensors.imu is None else {**base.sensors.imu.to_dict(), **(self.imu or {})}
            sensors = {"kind": "encoders", **(self.encoders or {}), "imu": imu}
            changes |= {"sensors": sensors, "command_delay": 1}
        return changes


def base(robot: str | None = None, overrides: Sequence[str] = (), trust_code: bool = False) -> Scenario:
    """The exact-model LQI of `exact_fig7` with the safety layer, another robot and `key=value` overrides."""
    named = () if robot is None else (f"robot={robot}",)
    loaded = load_scenario("exact_fig7", (*named, *overrides), trust_code)
    return loaded.replace({"duration": DURATION, "safety": {}})


FAULTS = {name: FaultCase.from_dict({"name": name, **keys}, f"faults.{name}") for name, keys in _FILE["faults"].items()}
_REACTION_OF_LEVEL = {"hold": "held", "ramp": "ramped", "safe_hold": "ramped", "end": "ended"}
_HOLDABLE = (
    Column("holds_weight", "", "whether the other motors carry the robot at rest; null without a dead motor", "flag"),
    Column("support_newton", "N", "smallest external force with which they do"),
    Column("force_newton", "N", "largest external force that they hold; null if they cannot carry the weight"),
    Column("moment_newton_metre", "N m", "largest external moment that they hold; null likewise"),
)
COLUMNS = (
    Column("fault", "", "name of the fault", "text"),
    Column("motion", "", "name of the motion", "text"),
    Column(
        "reaction",
        "",
        "see `REACTIONS`; broke: the run ended without the safety layer; the status, if there is no log",
        "text",
    ),
    *run_columns(),
    Column("safety_cause", "", "cause of the trip, if an estimator or controller failed", "text"),
    Column("safety_leg", "", "leg 0..5 of the trip", "integer"),
    Column("latency_ms", "ms", "time from the fault to the trip"),
    Column("travel_deg", "deg", "rotation error, see `travel`"),
    Column("travel_mm", "mm", "position error, see `travel`"),
    Column("stop_deg", "deg", "rotation error after a plain stop at the onset, with working sensors"),
    Column("stop_mm", "mm", "position error after such a stop"),
    Column("peak_torque", "N m", "largest motor torque after the fault, within its limit"),
    *_HOLDABLE,
)


class FaultStudy(Experiment):
    def tables(self, rows: list[Row]) -> Tables:
        reactions = ("refused" if row["status"] == "rejected" else row["status"] for row in rows)
        return super().tables([{"reaction": name, **row} for name, row in zip(reactions, rows, strict=True)])

    def sheet(self, rows: Sequence[Row]) -> TextTable:
        """The table, with notes on faults that were scaled to the robot."""
        table, faults = sheet(rows), (FAULTS[name] for name in dict.fromkeys(row["fault"] for row in rows))
        sizes = {fault.name: _sizes(fault.changes, scale_to_robot(fault.changes, self.base)) for fault in faults}
        notes = [f"{name} on this robot: {', '.join(texts)}" for name, texts in sizes.items() if texts]
        return table._replace(notes=[*table.notes, *notes])

    def page(self, rows: Mapping[str, list[Row]]) -> str:
        table, lines = rows["faults"], []
        for fault in (FAULTS[name] for name in dict.fromkeys(row["fault"] for row in table)):
            bound = "" if fault.within is None else f" (a monitor trips within {1e3 * fault.within:.0f} ms)"
            lines.append(f"- `{fault.name}`: {fault.text}{bound}")
        return PAGE.format(
            runs=len(table),
            duration=DURATION,
            onset=ONSET,
            table=self.sheet(table).markdown(),
            held="\n".join(f"- {line}" for line in holdable_lines(table)),
            faults="\n".join(lines),
        )


def _sizes(value: Any, scaled: Any, key: str = "") -> list[str]:
    """Keys and values of the numbers that were changed by scaling."""
    if isinstance(value, Mapping):
        return [text for name in value for text in _sizes(value[name], scaled[name], f"{key}.{name}".strip("."))]
    if isinstance(value, list):
        return [text for k, item in enumerate(value) for text in _sizes(item, scaled[k], f"{key}[{k}]")]
    return [] if scaled == value else [f"{key} {scaled:.3g}"]


def fault_study(
    quick: bool = False,
    robot: str | None = None,
    overrides: Sequence[str] = (),
    pairs: Sequence[tuple[FaultCase, str]] = tuple(product(FAULTS.values(), MOTIONS)),
    trust_code: bool = False,
) -> FaultStudy:
    start = base(robot, overrides, trust_code)
    given, trials, cases = given_keys(start), [], []
    pairs = [(fault, motion) for fault, motion in pairs if fault.imu is None or start.sensors.imu is not None]
    for index, (fault, motion) in enumerate(pairs):
        changes, labels = fault.in_motion(motion, start), {"fault": fault.name, "motion": motion}
        cases.append({**fault.to_dict(), **changes})
        function, measure = simulate if fault.checked else simulate_unchecked, partial(measure_fault, fault=fault)
        if motion == "hold" or not quick:
            name = f"{fault.name} {motion}"
            trials.append(trial_of(given, index, name, changes, labels, measure=measure, function=function))
    return FaultStudy(
        kind="faults",
        name="faults",
        base=start,
        trials=trials,
        columns=COLUMNS,
        work={"scenario": start.to_dict(), "faults": cases},
        variants=(start,),
    )


def measure_fault(log: SimulationLog, fault: FaultCase) -> Row:
    trip = log.safety or dict.fromkeys(("cause", "leg", "time"))
    torque = np.abs(log["torque_applied"][log.time >= fault.since - 1e-9])
    if log.safety is not None:
        # The plant may fail while the layer acts: a crank without a rod spins up.
        reaction = "ended" if log.status == "failed" else _REACTION_OF_LEVEL[log.safety["worst"]]
    elif log.status == "failed":
        reaction = "broke"
    else:
        allowed = log.scenario.safety and log.scenario.safety.following_error
        far = allowed and (np.array(travel(log, fault.since)) > allowed).any()
        reaction = "unnoticed" if far else "ridden through"
    return {
        **measure_all(log),
        "reaction": reaction,
        "safety_cause": trip["cause"],
        "safety_leg": trip["leg"],
        "latency_ms": None if trip["time"] is None else 1e3 * (trip["time"] - fault.since),
        **_travels(log, fault.since),
        "peak_torque": float(torque.max()) if torque.size else None,
        **_held(log),
    }


BRAKE_DELAY = 0.05  # [s] until brakes are closed, assumed.
REST_SPEED = 1e-3  # [rad/s] of a crank; slower is at rest.


def travel(log: SimulationLog, since: float) -> tuple[float, float]:
    """Largest error of the true pose [rad, m] from the time `since` [s] until the robot is at rest.

    The error is relative to the reference, which stays constant once the safety layer has taken over; a robot that goes
    on with five encoders follows it to rest. If the safety layer or the plant ended the run, brakes close then: dry
    friction as large as the motor's limit. Until they are closed the motors hold, or are off if the layer gave up.
    """
    pose, desired = log["pose"], log["reference"].copy()
    taken = log["safety"][:, 0] >= RAMP if "safety" in log.signals else np.zeros(len(pose), dtype=bool)
    if "lost_encoder" in log.signals:
        taken &= log["lost_encoder"][:, 0] < 0.0
    if taken.any():
        desired[taken] = desired[int(taken.argmax())]
    if log.status in ("stopped", "failed"):
        braked = _braked(log)
        desired = np.concatenate([desired, np.tile(desired[-1], (len(braked), 1))])
        pose = np.concatenate([pose, braked])
    counted = np.append(log.time, np.full(len(pose) - len(log.time), np.inf)) >= since - 1e-9
    turned, moved = pose_distance(pose[counted], desired[counted])
    return float(turned.max(initial=0.0)), float(moved.max(initial=0.0))


def _braked(log: SimulationLog) -> np.ndarray:
    """Poses (n, 6) after the end of a run, with motors off, until brakes have stopped the robot."""
    scenario, step, robot, poses = log.scenario, log.scenario.plant.time_step, log.scenario.robot, []
    options = scenario.plant
    if not isinstance(options, MechanismOptions):
        return np.empty((0, 6))
    open_for = 0 if log.status == "stopped" else round(BRAKE_DELAY / step)
    variants = options, options.braked(robot)
    plant, braked = (ClosedForm(robot, variant, scenario.gravity_in_base) for variant in variants)
    zero = np.zeros(6)
    # Poses end at a singularity.
    with suppress(StewartDrakeError):
        measured = plant.initial(log["pose"][-1], log["pose_rate"][-1])
        for tick in range(open_for + round(0.5 / step)):
            if tick == open_for:
                measured, plant = braked.restore(plant.save()), braked
            if tick >= open_for and (np.abs(measured[CRANK_RATES]) < REST_SPEED).all():
                break
            measured = plant.step(zero, zero)
            poses.append(measured[POSE].copy())
    return np.array(poses).reshape(-1, 6)


def stopped_at(scenario: Scenario, onset: float) -> Scenario:
    """The same run with working sensors and a plain stop at `onset` [s], by a missing command that is not held."""
    changes = {"link": {"faults": [{"kind": "nan", "time": onset}]}, "safety.hold_ticks": 0}
    return scenario.replace({**changes, "sensors.faults": []})


def _travels(log: SimulationLog, since: float) -> Row:
    stop = simulate_unchecked(stopped_at(log.scenario, since))
    ends = np.array([travel(log, since), travel(stop, since)]) * (np.degrees(1.0), 1e3)
    return dict(zip(("travel_deg", "travel_mm", "stop_deg", "stop_mm"), ends.ravel().tolist(), strict=True))


def _held(log: SimulationLog) -> Row:
    scenario, dead = log.scenario, log.scenario.motors.dead
    if dead is None:
        return {}
    row = min(int(np.searchsorted(log.time, dead.time - 1e-9)), len(log.time) - 1)
    pose, robot = log["pose"][row], scenario.robot
    shares = robot.effort_shares
    try:
        weight, jacobian = static_torque(robot, pose, scenario.gravity_in_base), twist_jacobian(robot, pose)
        # Torques as shares of the motors' limits.
        load = holdable_load(weight / shares, shares[:, None] * jacobian, robot.effort_limit, dead.leg)
    except (UnreachablePoseError, np.linalg.LinAlgError):
        return {}
    return dict(zip((column.name for column in _HOLDABLE), load, strict=True))


def holdable_load(
    weight: np.ndarray, jacobian: np.ndarray, limit: float, dead: int
) -> tuple[bool, float, float | None, float | None]:
    """Whether five motors hold G = `weight` (6,) [N m] at rest, and which external loads they hold.

    At rest T = G - J^-T w for an external wrench w on the platform, J = d(theta)/d(twist) (6, 6), and T must vanish at
    the dead motor, so loads lie in a plane. `limit` [N m] is that of every motor.

    Returns:
        Whether they hold the weight alone; [N] the smallest force at P with which they do, infinite if there is none;
        [N] largest force at P and [N m] largest moment that they hold, None if the weight alone is too much.
    """
    by_moment, by_force = np.split(-np.linalg.inv(jacobian.T), 2, axis=1)
    largest = limit * (1.0 + 1e-9)

    legs = np.array([(dead, *pair) for pair in combinations([leg for leg in range(6) if leg != dead], 2)])
    bounds = limit * np.array([(0, *signs) for signs in product((1, -1), repeat=2)])

    def sizes(by_load: np.ndarray) -> np.ndarray:
        needed = bounds - weight[legs][:, None]
        loads = (needed @ np.linalg.pinv(by_load[legs]).swapaxes(1, 2)).reshape(-1, 3)
        torque = weight + loads @ by_load.T
        holds = (np.abs(torque[:, dead]) < 1e-9 * limit) & (np.abs(torque) <= largest).all(axis=1)
        return np.linalg.norm(loads[holds], axis=1)

    if abs(weight[dead]) < 1e-9 * limit and bool((np.abs(weight) <= limit).all()):
        return True, 0.0, float(sizes(by_force).max()), float(sizes(by_moment).max())
    # The smallest force in the polygon: the nearest in its plane, or else one of its corners.
    normal = by_force[dead]
    load = -weight[dead] * normal / (normal @ normal)
    if (np.abs(weight + by_force @ load) <= largest).all():
        return False, float(np.linalg.norm(load)), None, None
    return False, float(sizes(by_force).min(initial=np.inf)), None, None


PAGE = """# Fault table

{runs} runs of {duration:g} s; faults begin at {onset:g} s, or from the start. The
exact-model LQI at 1 kHz behind the safety layer with its defaults. In brackets: monitor, latency, leg;
after the colon: the outcome of the run, and its warnings.
Travel: how far the true pose went from the reference, or from where that stood when the safety layer took over, until
all was at rest. A run that the layer ended is followed until brakes hold every crank: they close at the end of a safe
hold, or, where the motors were switched off, 50 ms later, with the motors' limit as dry friction. Stop at onset: the
travel of a plain stop in the tick of the fault, with sensors that work. Both are the worst of the motions.

{table}
With a dead motor, the wrench that the other five can hold at rest:

{held}

What the faults are:

{faults}

Command: `stewart-drake faults`. All figures: `faults.parquet`.
"""


def sheet(rows: Sequence[Row]) -> TextTable:
    more = {
        "travel": partial(_largest, deg="travel_deg", mm="travel_mm"),
        "stop at onset": partial(_largest, deg="stop_deg", mm="stop_mm"),
    }
    return pivot("Reactions and outcomes", rows, "fault", "motion", _end, more)


def _largest(rows: Sequence[Row], **columns: str) -> str:
    values = {unit: [row[name] for row in rows if row.get(name) is not None] for unit, name in columns.items()}
    return ", ".join(f"{max(numbers):.1f} {unit}" for unit, numbers in values.items() if numbers) or "-"


def _end(rows: Sequence[Row]) -> str:
    (row,) = rows
    if row["reaction"] == "refused":
        return "refused"
    trip = ""
    if row.get("safety_monitor") is not None:
        # A random fault, such as lost ticks, has no onset and so no latency.
        when = f", {row['latency_ms']:.0f} ms" if FAULTS[row["fault"]].since > 0.0 else ""
        leg = "" if row["safety_leg"] is None else f", leg {row['safety_leg']}"
        trip = f" ({row['safety_monitor']}{when}{leg})"
    warnings = (row.get("warnings") or "").replace("_", " ")
    return f"{row['reaction']}{trip}: {', '.join(filter(None, (row['status'], warnings)))}"


def holdable_lines(rows: Sequence[Row]) -> list[str]:
    lines = []
    for row in rows:
        held = "none, not even the weight without an external force of {support_newton:.1f} N"
        if row.get("holds_weight"):
            held = "{force_newton:.0f} N or {moment_newton_metre:.1f} N m"
        if row.get("support_newton") is not None:
            lines.append(f"{row['fault']}, {row['motion']}: {held.format(**row)}")
    return lines
