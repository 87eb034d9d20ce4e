"""The table of metrics: name, unit, text, and the function of the rows of a run that computes it.

`metrics.json`, the terminal and the tables of sweeps, comparisons and faults draw from it.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stewart_drake.errors import ConfigurationError, StewartDrakeError, raised_at
from stewart_drake.families import UserMade
from stewart_drake.files.code import source_of
from stewart_drake.files.whole import NOT_FINITE
from stewart_drake.logs.rows import RunRows

if TYPE_CHECKING:
    from stewart_drake.scenario import Scenario

ValueKind = Literal["number", "whole", "flag", "text", "json"]
Over = Literal["steps", "ticks", "late_steps", "late_ticks"]
_ANGLES, _LENGTHS = ("roll", "pitch", "yaw"), ("x", "y", "z")
_TURNED, _MOVED = "roll, pitch, yaw error", "position error"
_TYPES: dict[ValueKind, tuple[type, ...]] = {
    "number": (float, int), "whole": (int,), "flag": (bool,), "text": (str,), "json": (dict, list)
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: Of the column.
        unit: 1 for a ratio, empty for what has none.
        text: What it says.
        kind: What its values are; `json` for values that are lists, written as text.
    """

    name: str
    unit: str
    text: str
    kind: ValueKind = "number"


class MetricError(StewartDrakeError):
    """A metric raised something."""

    reason = "metric_raised"


