"""Figures of calibration, identification, stability margins, and frequency and step responses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stewart_drake.analysis.margins import LoopMargins
from stewart_drake.analysis.response import FrequencyResponse, StepResponse
from stewart_drake.estimation.calibration import Calibration
from stewart_drake.estimation.geometry import LEG_PARAMETERS, OF_ROBOT, PER_LEG
from stewart_drake.estimation.identification import Identification
from stewart_drake.estimation.servos import ServoIdentification
from stewart_drake.plotting import style as look
from stewart_drake.robot.leg import LEG_COUNT

_TIME_SHOWN = 20.0  # [s] of a recording.
_MAX_MARGIN = 2.0  # [-] Larger disk margins, which bound no gain, are clipped.


@look.styled
def plot_calibration(calibration: Calibration, path: str | Path) -> None:
    """Pose errors before and after calibration, and the changes of the parameters with 95 % intervals."""
    figure, axes = look.panels(2, 2, 7.0)
    rows = np.arange(len(calibration.measurements)) + 1
    degree = float(np.degrees(1.0))
    kinds = (
        (slice(3, 6), "Error of the position", "mm", 1e3),
        (slice(0, 3), "Error of the rotation", "deg", degree),
    )
    for panel, (part, title, unit, factor) in zip(axes[:, 0], kinds, strict=True):
        measured = calibration.model.measured[part]
        panel.set(title=title if measured.any() else f"{title}: not measured")
        panel.set(xlabel="row of the measurements [-]", ylabel=f"error [{unit}]")
        for error, label, color in (
            (calibration.before, "before", look.ORANGE),
            (calibration.after, "after", look.BLUE),
        ):
            if measured.any():
                sizes = factor * np.linalg.norm(error[:, part][:, measured], axis=-1)
                panel.plot(rows, sizes, ".", color=color, label=label)
                look.logarithmic(panel, "y")
                panel.legend()
    change, width = np.stack([calibration.change, calibration.half_width])[:, :OF_ROBOT].reshape(2, LEG_COUNT, PER_LEG)
    # Unidentifiable and held parameters have no interval.
    width = np.where(np.isfinite(width), width, np.nan)
    for panel, unit, kind, shown, factor in (
        (axes[0, 1], "m", "lengths", "mm", 1e3),
        (axes[1, 1], "rad", "angles", "deg", degree),
    ):
        # A gain is an angle per angle.
        columns = [at for at, of in enumerate(LEG_PARAMETERS) if unit == of.unit.replace("1", "rad")]
        for leg, color in enumerate(look.COLORS):
            at = np.arange(len(columns)) + 0.12 * (leg - 2.5)
            values = factor * change[leg, columns], factor * width[leg, columns]
            panel.errorbar(at, *values, fmt=".", color=color, label=f"leg {leg}", elinewidth=1.0)
        names = [str(LEG_PARAMETERS[at]).replace("_", " ").replace("gain", "gain (per rad)") for at in columns]
        panel.set_xticks(range(len(columns)), names, rotation=30, ha="right")
        panel.set(title=f"Change of {kind}, with 95 % intervals", ylabel=f"change [{shown}]")
    look.legend_below(figure, axes[0, 1].get_legend_handles_labels()[0], columns=6)
    look.save_figure(figure, path)


@look.styled
def plot_identification(identification: Identification | ServoIdentification, path: str | Path) -> None:
    """Measurement and residual by motor, over the first seconds and over the crank's rate."""
    figure, axes = look.panels(6, 2, 12.0, sharex="col", width_ratios=[2, 1])
    samples, residuals = identification.samples, identification.left
    name, unit = identification.measured
    start = samples.pieces[0].start
    rows = slice(start, start + int(_TIME_SHOWN / samples.step))
    time = samples.time[rows]
    for leg, (over_time, over_rate) in enumerate(axes):
        used, residual, moving = samples.used[rows, leg], residuals[rows, leg], samples.used[:, leg]
        unused = np.where(used, np.nan, residual)
        over_time.plot(time, samples.measured[rows, leg], color=look.BLUE, label=name, linewidth=1.0)
        over_time.plot(time, np.where(used, residual, np.nan), color=look.ORANGE, label="residual", linewidth=1.0)
        over_time.plot(time, unused, color=look.GREY, label="residual, not used", linewidth=1.0)
        over_rate.plot(samples.rates[moving, leg], 1e3 * residuals[moving, leg], ".", color=look.ORANGE, markersize=2)
        over_time.set(title=f"Motor {leg}", ylabel=f"[{unit}]")
        over_rate.set(ylabel=f"residual [m{unit}]")
    axes[-1, 0].set(xlabel="time [s]")
    axes[-1, 1].set(xlabel="crank rate [rad/s]")
    look.legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], columns=3)
    look.save_figure(figure, path)


