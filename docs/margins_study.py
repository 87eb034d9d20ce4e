"""Margins of the linear loop over the near box, and docs/results/margins.md: `make margins`."""

import time
from pathlib import Path

import numpy as np

from stewart_drake.analysis.feasibility import NEAR
from stewart_drake.analysis.linear_loop import linear_loops, poses_to_stand_at
from stewart_drake.analysis.margins import HEADER, facts, loop_margins, quantities, spread, table
from stewart_drake.plotting.model_plots import plot_margins
from stewart_drake.scenario.scenario import load_scenario

OUT = Path(__file__).parent / "results"
POSES = 1000
BLOCK = "tuner={kind: block}"
OBSERVER = "estimator.kind=observer"
WEIGHTS = "tuner={kind: block, q_pose: 8.0e5, q_rate: 150.0, q_integral: 5.0e6}"
MAIN = "observer"
DIFFERENCES = "estimator={kind: difference, rate_cutoff: 150}"
ROWS = {
    "difference of readings, low pass of 150 Hz; default weights": (
        DIFFERENCES,
        BLOCK,
    ),
    MAIN: (OBSERVER, WEIGHTS),
    "observer, default weights": (OBSERVER, BLOCK),
    **{f"observer, disturbance {one}": (OBSERVER, WEIGHTS, f"estimator.disturbance={one}") for one in (5, 10, 40)},
    **{f"observer, {ticks} ticks of delay": (OBSERVER, WEIGHTS, f"command_delay={ticks}") for ticks in (0, 2, 4)},
    "observer, 10 ms, 1 tick of delay, default weights": (OBSERVER, "controller.period=0.01", BLOCK),
    "observer, ideal sensors": (OBSERVER, WEIGHTS, "sensors={kind: ideal}"),
    "observer, platform believed 30 % too heavy": (OBSERVER, WEIGHTS, "model.robot={platform_mass: 1.3}"),
    "computed torque, observer": (OBSERVER, WEIGHTS, "controller={kind: computed_torque}"),
    "joint-space PID, observer": (OBSERVER, WEIGHTS, "controller={kind: pid}"),
    "joint-space PID, difference of readings": (
        DIFFERENCES,
        "controller={kind: pid}",
    ),
}
TEXT = """# How far the loop is from instability

`make margins` linearises the loop of `exact_breathing` at {poses} random poses near home
({box}),
within the scenario's limits (seed 0), with the robot at rest. The loop is opened at the six motor torques. Each row has
another estimator, delay, period or controller, with its default gains. The period is 1 ms and the delay 1 tick unless
the row says otherwise. The loop contains the exact model under held torques, gravity's stiffness, encoders of infinite
resolution, the estimator with its filter, the controller and the delay. It leaves out friction, saturation and the
network's changes of weights. `stewart-drake margins` does the same for any scenario.

Drake's plant at its usual step of 1 ms responds about half a step sooner than this linear loop. At 0.1 ms the agreement
is at least five times better (`tests/analysis/test_linear_loop.py`). A fast loop that is unstable here, such as the
PID of the last row at some poses, may look stable at 1 ms.

*Disk*: each motor gives (1 + d/2) / (1 - d/2) times its command, d complex; the loop is stable while every |d| is
below the disk margin. It covers gain and phase at once: 0.45 means gains from 0.63 to 1.58 or 25 deg. *All at
once*: each motor has its own d (structured singular value, upper bound); gain, phase and delay follow from it. *One
motor*: the other motors are nominal; gain, phase and delay are the classical margins. Delay is in addition to the
loop's own, in ticks of its period. Each number is the worst of all poses; a second number is the median.

| loop | stable | all at once: {margins} | one motor: {margins} |
|---|---|---|---|---|---|---|---|---|---|
{rows}

The bounds of mu are apart by at most {gap:.1g} %; {left_out}

`stewart-drake margins --set {setting}`:

| | {header} |
|---|---|---|---|---|---|---|
{table}

{facts}

![Disk margin by frequency, and its distribution over the poses](../images/margins.png)

`make results` recomputes some of these numbers.
"""


def row(name, loops, found):
    """A line of the first table."""
    worst = {
        key: (spread(one, key == "gain_low"), spread(all_, key == "gain_low"))
        for key, _, one, all_ in quantities(found, loops.period)
    }
    cells = []
    for k in (1, 0):
        disk, low, high = (worst[key][k] for key in ("disk", "gain_low", "gain_high"))
        cells += [
            f"{disk[0]:.3f}, {disk[2]:.3f}",
            f"{low[0]:.2f} to {high[0]:.2f}",
            f"{worst['phase_deg'][k][0]:.1f}",
            f"{worst['delay_ticks'][k][0]:.2f}",
        ]
    stable = f"{(found.radius < 1.0).sum()} of {len(found.radius)}"
    return f"| {name} | {stable} | {' | '.join(cells)} |"


def main():
    """Writes the file and the picture."""
    lines, gaps, left_out = [], [], []
    for name, changes in ROWS.items():
        start = time.process_time()
        scenario = load_scenario("exact_breathing", changes)
        loops = linear_loops(scenario, poses_to_stand_at(scenario, POSES, seed=0))
        found = loop_margins(loops)
        lines.append(row(name, loops, found))
        stable = found.radius < 1.0
        gaps.append(np.max(found.not_above[stable] / found.all_at_once.disk[stable] - 1.0, initial=0.0))
        left_out += [name] * bool(loops.left_out)
        print(f"{time.process_time() - start:.1f} s: {lines[-1]}", flush=True)
        if name == MAIN:
            plot_margins(found, Path(__file__).parent / "images" / "margins.png")
            kept = [f"| {' | '.join(cells)} |" for cells in table(found, loops.period)]
            told = "\n".join(f"- {key}: {value}" for key, value in facts(loops, found))
    text = TEXT.format(
        poses=POSES,
        box=NEAR.words,
        margins="disk | gain | phase [deg] | delay [ticks]",
        rows="\n".join(lines),
        gap=100.0 * max(gaps),
        left_out=f"poses were left out of: {', '.join(left_out)}." if left_out else "no pose was left out.",
        setting=f'"{WEIGHTS}"',
        header=" | ".join(HEADER[1:]),
        table="\n".join(kept),
        facts=told,
    )
    (OUT / "margins.md").write_text(text)


if __name__ == "__main__":
    main()
