"""Margins of the linear loop over the near box, and docs/results/margins.md: `make margins`."""

import itertools
import time
from pathlib import Path

import numpy as np

from stewart_drake.analysis.feasibility import NEAR
from stewart_drake.analysis.linear_loop import linear_loops, poses_to_stand_at
from stewart_drake.analysis.margins import HEADER, facts, loop_margins, quantities, spread, table
from stewart_drake.base.markdown import markdown_table
from stewart_drake.control.adaptation import SIZE_HEAD
from stewart_drake.control.base import heave_inertia
from stewart_drake.control.policy import NAMES, Policy
from stewart_drake.plotting.model_plots import plot_margins
from stewart_drake.scenario.scenario import load_scenario
from stewart_drake.studies.runs import simulate_unchecked
from stewart_drake.training.benchmark import with_setting
from stewart_drake.training.situations import Case

OUT = Path(__file__).parents[1] / "results"
POSES, FEW, CONFIRMED = 1000, 10, 3
"""Poses; of them those at which the worst corner of the policy's box is looked for, and that are simulated too."""
PUSH, END, LAST, FORGOTTEN = 2000, 3000, 200, 0.1
"""[ticks] of a simulated run: its push, its end, the last ones; and what may be left there of the error, as a share."""
GAINS = (0.05, 6.0)
"""Gains between which that is looked for at which a loop diverges."""
BLOCK = "tuner={kind: block}"
OBSERVER = "estimator.kind=observer"
WEIGHTS = "tuner={kind: block, q_pose: 8.0e5, q_rate: 150.0, q_integral: 5.0e6}"
MAIN, CORNER = "observer", "policy, at the worst corner of its box"
HEAVIER, BOTH = "learning, head believed heavier", "policy at that corner, head believed heavier"
NOD, SLOW = "LQI, observer, start weights, as in `reachy_nod`", "PID for slow buses, as in `reachy_slow_bus`"
SLOW_LIGHTER, SLOW_HEAVIER = "the same, head believed lighter", "the same, head believed heavier"
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
    "joint-space PID, difference of readings": (DIFFERENCES, BLOCK, "controller={kind: pid}"),
}
TEXT = """# How far the loop is from instability

`make margins` linearises the loop of `exact_breathing` at {poses} random poses near home
({box}),
within the scenario's limits (seed 0), with the robot at rest. The loop is opened at the six motor torques. Each row has
another estimator, delay, period or controller, with its default gains. The period is 1 ms and the delay 1 tick unless
the row says otherwise. The loop contains the exact model under held torques, gravity's stiffness, encoders of infinite
resolution, the estimator with its filter, the controller and the delay. It leaves out friction, saturation, the
dead band of a PID, changes of weights and learning. The last five rows are Reachy Mini by torque at 100 Hz:
poses and period are its own, with a tick of delay. `stewart-drake margins` does the same for any scenario.

What a policy and learning may do to the loop is seen in their extremes, frozen: the middle of the shipped policy's box
and that corner of it which has the least margin at {few} poses ({corner};
of Reachy Mini {reachy_corner}), with its default weights;
a head that is believed {lighter:.2f} or {heavier:.2f} times as heavy as it is, which is how far learning may be off
before it has seen anything (95 %); and both at once, at that same corner. What it learns of friction is fed forward
along the reference and is no part of this loop. The law's own bound is three times.
`exact_breathing` has a disk margin of 0.11 at 100 poses with a head that is believed twice as heavy as it is
(`stewart-drake margins exact_breathing --set model.robot.platform_mass=2`); at three times no pose is stable.

Drake's plant at its usual step of 1 ms responds about half a step sooner than this linear loop. At 0.1 ms the agreement
is at least five times better (`tests/analysis/test_linear_loop.py`). A fast loop that is unstable here, such as the
PID with differences of readings at some poses, may look stable at 1 ms.

*Disk*: each motor gives (1 + d/2) / (1 - d/2) times its command, d complex; the loop is stable while every |d| is
below the disk margin. It covers gain and phase at once: 0.45 means gains from 0.63 to 1.58 or 25 deg. *All at
once*: each motor has its own d (structured singular value, upper bound); gain, phase and delay follow from it. *One
motor*: the other motors are nominal; gain, phase and delay are the classical margins. Delay is in addition to the
loop's own, in ticks of its period. Each number is the worst of all poses; a second number is the median.

| loop | stable | all at once: {margins} | one motor: {margins} |
|---|---|---|---|---|---|---|---|---|---|
{rows}

The bounds of mu are apart by at most {gap:.1g} %; {left_out}

The loop for slow buses has {slow_most:.2f} or more at 95 % of the poses. At the worst of all poses the head leans by
{lean:.0f} deg, and may fall if motors give {slow_low:.2f} of the torque that they are asked for, or less.{falls}

## Until it diverges

The nonlinear loop on the closed form with steps of 0.1 ms, at {confirmed} of the poses: the worst of the row and the
first two. It starts {push:,} ticks before a push of 5 ms. All motors give less or more torque than they are asked for,
by one factor from {least:g} to {most:g}, or all commands come later than the controller believes, by whole ticks, until
more than a tenth of the error that the push causes is left {left:,} to {end:,} ticks later. With less gain the head
sags at first, and what is left of that counts too. *Linear*: where the spectral radius of the same loop is 1.

{diverges}

## The second row in full

`stewart-drake margins --set {setting}`:

| | {header} |
|---|---|---|---|---|---|---|
{table}

{facts}

![Disk margin by frequency, and its distribution over the poses](../images/margins.png)

`make results` recomputes some of these numbers.
"""


