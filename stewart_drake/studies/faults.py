"""The fault table: every fault of `faults.yaml` during every motion, and what the safety layer makes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Flag, NotNegative, Section, Text, Vector6
from stewart_drake.errors import UnreachablePoseError
from stewart_drake.files.yaml_files import parse_yaml
from stewart_drake.hardware.motors import holdable_load
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metric_table import Column
from stewart_drake.logs.metric_table import columns as run_columns
from stewart_drake.logs.rows import pose_distance
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.safety import RAMP, SafetyOptions
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.studies.robots import sized
from stewart_drake.studies.runs import Measure, Row, RunFunction, execute, measure, simulate, simulate_unchecked
from stewart_drake.studies.study import Study, StudyTable, flat, markdown, run_study
from stewart_drake.studies.workers import Workers

Reaction = Literal["refused", "ridden through", "held", "ramped", "ended", "unnoticed"]
"""refused: before the start. ridden through: no monitor tripped, and none had to. unnoticed: none tripped, but the true
pose went farther from the reference than `safety.following_error` allows. held: the last good command
bridged it. ramped: a safe hold, then the end. ended: without one, since the robot could not be held; brakes are all
that is left."""

_FILE: Mapping[str, Any] = parse_yaml(Path(__file__).with_name("faults.yaml").read_text("utf-8"), "faults.yaml")
ONSET: float = _FILE["onset"]
"""[s] when every fault begins."""
DURATION: float = _FILE["duration"]
"""[s] of each run."""
MOTIONS: Mapping[str, Mapping[str, Any]] = _FILE["motions"]

_TICK = 0.001
"""[s] of `exact_fig7`."""
_WITHIN = {
    "at_once": 0.0,
    "deadline": 2 * _TICK,
    "estimator": EncoderOptions.hold_ticks * _TICK,
    "torque_limit": SafetyOptions.torque_limit_time,
    "torque_rate": SafetyOptions.torque_rate_time,
}
"""[s] at_once: in the tick of the fault. deadline: of the safety layer. estimator: it bridges readings that it cannot
believe for so long. Others: time in which that monitor trips."""


class Fault(Section):
    """A row of the table."""

    name: Text
    """Stable name."""
    text: Text
    """One line."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Scenario keys; `reference` is the motion's, whatever they say."""
    expected: tuple[Reaction, ...] = ("ridden through",)
    """Reactions allowed."""
    monitors: tuple[Text, ...] = ()
    """Monitors allowed to trip first; empty where none may."""
    drift: Vector6 | None = None
    """[rad, m] by which the reference wanders off; null for not at all."""
    drift_time: NotNegative = 0.8
    """[s] in which it does."""
    checked: Flag = True
    """Whether the run is checked beforehand, as a user's is."""
    since: NotNegative = ONSET
    """[s] from which it acts; 0 for what is wrong from the start."""
    encoders: dict[str, Any] | None = None
    """Keys of `sensors`, for a loop with encoders and commands a tick late; null for ideal sensors."""
    within: NotNegative | None = None
    """[s] within which a monitor trips, from the limits of the layer alone; null where it takes as long as the motion
    and the robot take to show it."""

    @classmethod
    def prepared(cls, data: dict[str, Any]) -> dict[str, Any]:
        """The file has a name for the time `within`."""
        return {**data, "within": _WITHIN.get(str(data.get("within")), data.get("within"))}

    def in_motion(self, motion: str, base: Scenario) -> dict[str, Any]:
        """Scenario key -> value for this fault during a motion of `MOTIONS`, in the size of the robot of `base`."""
        reference: Mapping[str, Any] = sized({"reference": MOTIONS[motion]}, base)["reference"]
        if self.drift is not None:
            home = base.robot.home_pose.tolist()
            away = [a + b for a, b in zip(home, LENGTH.value(self.drift, base.robot), strict=True)]
            path = {"kind": "minimum_jerk", "poses": [home, away], "durations": [self.drift_time], "dwell": [ONSET]}
            reference = {"kind": "sum", "parts": [reference, path]}
        changes: dict[str, Any] = {"reference": dict(reference), **sized(self.changes, base)}
        if self.encoders is not None:
            # Commands of a real drive are a tick old; with encoders it has to be shown that the loop bears both.
            changes |= {"sensors": {"kind": "encoders", **self.encoders}, "command_delay": 1}
        return changes