@dataclass(frozen=True)
class Metric:
    """A figure of a run.

    Attributes:
        name: Key of metrics.json, and column of tables; it means the same everywhere.
        unit: Of its numbers, separated by commas where they differ.
        text: What it says; which part of the run it is of follows from `over`.
        of: Computes it from the rows of a run, see `rows.RunRows`; called only where there are such rows.
        over: Which rows it is of, a count of theirs; without any it is None.
        parts: Columns of a metric that is a list, one for each of its numbers.
        label: In tables that are read; empty for those that are not shown there.
        form: How its numbers are shown.
        kind: Of its values.
    """

    name: str
    unit: str
    text: str
    of: Callable[[RunRows], Any]
    over: Over = "late_ticks"
    parts: tuple[str, ...] = ()
    label: str = ""
    form: str = ".4g"
    kind: ValueKind = "number"

    def value(self, rows: RunRows) -> Any:
        """The metric of a run in plain values, None where there is nothing to compute it from."""
        if not getattr(rows, self.over):
            return None
        try:
            found = self.of(rows)
        except Exception as error:
            raise MetricError(f"metric {self.name}: {type(error).__name__}: {error}{raised_at(error)}") from error
        found = found.tolist() if isinstance(found, (np.ndarray, np.generic)) else found
        if found is None:
            return None
        fits = not self.parts or (isinstance(found, (list, tuple)) and len(found) == len(self.parts))
        each = found if self.parts and fits else [found]
        if not fits or any(value is not None and type(value) not in _TYPES[self.kind] for value in each):
            count = f"{len(self.parts)} values" if self.parts else "a value"
            said = f"`of` returned {reprlib.repr(found)}, not {count} of kind {self.kind}"
            raise MetricError(f"metric {self.name}: {said}")
        return found

    def columns(self) -> tuple[Column, ...]:
        """Its columns in a table."""
        half = ", second half of the planned duration" if self.over.startswith("late") else ""
        if not self.parts:
            return (Column(self.name, self.unit, self.text + half, self.kind),)
        units = self.unit.split(", ") if "," in self.unit else [self.unit]
        each = [unit for unit in units for _ in range(len(self.parts) // len(units))]
        return tuple(
            Column(part, unit, f"{self.text}, {part.split('_')[1]}{half}")
            for part, unit in zip(self.parts, each, strict=True)
        )

    def shown(self, value: Any) -> str:
        """A value of the metric as text, with its unit."""
        values = value if isinstance(value, list) else [value]
        if value is None or not values:
            return "-"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return "  ".join("-" if each is None else format(each, self.form) for each in values) + unit


def _axes(form: str) -> tuple[str, ...]:
    """Columns of three numbers, by axis."""
    return tuple(form.format(axis) for axis in (_LENGTHS if "mm" in form else _ANGLES))


def _of_weights(function: Callable[[np.ndarray], float]) -> Callable[[RunRows], float | None]:
    """A function of the two weights (n, 2) at the ticks; None where a run has none."""
    return lambda t: float(function(t["weights"][t.tick])) if "weights" in t.signals else None


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


METRICS: list[Metric] = [
    Metric(
        "rmse_deg", "deg", "root mean square error", lambda t: np.degrees(t.late_rms[:3]),
        parts=_axes("rmse_{}_deg"), label="RMSE roll pitch yaw, second half",
    ),
    Metric(
        "rmse_mm", "mm", "root mean square error", lambda t: 1e3 * t.late_rms[3:],
        parts=_axes("rmse_{}_mm"), label="RMSE X Y Z, second half",
    ),
    Metric(
        "peak_deg", "deg", "largest error", lambda t: np.degrees(t.late_peaks[:3]), "late_steps",
        _axes("peak_{}_deg"), "peak roll pitch yaw, second half",
    ),
    Metric(
        "peak_mm", "mm", "largest error", lambda t: 1e3 * t.late_peaks[3:], "late_steps",
        _axes("peak_{}_mm"), "peak X Y Z, second half",
    ),
    Metric("rmse_norm_deg", "deg", f"RMS length of the {_TURNED}", lambda t: np.degrees(t.late_rms_norms[0])),
    Metric("rmse_norm_mm", "mm", f"RMS length of the {_MOVED}", lambda t: 1e3 * t.late_rms_norms[1]),
    Metric(
        "worst_half_rmse_norm_deg", "deg", f"RMS length of the {_TURNED}, the larger of both halves",
        lambda t: np.degrees(t.worst_half_rms[0]),
    ),
    Metric(
        "worst_half_rmse_norm_mm", "mm", f"RMS length of the {_MOVED}, the larger of both halves",
        lambda t: 1e3 * t.worst_half_rms[1],
    ),
    Metric(
        "pose_rmse_mm", "mm", "RMS of both errors together, rotations times the characteristic length",
        lambda t: 1e3 * np.hypot(*t.late_rms_norms * [t.scenario.robot.characteristic_length, 1.0]),
    ),
    Metric(
        "peak_norm_deg", "deg", f"largest length of the {_TURNED}", lambda t: np.degrees(t.late_norms[0]), "late_steps"
    ),
    Metric("peak_norm_mm", "mm", f"largest length of the {_MOVED}", lambda t: 1e3 * t.late_norms[1], "late_steps"),
    Metric(
        "error_max_deg", "deg", "largest angle from the reference while the controller was in charge, whole run",
        lambda t: float(np.degrees(t.largest["rotation"])), "steps", label="largest angle from the reference",
    ),
    Metric(
        "error_max_mm", "mm", "largest distance from the reference while the controller was in charge, whole run",
        lambda t: 1e3 * t.largest["position"], "steps", label="largest distance from it",
    ),
    Metric(
        "motion_ratio", "1", "size of the platform's motion over that of its reference, null where that is small",
        lambda t: t.motion_ratio, "ticks",
    ),
    Metric(
        "error_ratio", "1", "RMS error over motion where that is worst, null where the motion is small",
        lambda t: t.error_ratio, "ticks", label="error over motion, at worst", form=".3g",
    ),
    Metric(
        "torque_rms", "N m", "of all motors, within their limits, whole run",
        lambda t: _rms(t["torque_applied"][t.tick]), "ticks", label="torque RMS", form=".3f",
    ),
    Metric(
        "torque_rms_second_half", "N m", "of all motors, within their limits",
        lambda t: _rms(t["torque_applied"][t.late_tick]),
    ),
    Metric("torque_change_rms", "N m", "of the torque asked for, from tick to tick", lambda t: t.torque_change),
    Metric(
        "torque_peak", "N m", "of all motors, within their limits, whole run",
        lambda t: float(np.abs(t["torque_applied"]).max()), "steps", label="torque peak", form=".3f",
    ),
    Metric(
        "saturated_fraction", "1", "share of torques at the limit, of ticks and motors",
        lambda t: int(t.at_limit.sum()) / (6 * t.ticks), "ticks", label="share of torques at the limit", form=".2%",
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
        "integral_at_5s", "rad s, m s", "integral state at 5 s", lambda t: t.integral, "ticks",
        tuple(f"integral_{axis}_at_5s" for axis in (*_ANGLES, *_LENGTHS)), "integral states at 5 s", ".2g",
    ),
    Metric(
        "finite", "", "every number of the log is finite",
        lambda t: all(bool(np.isfinite(values).all()) for values in t.signals.values()), "steps", kind="flag",
    ),
]  # fmt: skip
"""Of every run, from all control ticks, and peaks from every step of the plant, whatever rows the log keeps."""


_SHIPPED = len(METRICS)
_TAKEN = (
    *("scenario", "safety", "real_time_factor", "git_revision", "versions", "files"),
    *("index", "seed", "values", "wall_s", "simulation_s", "host", "worker"),
    *("controller", "chosen", "reference", "condition", "settling_s", "cost"),
    *("frequency_hz", "amplitude", "ratio", "phase_deg", "rest"),
    *("fault", "motion", "reaction", "safety_cause", "safety_leg", "latency_ms", "peak_error_deg", "peak_error_mm"),
    *("travel_deg", "travel_mm", "peak_torque", "holds_weight", "support_newton", "force_newton"),
    "moment_newton_metre",
)
"""Other keys of metrics.json, and other columns of the tables of studies."""


def add_metric(metric: Metric) -> None:
    """Adds a metric from outside of the package, or puts it in the place of one of its name that was added before.

    Every run from now on has it, and every table. Workers import the calling script: there the call stands outside of
    `if __name__ == "__main__":`. For runs of one scenario there is its key `metrics`.

    Raises:
        ConfigurationError: Its name, or a column of it, means something already.
    """
    others = [each for each in METRICS[_SHIPPED:] if each.name != metric.name]
    _check_names(metric, METRICS[:_SHIPPED] + others)
    METRICS[_SHIPPED:] = [*others, metric]


def _check_names(metric: Metric, others: Sequence[Metric]) -> None:
    from stewart_drake.scenario import Scenario

    taken = {each.name for each in others} | {column.name for each in others for column in each.columns()}
    # A sweep has a column for each key of the scenario that it varies.
    taken |= {*_TAKEN, *(column.name for column in OUTCOME), *Scenario.__pydantic_fields__}
    for name in (metric.name, *metric.parts):
        if name in taken:
            raise ConfigurationError("metric", name, "a name that no metric or column has")


def metrics_of(*scenarios: Scenario) -> list[Metric]:
    """The metrics of runs of these scenarios: those of every run, and their own."""
    found = list(METRICS)
    for metric in (own.made for scenario in scenarios for own in scenario.metrics):
        if metric not in found:
            _check_names(metric, found)
            found.append(metric)
    return found


class UserMetric(UserMade, key="metrics"):
    """A `Metric` that a module or file of the user's has; in Python it may stand here itself."""

    asked = "of(rows) returns plain values"

    def rules(self) -> None:
        """Refuses arguments."""
        if self.arguments:
            raise ConfigurationError("arguments", self.arguments, "nothing, for a metric")

    def load(self) -> Metric:
        """The metric."""
        found = self.code.load(self.code_key)
        if not isinstance(found, Metric):
            allowed = f"the path of a Metric(name, unit, text, function), not of a {type(found).__name__}"
            raise ConfigurationError(self.code_key, self.code, allowed)
        return found

    @property
    def made(self) -> Metric:
        """The metric."""
        return self.load()


def added_code() -> dict[str, str]:
    """Name -> source of what each metric from outside is computed by: with another body it is another metric."""
    return {each.name: source_of(each.of) for each in METRICS[_SHIPPED:]}


def flat(metrics: Mapping[str, Any], *scenarios: Scenario) -> dict[str, Any]:
    """Metrics of a run by column, from `metrics.run_metrics`; and `not_finite`, named likewise."""
    row: dict[str, Any] = {}
    known = metrics_of(*scenarios)
    for metric in known:
        value = metrics[metric.name]
        parts = metric.parts or (metric.name,)
        values = value or [None] * len(parts) if metric.parts else [value]
        row |= dict(zip(parts, values, strict=True))
    named = {f"{metric.name}.{index}": part for metric in known for index, part in enumerate(metric.parts)}
    return {**row, NOT_FINITE: {named.get(name, name): what for name, what in metrics[NOT_FINITE].items()}}


OUTCOME: tuple[Column, ...] = (
    Column(
        "status",
        "",
        "completed: the controller was in charge to the end and the motion was followed; stopped: the safety layer "
        "held the robot at the end; lost: the motion was not followed; failed: broke midway, and what was measured "
        "until then is there, or took its worker process with it; rejected: refused before the run; raised: an "
        "exception that is no verdict on the run",
        "text",
    ),
    Column("reason", "", "stable name of what happened, null for completed", "text"),
    Column("message", "", "one line on it", "text"),
    Column("outcome_time", "s", "when that was decided, null for completed"),
    Column("safety_monitor", "", "monitor of the safety layer that tripped first, null for none", "text"),
    Column("safety_time", "s", "when it did"),
    Column("safety_level", "", "how far the safety layer went: hold, ramp, safe_hold or end", "text"),
    Column("warnings", "", "names of the warnings, null for none", "text"),
    Column("end_time", "s", "simulated time reached"),
    Column("leg", "", "leg 0..5 to which the outcome belongs", "whole"),
    Column(NOT_FINITE, "", "metrics that are null because they are no finite numbers, with what they are", "text"),
)
"""How a run ended, before the metrics."""


def columns(*scenarios: Scenario) -> tuple[Column, ...]:
    """All that is told of runs in a table: how they ended, and their metrics."""
    return (*OUTCOME, *(column for metric in metrics_of(*scenarios) for column in metric.columns()))