FALLS = """ With a head
that is believed {share:.2f} times as heavy it may fall at {count} poses, where it leans by {least:.0f} deg or more, and
has {most:.2f} or more at 95 %: let it learn before it leans that far."""


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


def worst_corner(scenario):
    """The corner of the shipped policy's box with the least disk margin, all at once, at a few poses."""
    policy, poses = Policy.load(), poses_to_stand_at(scenario, POSES, seed=0)[:FEW]
    corners = [policy.lowest + policy.width * ends for ends in itertools.product((0.0, 1.0), repeat=len(NAMES))]
    found = [loop_margins(linear_loops(at_setting(scenario, each), poses), 120) for each in corners]
    return corners[int(np.argmin([each.all_at_once.disk.min() for each in found]))]


def lean_at(pose):
    """[deg] of a head from the vertical."""
    return np.degrees(np.arccos(np.cos(pose[:2]).prod()))


def words_of(setting):
    """A setting of the policy, by its names."""
    return ", ".join(f"{name} {value:+.2g}" for name, value in zip(NAMES, setting, strict=True))


def at_setting(scenario, setting):
    """A scenario with a setting (4,) of a tuner."""
    return scenario.replace(with_setting(setting)(Case("hold", "paper", 0), scenario))


def scenarios(corner, reachy_corner):
    """The loops of the table by name, with the policy's worst corners."""
    found = {name: load_scenario("exact_breathing", changes) for name, changes in ROWS.items()}
    base = load_scenario("exact_breathing", [OBSERVER, BLOCK])
    found["policy, in the middle of its box"] = at_setting(base, Policy.load().centre)
    found[CORNER] = at_setting(base, corner)
    lighter, heavier = head_shares()
    found["learning, head believed lighter"] = believed(found[MAIN], lighter)
    found[HEAVIER], found[BOTH] = believed(found[MAIN], heavier), believed(found[CORNER], heavier)
    found[NOD] = load_scenario("reachy_nod")
    found["the same, policy at the worst corner of its box"] = at_setting(found[NOD], reachy_corner)
    # What linear loops leave out is left out of the simulated one too.
    found[SLOW] = load_scenario("reachy_slow_bus").replace({"adaptation": None, "controller.dead_band": 0.0})
    found[SLOW_LIGHTER], found[SLOW_HEAVIER] = (believed(found[SLOW], share) for share in (lighter, heavier))
    return found


def believed(scenario, share):
    """A scenario whose head is believed to have this share of its mass."""
    robot, controller = scenario.robot.replace(**scenario.robot.heavier(share)), scenario.controller
    changes = {"model.robot": scenario.robot.heavier(share)}
    if getattr(controller, "inertia", "diagonal") == "robot":
        # What learns changes the inertia, not what the gains are for.
        share = heave_inertia(robot) / heave_inertia(scenario.robot)
        changes |= {f"controller.{name}": share * getattr(controller, name) for name in ("kp", "ki", "kd")}
    return scenario.replace(changes)


def head_shares():
    """How much lighter and heavier a head may be believed before anything has been seen of it."""
    return np.exp(1.96 * SIZE_HEAD * np.array([-1.0, 1.0]))


def simulated(scenario, pose):
    """Whether a loop forgets a push at a pose, by the gain of all motors and ticks of delay that nobody believes."""
    period = scenario.controller.period
    as_believed = _pushed(scenario, pose, 1.0, 0)
    at_most = FORGOTTEN * as_believed.error_norms[1][as_believed.time >= PUSH * period].max()

    def stable(gain, late):
        found = _pushed(scenario, pose, gain, late)
        return found.status == "completed" and found.error_norms[1][found.time > (END - LAST) * period].max() < at_most

    return stable


def _pushed(scenario, pose, gain, late):
    force, period = 0.003 * scenario.robot.effort_limit, scenario.controller.period
    push = {
        "kind": "impulse",
        "impulse": [0.0, 0.0, 0.0, force, force, force],
        "time": PUSH * period,
        "duration": 0.005,
    }
    keys = {
        "plant": {"kind": "closed_form", "time_step": 1e-4, "motor_friction": 0.0},
        "motors": {"kind": "current", "torque_constant": gain},
        "model.motors": {"kind": "current"},
        "model.friction": None,
        "model.noise": scenario.controller_model.noise,
        "model.delay": scenario.command_delay,
        "command_delay": scenario.command_delay + late,
        "sensors.noise": 0.0,
        "sensors.resolution_bits": 30,
        "disturbances": [push],
        "reference": {"kind": "hold", "pose": pose.tolist()},
        "duration": END * period,
        "safety": None,
        "bounds": {"error_ratio": None},
        "log_period": period,
    }
    return simulate_unchecked(scenario.replace(keys))