def base(robot: str | None = None, overrides: Sequence[str] = ()) -> Scenario:
    """The exact-model LQI of `exact_fig7` behind the safety layer, as it stands by default.

    Args:
        robot: Name or YAML file; None for the paper's.
        overrides: `key=value` texts, see `load_scenario`.
    """
    named = () if robot is None else (f"robot={robot}",)
    return load_scenario("exact_fig7", (*named, *overrides)).replace({"duration": DURATION, "safety": {}})


FAULTS = tuple(Fault.from_dict({"name": name, **keys}, f"faults.{name}") for name, keys in _FILE["faults"].items())
"""In the order of the table."""
BY_NAME = {fault.name: fault for fault in FAULTS}

QUICK_MOTIONS = ("hold",)
_REACTION = "see Reaction; broke: the run ended without the safety layer; the status, if there is no log"
OWN = (
    Column("safety_cause", "", "of the trip, where an estimator or controller failed", "text"),
    Column("safety_leg", "", "leg 0..5 to which the trip belongs", "whole"),
    Column("latency_ms", "ms", "from the fault to the trip"),
    Column("peak_error_deg", "deg", "largest angle from the reference after the fault, with the controller in charge"),
    Column("peak_error_mm", "mm", "largest distance likewise"),
    Column("travel_deg", "deg", "largest angle turned after the safety layer took over"),
    Column("travel_mm", "mm", "largest distance moved likewise"),
    Column("peak_torque", "N m", "largest torque given to a motor after the fault, within its limit"),
    Column("holds_weight", "", "whether the motors that are left carry the robot at rest; null: no dead motor", "flag"),
    Column("support_newton", "N", "smallest outside force with which they would"),
    Column("force_newton", "N", "largest outside force that they hold; null where not even the weight"),
    Column("moment_newton_metre", "N m", "largest outside moment likewise"),
)
"""What the table says of a run beside what every table says."""

_WORST = {"hold": "held", "ramp": "ramped", "safe_hold": "ramped", "end": "ended"}


def table_columns() -> tuple[Column, ...]:
    """Columns of the table."""
    names = (
        Column("fault", "", "name in FAULTS", "text"),
        Column("motion", "", "name in MOTIONS", "text"),
        Column("reaction", "", _REACTION, "text"),
    )
    return (*names, *run_columns(), *OWN)


def all_rows() -> list[tuple[Fault, str]]:
    """Fault and motion of each row, in the order of the table."""
    return [(fault, motion) for fault in FAULTS for motion in MOTIONS]


@dataclass(frozen=True, eq=False)
class FaultStudy(Study):
    """Runs of the table.

    Attributes:
        pairs: Fault and motion of each row.
        motions: Those that are wanted.
    """

    pairs: Sequence[tuple[Fault, str]]
    motions: Sequence[str] = tuple(MOTIONS)
    kind = "faults"
    products = ("faults.parquet", "faults.csv", "faults.md")

    @classmethod
    def of(
        cls,
        pairs: Sequence[tuple[Fault, str]],
        motions: Sequence[str] = tuple(MOTIONS),
        robot: str | None = None,
        overrides: Sequence[str] = (),
    ) -> FaultStudy:
        """The study of some rows; robot and overrides as in `base`."""
        runs = sum(motion in motions for _, motion in pairs)
        return cls(base(robot, overrides), pairs, motions, runs=runs, name="faults")

    @property
    def indices(self) -> Iterable[int]:
        """A row has its number in the whole table."""
        return [index for index, (_, motion) in enumerate(self.pairs) if motion in self.motions]

    def run_name(self, index: int) -> str:
        return f"{self.pairs[index][0].name} {self.pairs[index][1]}"

    def draw(self, index: int) -> dict[str, Any]:
        return {"run": index}

    def changes(self, drawn: Mapping[str, Any]) -> Mapping[str, Any]:
        fault, motion = self.pairs[drawn["run"]]
        return fault.in_motion(motion, self.base)

    def measure(self, index: int) -> Measure:
        return partial(measure_fault, fault=self.pairs[index][0])

    def simulation(self, index: int) -> RunFunction:
        return simulate if self.pairs[index][0].checked else simulate_unchecked

    def to_dict(self) -> dict[str, Any]:
        faults = [
            {**fault.to_dict(), "motion": motion, **fault.in_motion(motion, self.base)} for fault, motion in self.pairs
        ]
        return {"scenario": self.base.to_dict(), "faults": faults}

    def tables(self, rows: Sequence[Row]) -> dict[str, tuple[Sequence[Column], list[Row]]]:
        columns, wide = table_columns(), []
        for row in rows:
            fault, motion = self.pairs[row["index"]]
            reaction = row.get("reaction") or {"rejected": "refused"}.get(row["status"], row["status"])
            named = flat(row, fault=fault.name, motion=motion, reaction=reaction)
            wide.append({column.name: named.get(column.name) for column in columns})
        return {"faults": (columns, wide)}

    def page(self, tables: Mapping[str, list[Row]]) -> str:
        return markdown_table(tables["faults"])


