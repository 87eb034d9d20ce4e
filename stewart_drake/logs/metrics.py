"""Metrics of a run: a table of names, units, texts and functions of the run's rows."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stewart_drake.base.atomic_files import NOT_FINITE, Document, plain_json
from stewart_drake.base.errors import ConfigurationError, RunFailure, StewartDrakeError, raised_at
from stewart_drake.base.families import UserMade
from stewart_drake.base.tables import AXES
from stewart_drake.control.features import CostScales, cost
from stewart_drake.hardware.motors import within_limit
from stewart_drake.logs.ball_metrics import ball_errors, needed_friction
from stewart_drake.logs.outcomes import MissingSignal, RunRows, assess, find_warnings, is_measured
from stewart_drake.logs.signals import DISPLAY_UNITS, SCALES

if TYPE_CHECKING:
    from stewart_drake.logs.log import SimulationLog
    from stewart_drake.scenario.scenario import Scenario

ValueKind = Literal["number", "integer", "flag", "text", "json"]
Over = Literal["steps", "ticks", "second_half_steps", "second_half_ticks"]
INTEGRAL_TIME = 5.0  # [s] at which the paper gives the integral states.
FAILED = 1000.0  # Cost of a run that was not completed, and upper limit of all costs.
_TYPES: dict[ValueKind, tuple[type, ...]] = {
    "number": (float, int), "integer": (int,), "flag": (bool,), "text": (str,), "json": (dict, list)
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str
    unit: str  # 1 for a ratio; empty for texts and flags.
    text: str
    kind: ValueKind = "number"  # Type of the values; `json` for lists, written as text.


class MetricError(StewartDrakeError):
    """A user's metric raised an error or returned an invalid value."""

    reason = "metric_raised"