@look.styled
def plot_margins(margins: LoopMargins, path: str | Path) -> None:
    """Disk margin of all motors at once over frequency, and the distribution of the margins over the poses."""
    figure, ((curves, shares),) = look.panels(1, 2, 4.0)
    drawn = np.minimum(margins.curves, _MAX_MARGIN)
    curves.fill_between(margins.frequencies, drawn.min(axis=0), drawn.max(axis=0), color=look.SKY, alpha=0.5, lw=0)
    curves.plot(margins.frequencies, np.median(drawn, axis=0), color=look.BLUE, label="median, and all poses")
    look.logarithmic(curves, "x")
    curves.set(title="All motors at once, by frequency", xlabel="frequency [rad/s]", ylabel="disk margin [-]")
    percent = 100.0 * (np.arange(len(margins.radius)) + 1) / len(margins.radius)
    for motor, color in enumerate((look.SKY, *look.COLORS[1:4], *look.COLORS[5:], look.GREY)):
        single = np.sort(np.minimum(margins.single.disk[:, motor], _MAX_MARGIN))
        shares.plot(single, percent, color=color, lw=1.0, label=f"motor {motor} alone")
    all_motors = np.sort(np.minimum(margins.all_at_once.disk, _MAX_MARGIN))
    shares.plot(all_motors, percent, color=look.BLUE, lw=2.0, label="all at once")
    shares.set(title="Share of poses with a smaller margin", xlabel="disk margin [-]", ylabel="poses [%]")
    curves.set_ylim(0.0)
    shares.set_xlim(0.0)
    for panel in (curves, shares):
        panel.legend()
    look.save_figure(figure, path)


@look.styled
def plot_bode(response: FrequencyResponse, path: str | Path) -> None:
    """Singular values of the open loop, of the sensitivity and of the complementary sensitivity over frequency."""
    figure, ((opened, closed),) = look.panels(1, 2, 4.0, sharex=True)
    for panel, parts in ((opened, ("loop",)), (closed, ("sensitivity", "complementary"))):
        for name, color in zip(parts, (look.BLUE, look.ORANGE), strict=False):
            gains = 20.0 * np.log10(response.gains(name))
            panel.plot(response.frequency, gains[:, 0], color=color, label=f"{name}, largest")
            panel.plot(response.frequency, gains[:, -1], color=color, linewidth=1.0, label=f"{name}, smallest")
        panel.axhline(0.0, color=look.TEXT, linewidth=0.8)
        look.logarithmic(panel, "x")
        panel.set(xlabel="frequency [Hz]", ylabel="gain [dB]")
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
    opened.set(title="Loop, opened at the motors", ylim=(-80.0, None))
    closed.set(title="Sensitivity S and complementary T", ylim=(-60.0, 15.0))
    look.save_figure(figure, path)


@look.styled
def plot_step(response: StepResponse, title: str, path: str | Path) -> None:
    """Step response of a coordinate, relative to the step."""
    figure, ((panel,),) = look.panels(1, 1, 4.0)
    panel.plot(response.time, response.value, color=look.BLUE)
    panel.axhspan(0.98, 1.02, color=look.SKY, alpha=0.4, linewidth=0)
    shown = 3.0 * response.settling_time if np.isfinite(response.settling_time) else response.time[-1]
    panel.set(title=title, xlabel="time [s]", ylabel="share of the step [-]", xlim=(0.0, min(shown, response.time[-1])))
    look.save_figure(figure, path)