def fault_study(quick: bool = False, robot: str | None = None, overrides: Sequence[str] = ()) -> FaultStudy:
    """The study of the whole table; quick: of the held platform alone; robot and overrides as in `base`."""
    return FaultStudy.of(all_rows(), QUICK_MOTIONS if quick else tuple(MOTIONS), robot, overrides)


def make_table(
    folder: str | Path,
    quick: bool = False,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    robot: str | None = None,
    overrides: Sequence[str] = (),
) -> StudyTable:
    """Runs every fault during every motion and writes `faults.parquet`, `.csv` and `.md`; see `run_study`.

    `quick` is the held platform alone; robot and overrides as in `base`.
    """
    return run_study(fault_study(quick, robot, overrides), Path(folder), workers, progress, restart)["faults"]


def fault_row(fault: Fault, motion: str) -> Row:
    """Runs a fault, of `FAULTS` or of the caller's own, during a motion of `MOTIONS`."""
    study = FaultStudy.of([(fault, motion)])
    return study.tables([execute(study.task(0))])["faults"][1][0]


def measure_fault(log: SimulationLog, fault: Fault) -> Row:
    """Figures of a run: those of every sweep, and `OWN`."""
    trip = log.safety
    # Rows at which a log stands are those of the safety layer's ticks.
    after = log.time >= fault.since - 1e-9
    taken = log["safety"][:, 0] >= RAMP if "safety" in log.signals else np.zeros(len(log.time), dtype=bool)
    turned, moved = pose_distance(log["pose"], log["reference"])
    charge = after & ~taken
    left = log["pose"][int(taken.argmax()) if taken.any() else len(taken) :]
    angle, way = pose_distance(left, left[:1])
    if trip is not None:
        # The layer gave up, or the plant broke under it: a crank that has lost its rod may spin up to that.
        reaction = "ended" if log.status == "failed" else _WORST[trip["worst"]]
    elif log.status == "failed":
        reaction = "broke"
    else:
        allowed = log.scenario.safety and log.scenario.safety.following_error
        far = allowed and (turned[charge].max() > allowed[0] or moved[charge].max() > allowed[1])
        reaction = "unnoticed" if far else "ridden through"
    return {
        **measure(log),
        "reaction": reaction,
        "safety_cause": trip and trip["cause"],
        "safety_leg": trip and trip["leg"],
        "latency_ms": trip and 1e3 * (trip["time"] - fault.since),
        "peak_error_deg": _peak(np.degrees(turned[charge])),
        "peak_error_mm": _peak(1e3 * moved[charge]),
        "travel_deg": _peak(np.degrees(angle)),
        "travel_mm": _peak(1e3 * way),
        "peak_torque": _peak(np.abs(log["torque_applied"][after])),
        **_holdable(log),
    }


def _peak(values: np.ndarray) -> float | None:
    return float(values.max()) if values.size else None


def _holdable(log: SimulationLog) -> Row:
    """What five motors hold where the platform stood as the sixth died."""
    scenario, dead = log.scenario, log.scenario.motors.dead
    if dead is None:
        return {}
    row = min(int(np.searchsorted(log.time, dead.time - 1e-9)), len(log.time) - 1)
    pose, robot = log["pose"][row], scenario.robot
    try:
        weight, jacobian = static_torque(robot, pose, scenario.gravity), twist_jacobian(robot, pose)
        # Each motor in parts of what it can, times one number for all.
        load = holdable_load(
            weight / robot.effort_shares, robot.effort_shares[:, None] * jacobian, robot.effort_limit, dead.leg
        )
    except (UnreachablePoseError, np.linalg.LinAlgError):
        return {}
    return dict(zip((column.name for column in OWN[-4:]), load, strict=True))


HEADERS = ("fault", *MOTIONS, "peak error", "travel", "peak torque")
TERSE_HEADERS = ("fault", "reaction", "outcome", "monitor", "ms", "deg", "mm", "N m")