def linear(scenario, pose):
    """The same of the linear loop."""

    def stable(gain, late):
        delay = scenario.command_delay
        loops = linear_loops(scenario.replace({"model.delay": delay, "command_delay": delay + late}), pose[None])
        return np.abs(np.linalg.eigvals(loops.a[0] + gain * loops.b[0] @ loops.c[0])).max() < 1.0

    return stable


def limits(stable):
    """The gains at which a loop stops being stable, less and more than 1, within 1 %, and the ticks that it bears."""
    found = []
    for fails in GAINS:
        works = 1.0
        while abs(np.log(fails / works)) > 0.01:
            middle = np.sqrt(works * fails)
            works, fails = (middle, fails) if stable(middle, 0) else (works, middle)
        found.append(f"{np.sqrt(works * fails):.2f}")
    return *found, next(late for late in itertools.count(1) if not stable(1.0, late)) - 1


def until_it_diverges(loops, worst):
    """A table of some loops, each at its worst pose and at the first of all."""
    rows = []
    for name in (MAIN, CORNER, HEAVIER, BOTH, SLOW):
        scenario = loops[name]
        poses = poses_to_stand_at(scenario, POSES, seed=0)
        for k, pose in enumerate([worst[name], *poses[: CONFIRMED - 1]]):
            both = zip(*(limits(way(scenario, pose)) for way in (simulated, linear)), strict=True)
            rows.append([name, k + 1, *itertools.chain(*both)])
            print(rows[-1], flush=True)
    header = ["loop", "pose", "less gain", "linear", "more gain", "linear", "ticks more that it bears", "linear"]
    return markdown_table(header, rows)


def main():
    """Writes the file and the picture."""
    lines, gaps, left_out, worst = [], [], [], {}
    corner = worst_corner(load_scenario("exact_breathing", [OBSERVER, BLOCK]))
    reachy_corner = worst_corner(load_scenario("reachy_nod"))
    of_rows = scenarios(corner, reachy_corner)
    for name, scenario in of_rows.items():
        start = time.process_time()
        loops = linear_loops(scenario, poses_to_stand_at(scenario, POSES, seed=0))
        found = loop_margins(loops)
        lines.append(row(name, loops, found))
        stable = found.radius < 1.0
        gaps.append(np.max(found.not_above[stable] / found.all_at_once.disk[stable] - 1.0, initial=0.0))
        left_out += [name] * bool(loops.left_out)
        worst[name] = loops.poses[int(found.all_at_once.disk.argmin())]
        print(f"{time.process_time() - start:.1f} s: {lines[-1]}", flush=True)
        if name == SLOW:
            disk = found.all_at_once.disk
            slow_most, slow_low = np.quantile(disk, 0.05), found.all_at_once.gain_low.max()
            lean = lean_at(worst[name])
        if name == SLOW_LIGHTER:
            most, falling = np.quantile(found.all_at_once.disk, 0.05), [lean_at(pose) for pose in loops.poses[~stable]]
            falls = FALLS.format(share=head_shares()[0], count=len(falling), least=min(falling, default=90), most=most)
        if name == MAIN:
            plot_margins(found, Path(__file__).parents[1] / "images" / "margins.png")
            kept = [f"| {' | '.join(cells)} |" for cells in table(found, loops.period)]
            told = "\n".join(f"- {key}: {value}" for key, value in facts(loops, found))
    lighter, heavier = head_shares()
    text = TEXT.format(
        poses=POSES,
        few=FEW,
        corner=words_of(corner),
        reachy_corner="the same" if (reachy_corner == corner).all() else words_of(reachy_corner),
        lighter=lighter,
        heavier=heavier,
        confirmed=CONFIRMED,
        push=PUSH,
        left=END - LAST - PUSH,
        end=END - PUSH,
        least=GAINS[0],
        most=GAINS[1],
        diverges=until_it_diverges(of_rows, worst),
        box=NEAR.words,
        margins="disk | gain | phase [deg] | delay [ticks]",
        rows="\n".join(lines),
        gap=100.0 * max(gaps),
        slow_most=slow_most,
        slow_low=slow_low,
        lean=lean,
        falls=falls,
        left_out=f"poses were left out of: {', '.join(left_out)}." if left_out else "no pose was left out.",
        setting=f'"{WEIGHTS}"',
        header=" | ".join(HEADER[1:]),
        table="\n".join(kept),
        facts=told,
    )
    (OUT / "margins.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