@dataclass(frozen=True)
class Metric:
    """A metric of a run.

    Attributes:
        name: Key in metrics.json and column in tables.
        unit: Unit of its numbers; several are separated by commas.
        text: Description; `over` adds the part of the run.
        of: Function of the rows of a run, see `outcomes.RunRows`; called only if there are rows `over`.
        over: The rows that it uses. Without such rows, or without a signal that it needs, the metric is None.
        parts: Columns of a metric that is a list, one per number.
        label: Name in the terminal's table; empty to leave it out.
        form: Format of its numbers in that table.
        kind: Type of its values.
    """

    name: str
    unit: str
    text: str
    of: Callable[[RunRows], Any]
    over: Over = "second_half_ticks"
    parts: tuple[str, ...] = ()
    label: str = ""
    form: str = ".4g"
    kind: ValueKind = "number"

    def value(self, rows: RunRows) -> Any:
        """The metric of a run as a plain value, or None."""
        if not getattr(rows, self.over):
            return None
        try:
            value = self.of(rows)
        except MissingSignal:
            return None
        except Exception as error:
            raise MetricError(f"metric {self.name}: {type(error).__name__}: {error}{raised_at(error)}") from error
        value = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
        if value is None:
            return None
        fits = not self.parts or (isinstance(value, (list, tuple)) and len(value) == len(self.parts))
        each = value if self.parts and fits else [value]
        if not fits or any(one is not None and type(one) not in _TYPES[self.kind] for one in each):
            count = f"{len(self.parts)} values" if self.parts else "a value"
            words = f"`of` returned {reprlib.repr(value)}, not {count} of kind {self.kind}"
            raise MetricError(f"metric {self.name}: {words}")
        return value

    def columns(self) -> list[Column]:
        half = ", second half of the planned duration" if self.over.startswith("second_half") else ""
        if not self.parts:
            return [Column(self.name, self.unit, self.text + half, self.kind)]
        units = self.unit.split(", ")
        named = zip(self.parts, np.repeat(units, len(self.parts) // len(units)).tolist(), strict=True)
        return [Column(part, unit, f"{self.text}, {part.split('_')[1]}{half}") for part, unit in named]

    def shown(self, value: object) -> str:
        """A value as text, with its unit."""
        if value is None or value == []:
            return "-"
        unit = "" if self.unit == "1" else f" {self.unit}"
        values = value if isinstance(value, list) else [value]
        return "  ".join("-" if each is None else format(each, self.form) for each in values) + unit


def _both(
    name: str, text: str, of: Callable[[RunRows], np.ndarray], over: Over, label: str = "", by_axis: bool = False
) -> list[Metric]:
    """A metric of angles [deg] and one of lengths [mm], from the values (2,) or (6,) [rad, m] of `of`."""
    metrics = []
    for index, (what, size) in enumerate((("roll, pitch, yaw", "angle"), ("position", "distance"))):
        unit, scale = DISPLAY_UNITS[3 * index], SCALES[3 * index]

        def value(rows: RunRows, index: int = index, scale: float = scale) -> object:
            return scale * (of(rows).reshape(2, -1)[index] if by_axis else of(rows)[index])

        axes = AXES[3 * index : 3 * index + 3] if by_axis else ()
        parts = tuple(f"{name}_{axis}_{unit}" for axis in axes)
        shown = text.format(what=what, size=size), label.format(" ".join(axes) or size)
        metrics.append(Metric(f"{name}_{unit}", unit, shown[0], value, over, parts, shown[1]))
    return metrics


def _ripple(index: int) -> Callable[[RunRows], float | None]:
    def ripple(rows: RunRows) -> float | None:
        both = rows.ripple
        return None if both is None else float(SCALES[3 * index] * both[index])

    return ripple


def _peak_speed(rows: RunRows) -> float | None:
    """[deg/s] from differences of the crank angles; None for a single row."""
    if rows.steps < 2:
        return None
    angle = rows["crank_angle" if "crank_angle" in rows.signals else "reading"]
    return float(np.degrees(np.abs(np.diff(angle, axis=0) / np.diff(rows.time)[:, None]).max()))


def _torque_change(rows: RunRows) -> float | None:
    """[N m] RMS change of the commanded torque, or of the servos' torque, between ticks of the second half, or None."""
    asked = rows.scenario.motors.torque_of(rows.signals)
    if asked is None:
        return None
    torque = within_limit(asked[rows.second_half_tick], rows.scenario.robot.effort_limits)
    change = np.diff(torque, axis=0)[np.diff(rows.tick_number[rows.second_half_tick]) == 1]
    return _rms(change) if change.size else None


def _integral(rows: RunRows) -> np.ndarray | None:
    """(6,) [rad s, m s] integral states at `INTEGRAL_TIME`; None if the run ended earlier."""
    if rows.time[-1] < INTEGRAL_TIME - 1e-9:
        return None
    return rows["integral"][np.flatnonzero(rows.tick & (rows.time <= INTEGRAL_TIME + 1e-9))[-1]]


def _of_weights(function: Callable[[np.ndarray], float]) -> Callable[[RunRows], float]:
    """A metric by a function of the weights (n, 2) at the ticks."""
    return lambda rows: float(function(rows["weights"][rows.tick]))


def _of_torque(function: Callable[[np.ndarray], float], rows: str = "") -> Callable[[RunRows], float]:
    """A metric by a function of the applied torques (n, 6), at the rows of a mask named `rows`."""
    return lambda table: float(function(table["torque_applied"][getattr(table, rows) if rows else slice(None)]))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


METRICS: tuple[Metric, ...] = (
    *_both(
        "rmse", "root mean square error", lambda t: t.second_half_rms, "second_half_ticks", "RMSE {}, second half",
        by_axis=True,
    ),
    *_both(
        "peak", "largest error", lambda t: np.abs(t.error[t.second_half]).max(axis=0), "second_half_steps",
        "peak {}, second half", by_axis=True,
    ),
    *_both("rmse_norm", "RMS length of the {what} error", lambda t: t.second_half_rms_norms, "second_half_ticks"),
    *_both(
        "worst_half_rmse_norm", "RMS length of the {what} error, the larger of both halves",
        lambda t: t.worst_half_rms_norms, "second_half_ticks",
    ),
    Metric(
        "pose_rmse_mm", "mm", "RMS of both errors together, rotations times the characteristic length",
        lambda t: 1e3 * np.hypot(*t.second_half_rms_norms * [t.scenario.robot.characteristic_length, 1.0]),
    ),
    *_both(
        "peak_norm", "largest length of the {what} error",
        lambda t: np.linalg.norm(t.error[t.second_half].reshape(-1, 2, 3), axis=2).max(axis=0), "second_half_steps",
    ),
    *_both(
        "error_max", "largest {size} from the reference while the controller was in charge, whole run",
        lambda t: np.array([t.largest["rotation"], t.largest["position"]]), "steps", "largest {} from the reference",
    ),
    Metric(
        "motion_ratio", "1", "size of the platform's motion over its reference's, null for a small motion",
        lambda t: t.motion_ratio, "ticks",
    ),
    Metric(
        "error_ratio", "1", "worst RMS error over the size of the motion, null for a small motion",
        lambda t: t.error_ratio, "ticks", label="error over motion, worst", form=".3g",
    ),
    Metric(
        "torque_rms", "N m", "RMS torque of all motors, within their limits, whole run",
        _of_torque(_rms, "tick"), "ticks", label="torque RMS", form=".3f",
    ),
    Metric(
        "torque_rms_second_half", "N m", "RMS torque of all motors, within their limits",
        _of_torque(_rms, "second_half_tick"),
    ),
    Metric(
        "torque_change_rms", "N m", "RMS change of the commanded torque, or of what servos give, from tick to tick",
        _torque_change,
    ),
    *(
        Metric(
            f"ripple_{unit}_s", f"{unit}/s", f"RMS length of the error of {what} above 2 Hz (null for less than 2 s)",
            of, "second_half_steps", label=f"ripple of {what}, second half",
        )
        for what, unit, of in (("the Euler rates", "deg", _ripple(0)), ("the velocity", "mm", _ripple(1)))
    ),
    Metric(
        "torque_peak", "N m", "largest torque of any motor, within their limits, whole run",
        _of_torque(lambda torque: np.abs(torque).max()), "steps", label="torque peak", form=".3f",
    ),
    Metric(
        "crank_speed_peak_deg_s", "deg/s", "largest speed of any crank, whole run", _peak_speed, "steps",
        label="crank speed peak",
    ),
    Metric(
        "saturated_fraction", "1",
        "share of torques at their limit, over ticks and motors; none while the safety layer is in charge",
        lambda t: t.saturated_share, "ticks", label="share of torques at the limit", form=".2%",
    ),
    Metric(
        "beyond_limits", "1", "share of the run in which the platform's motion was beyond one of the scenario's limits",
        lambda t: 0.0 if t.excursion is None else t.excursion[1], "ticks", label="share beyond a limit", form=".2%",
    ),
    Metric(
        "loop_gap_max_m", "m", "largest distance from a rod end to its platform joint",
        lambda t: t.largest["loop_gap"], "steps", label="largest loop gap", form=".2e",
    ),
    Metric(
        "omega_q", "1", "mean of omega_Q", _of_weights(lambda w: w[:, 0].mean()), "ticks",
        label="omega_Q, mean", form=".3g",
    ),
    Metric(
        "omega_r", "1", "mean of omega_R", _of_weights(lambda w: w[:, 1].mean()), "ticks",
        label="omega_R, mean", form=".3g",
    ),
    Metric(
        "omega_ratio", "1", "geometric mean of omega_Q / omega_R",
        _of_weights(lambda w: np.exp(np.log(w[:, 0] / w[:, 1]).mean())), "ticks",
    ),
    Metric(
        "integral_at_5s", "rad s, m s", "integral state at 5 s", _integral, "ticks",
        tuple(f"integral_{axis}_at_5s" for axis in AXES), "integral states at 5 s", ".2g",
    ),
    Metric(
        "finite", "", "every number of the log is finite, but for readings that are missing",
        lambda t: all(bool(np.isfinite(each).all()) for name, each in t.signals.items() if "reading" not in name),
        "steps", kind="flag",
    ),
)  # fmt: skip
"""Metrics of all runs, from all control ticks; peaks are from all steps of the plant."""


def _ball_rmse(rows: RunRows) -> float | None:
    errors = ball_errors(rows)
    return None if errors is None else 1e3 * _rms(errors[rows.second_half_tick])


BALL_METRICS: tuple[Metric, ...] = (
    Metric(
        "ball_rmse_mm", "mm", "RMS distance of the ball from its target in the second half", _ball_rmse,
        label="ball from its target, RMS, second half",
    ),
    Metric(
        "ball_friction", "1", "friction over normal force of the ball, exceeded in a thousandth of the steps",
        needed_friction, "steps", label="friction that the ball needs", form=".2g",
    ),
)  # fmt: skip
"""Further metrics of runs with a ball."""

OUTCOME: tuple[Column, ...] = (
    Column(
        "status", "", "completed, stopped, lost or failed, see `outcomes.OUTCOMES`, failed also where the worker "
        "process died; rejected: refused before the run; raised: any other exception", "text",
    ),
    Column("reason", "", "reason of the status, a fixed name; null for completed", "text"),
    Column("message", "", "the reason in one line", "text"),
    Column("outcome_time", "s", "time of the reason; null for completed"),
    Column("safety_monitor", "", "safety monitor that tripped first; null for none", "text"),
    Column("safety_time", "s", "time of that trip"),
    Column("safety_level", "", "last reaction of the safety layer: hold, ramp, safe_hold or end", "text"),
    Column("warnings", "", "names of the warnings, null for none", "text"),
    Column("end_time", "s", "simulated time reached"),
    Column("leg", "", "leg 0..5 of the outcome", "integer"),
    Column(NOT_FINITE, "", "metrics that are null because they are not finite, with their values", "text"),
)  # fmt: skip
"""Columns of the outcome; those of the metrics follow."""


class UserMetric(UserMade, key="metrics"):
    """A user's `Metric`, by its import path, or in Python the object."""

    asked = "of(rows) returns plain values"

    def rules(self) -> None:
        if self.arguments:
            raise ConfigurationError("arguments", self.arguments, "nothing, for a metric")

    def load(self) -> Metric:
        metric = self.code.load(self.code_key)
        if not isinstance(metric, Metric):
            allowed = f"the path of a Metric(name, unit, text, function), not of a {type(metric).__name__}"
            raise ConfigurationError(self.code_key, self.code, allowed)
        return metric

    made = property(load)


def metrics_of(*scenarios: Scenario) -> list[Metric]:
    """`METRICS` and those of the scenarios; a ConfigurationError if a name is already used."""
    metrics = [*METRICS, *(BALL_METRICS if any(scenario.ball is not None for scenario in scenarios) else ())]
    for metric in (own.made for scenario in scenarios for own in scenario.metrics):
        if metric not in metrics:
            # A sweep's table has columns of scenario keys too.
            taken = {each.name for each in metrics} | {column.name for column in _columns(metrics)}
            taken |= set(type(scenarios[0]).__pydantic_fields__)
            for name in (metric.name, *metric.parts):
                if name in taken:
                    raise ConfigurationError("metric", name, "a new name; a metric or column already has this one")
            metrics.append(metric)
    return metrics


def _columns(metrics: Iterable[Metric]) -> tuple[Column, ...]:
    return (*OUTCOME, *(column for metric in metrics for column in metric.columns()))


def columns(*scenarios: Scenario) -> tuple[Column, ...]:
    return _columns(metrics_of(*scenarios))


def flat(metrics: Document, *scenarios: Scenario) -> Document:
    """The result of `run_metrics` by table column; so are the names in `not_finite`."""
    row: Document = {}
    named: dict[str, str] = {}
    for metric in metrics_of(*scenarios):
        parts, value = metric.parts or (metric.name,), metrics.get(metric.name)
        row |= dict(zip(parts, (value or [None] * len(parts)) if metric.parts else [value], strict=True))
        named |= {f"{metric.name}.{index}": part for index, part in enumerate(metric.parts)}
    return {**row, NOT_FINITE: {named.get(name, name): what for name, what in metrics[NOT_FINITE].items()}}


def assessed(
    rows: RunRows, trip: Document | None, end_time: float, ended_by: RunFailure | KeyboardInterrupt | None
) -> Document:
    """Outcome, warnings and metrics of a run, as fields of a `SimulationLog`; see `assess`."""
    outcome, facts = assess(rows, trip, end_time, ended_by), {"end_time": end_time, "safety": trip}
    warnings = tuple(plain_json(each) for each in find_warnings(outcome.status, rows, trip))
    return {**outcome._asdict(), **facts, "warnings": warnings, "figures": figures_of(rows)}


def figures_of(rows: RunRows) -> Document:
    """Every metric of a run by name, in values that JSON has; None of what was not measured, or not finite."""
    known = is_measured(rows.signals) or not rows.steps
    with np.errstate(all="ignore"):
        return plain_json({each.name: each.value(rows) if known else None for each in metrics_of(rows.scenario)})


def run_metrics(log: SimulationLog) -> Document:
    """Outcome and metrics of a run as JSON values; all keys are always present.

    For a log from `run` the metrics use all control ticks, and peaks all steps of the plant. For other logs they use
    the log's rows.

    Returns:
        The outcome, see `SimulationLog`; the metrics, see `METRICS`; not_finite: metrics that were NaN or infinite, and
        are None; real_time_factor; git_revision; versions; files: sha256 by file that the scenario names.
    """
    figures = figures_of(log.rows) if log.figures is None else log.figures
    outcome = log.outcome()
    wall, versions, files, _ = (outcome.pop(name) for name in ("wall_time", "versions", "files", "figures"))
    return {
        "scenario": log.scenario.name,
        **outcome,
        **dict.fromkeys(metric.name for metric in METRICS),
        NOT_FINITE: {},
        **figures,
        "real_time_factor": log.end_time / wall if wall > 0.0 else None,
        "git_revision": versions.get("git_revision"),
        "versions": {name: version for name, version in versions.items() if name != "git_revision"},
        "files": files,
    }


def run_cost(figures: Mapping[str, object], status: str, period: float, scales: CostScales) -> float:
    """`cost` of a run with a control `period` [s] from its metrics, at most `FAILED`; `FAILED` if not completed."""
    parts = [figures.get(name) for name in ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")]
    if status != "completed" or None in parts:
        return FAILED
    rotation, position, change = map(float, parts)  # type: ignore[arg-type]
    return min(cost(rotation, position, change * 1e-3 / period, scales), FAILED)


def mean_cost(costs: Iterable[float]) -> float:
    """Arithmetic mean of the costs of some runs, dominated by those with large errors."""
    return fmean(costs)