def short_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """A line per fault, see `HEADERS`: how each motion ends, and the worst figures over the motions."""
    lines = []
    for name, mine in _by_fault(rows):
        ended = {row["motion"]: _end(row) for row in mine}
        error, travel = (_join(mine, {f"{of}_deg": "deg", f"{of}_mm": "mm"}) for of in ("peak_error", "travel"))
        torque = _join(mine, {"peak_torque": "N m"})
        lines.append((name, *(ended.get(motion, "-") for motion in MOTIONS), error, travel, torque))
    return lines


def terse_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """A short line per fault for a terminal, see `TERSE_HEADERS`: what differs between motions stands side by side.

    Latency [ms] from the smallest to the largest; worst peak error [deg, mm] and torque [N m].
    """
    lines = []
    for name, mine in _by_fault(rows):
        waits = _values(mine, "latency_ms") if _begins(name) else []
        ends = dict.fromkeys(f"{wait:.0f}" for wait in (min(waits), max(waits))) if waits else ["-"]
        most = (_values(mine, figure) for figure in ("peak_error_deg", "peak_error_mm", "peak_torque"))
        figures = [f"{max(values):.2f}" if values else "-" for values in most]
        words = ([row.get(key) or "-" for row in mine] for key in ("reaction", "status", "safety_monitor"))
        told = (" / ".join(texts if len(set(texts)) > 1 else texts[:1]) for texts in words)
        lines.append((name, *told, "-".join(ends), *figures))
    return lines


def holdable_lines(rows: Sequence[Row]) -> list[str]:
    """What five motors hold, a line per dead motor and motion."""
    lines = []
    for row in rows:
        held = "none: not even the weight; the smallest outside force with which it stands: {support_newton:.1f} N"
        if row.get("holds_weight"):
            held = "{force_newton:.0f} N or {moment_newton_metre:.1f} N m"
        if row.get("support_newton") is not None:
            lines.append(f"{row['fault']}, {row['motion']}: {held.format(**row)}")
    return lines


def markdown_table(rows: Sequence[Row]) -> str:
    """The table as a Markdown page."""
    page = [
        "# Fault table",
        "",
        f"{len(rows)} runs of {DURATION:g} s; faults begin at {ONSET:g} s, or are there from the start. The",
        "exact-model LQI at 1 kHz behind the safety layer with its defaults. In brackets: monitor, latency, leg;",
        "after the colon: the outcome of the run, and its warnings.",
        "Peak error: how far the true pose was from the reference while the controller was in charge. Travel: how far",
        "it went after the safety layer took over. The worst of the motions counts.",
        "",
        *markdown(HEADERS, short_rows(rows)),
        "",
        "With a dead motor, the wrench that the other five hold at rest:",
        "",
        *(f"- {line}" for line in holdable_lines(rows)),
        "",
        "What the faults are:",
        "",
        *(_told(BY_NAME[name]) for name, _ in _by_fault(rows)),
        "",
        "Command: `stewart-drake faults`. All figures: `faults.parquet`.",
        "",
    ]
    return "\n".join(page)


def _by_fault(rows: Sequence[Row]) -> Iterable[tuple[str, list[Row]]]:
    names = dict.fromkeys(row["fault"] for row in rows)
    return ((name, [row for row in rows if row["fault"] == name]) for name in names)


def _told(fault: Fault) -> str:
    bound = "" if fault.within is None else f" (a monitor trips within {1e3 * fault.within:.0f} ms)"
    return f"- `{fault.name}`: {fault.text}{bound}"


def _end(row: Row) -> str:
    trip = ""
    if row.get("safety_monitor") is not None:
        # What chance brings, such as ticks lost in a row, has a time but no latency.
        when = f", {row['latency_ms']:.0f} ms" if _begins(row["fault"]) else ""
        leg = "" if row["safety_leg"] is None else f", leg {row['safety_leg']}"
        trip = f" ({row['safety_monitor']}{when}{leg})"
    warnings = (row.get("warnings") or "").replace("_", " ")
    ended = ", ".join(filter(None, (row.get("status"), warnings)))
    return row["reaction"] if row["reaction"] == "refused" else f"{row['reaction']}{trip}: {ended}"


def _begins(name: str) -> bool:
    return BY_NAME[name].since > 0.0


def _join(rows: Iterable[Row], units: Mapping[str, str]) -> str:
    """The largest of each column with its unit."""
    most = ((_values(rows, name), unit) for name, unit in units.items())
    return ", ".join(f"{max(values):.2f} {unit}" for values, unit in most if values) or "-"


def _values(rows: Iterable[Row], name: str) -> list[float]:
    return [value for row in rows if (value := row.get(name)) is not None]
