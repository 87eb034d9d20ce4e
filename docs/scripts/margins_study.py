"""Margins of the linear loop over the near box, and docs/results/margins.md: `make results/margins`."""

import itertools
import time
from pathlib import Path

import numpy as np

from stewart_drake.analysis.feasibility import NEAR
from stewart_drake.analysis.linear_loop import linear_loops, poses_to_stand_at
from stewart_drake.analysis.margins import loop_margins, quantities, spread
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
POSES, FEW = 1000, 10
"""Poses; of them those at which the worst corner of the policy's box is looked for."""
DIVERGES = ("loop", "less gain", "linear", "more gain", "linear", "more delay [ticks]", "linear")
PUSH, END, LAST, FORGOTTEN = 2000, 3000, 200, 0.1
"""[ticks] of a simulated run: its push, its end, the last ones; and what may be left there of the error, as a share."""
GAINS = (0.05, 6.0)
"""Gains between which that is looked for at which a loop diverges."""
BLOCK = "tuner={kind: block}"
OBSERVER = "estimator.kind=observer"
WEIGHTS = "tuner={kind: block, q_pose: 8.0e5, q_rate: 150.0, q_integral: 5.0e6}"
MAIN, CORNER = "observer", "policy, worst corner of its range"
HEAVIER, BOTH = "learning, head too heavy in the model", "policy at that corner, head too heavy in the model"
NOD, SLOW = "LQI, observer, start weights, as in `reachy_nod`", "PID for slow buses, as in `reachy_slow_bus`"
SLOW_LIGHTER, SLOW_HEAVIER = "the same, head too light in the model", "the same, head too heavy in the model"
DIFFERENCES = "estimator={kind: difference, rate_cutoff: 150}"
ROWS = {
    "difference of readings, low pass of 150 Hz; default weights": (
        DIFFERENCES,
        BLOCK,
    ),
    MAIN: (OBSERVER, WEIGHTS),
    "observer, default weights": (OBSERVER, BLOCK),
    "observer, disturbance 40": (OBSERVER, WEIGHTS, "estimator.disturbance=40"),
    **{f"observer, {ticks} ticks of delay": (OBSERVER, WEIGHTS, f"command_delay={ticks}") for ticks in (0, 4)},
    "observer, 10 ms, 1 tick of delay, default weights": (OBSERVER, "controller.period=0.01", BLOCK),
    "observer, platform 30 % too heavy in the model": (OBSERVER, WEIGHTS, "model.robot={platform_mass: 1.3}"),
    "computed torque, observer": (OBSERVER, WEIGHTS, "controller={kind: computed_torque}"),
    "joint-space PID, observer": (OBSERVER, WEIGHTS, "controller={kind: pid}"),
    "joint-space PID, difference of readings": (DIFFERENCES, BLOCK, "controller={kind: pid}"),
}
TEXT = """# How far the loop is from instability

How much wrong gain, and how much more delay, does the loop tolerate at any pose?
Command: `make results/margins`, five minutes;
`stewart-drake margins` for a scenario of your own.

| loop | stable, of {poses} | {margins} |
|---|---|---|---|---|---|
{rows}

![Disk margin by frequency, and its distribution over the poses](../images/margins.png)

- The loop of `exact_breathing`, linearised at {poses} random poses near home
  ({box}; seed 0)
  and opened at the six motor torques: 1 ms and 1 tick of delay unless a row gives others. The last five rows are Reachy
  Mini by torque at 100 Hz. Each number is the worst of all poses; after a comma, the median.
- *Disk*: the loop is stable while each motor gives (1 + d/2) / (1 - d/2) times its command and the complex |d| is below
  this margin. It covers gain and phase together: 0.45 means gains from 0.63 to 1.58, or 25 deg. Every
  motor has a d of its own. Delay is in addition to the loop's.
- Rows of policy and learning are extremes, frozen: the middle of the policy's range and its worst corner ({corner};
  Reachy Mini: {reachy_corner}); a head whose mass in the model is {lighter:.2f} or {heavier:.2f} times the true one,
  which is how far learning may be off before it has seen anything (95 %).
- The loop for slow buses has {slow_most:.2f} or more at 95 % of the poses. At the worst pose the head leans by
  {lean:.0f} deg, and may fall if motors give {slow_low:.2f} of their torque or less.{falls}
- Friction, saturation, encoder resolution and changes of weights are not in these loops. Drake's plant at 1 ms responds
  half a step sooner, so a fast loop that is unstable here may look stable there.

Worst pose of the row *{main}*: {pose} [rad, m].
Its weights: `--set "{weights}"`.

## Until it diverges

Do these margins hold in a simulation? The nonlinear loop on the closed form at the worst pose of the row, with steps of
0.1 ms: all motors give less or more torque than they are asked for, or commands come later, until a push is not
forgotten. *Linear*: where the spectral radius of the linear loop is 1.

{diverges}
"""


FALLS = """ With {share:.2f} times
  its mass in the model it may fall at {count} poses, where it leans by {least:.0f} deg or more: let it learn before it
  leans that far."""


def row(name, loops, found):
    """A line of the first table."""
    worst = {key: spread(all_, key == "gain_low") for key, _, _, all_ in quantities(found, loops.period)}
    disk, low, high = (worst[key] for key in ("disk", "gain_low", "gain_high"))
    cells = [
        f"{disk[0]:.3f}, {disk[2]:.3f}",
        f"{low[0]:.2f} to {high[0]:.2f}",
        f"{worst['phase_deg'][0]:.1f}",
        f"{worst['delay_ticks'][0]:.2f}",
    ]
    return f"| {name} | {(found.radius < 1.0).sum()} | {' | '.join(cells)} |"


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
    found["policy, middle of its range"] = at_setting(base, Policy.load().centre)
    found[CORNER] = at_setting(base, corner)
    lighter, heavier = head_shares()
    found["learning, head too light in the model"] = modelled(found[MAIN], lighter)
    found[HEAVIER], found[BOTH] = modelled(found[MAIN], heavier), modelled(found[CORNER], heavier)
    found[NOD] = load_scenario("reachy_nod")
    found["the same, policy, worst corner of its range"] = at_setting(found[NOD], reachy_corner)
    # What linear loops leave out is left out of the simulated one too.
    found[SLOW] = load_scenario("reachy_slow_bus").replace({"adaptation": None, "controller.dead_band": 0.0})
    found[SLOW_LIGHTER], found[SLOW_HEAVIER] = (modelled(found[SLOW], share) for share in (lighter, heavier))
    return found


def modelled(scenario, share):
    """A scenario whose model has a head of this share of its mass."""
    robot, controller = scenario.robot.replace(**scenario.robot.scaled_masses(share)), scenario.controller
    changes = {"model.robot": scenario.robot.scaled_masses(share)}
    if getattr(controller, "inertia", "diagonal") == "robot":
        # What learns changes the inertia, not what the gains are for.
        share = heave_inertia(robot) / heave_inertia(scenario.robot)
        changes |= {f"controller.{name}": share * getattr(controller, name) for name in ("kp", "ki", "kd")}
    return scenario.replace(changes)


def head_shares():
    """How much lighter and heavier than the head its model may be before anything has been seen of it."""
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
    """A table of some loops, at their worst poses."""
    rows = []
    for name in (MAIN, CORNER, HEAVIER, BOTH, SLOW):
        both = zip(*(limits(way(loops[name], worst[name])) for way in (simulated, linear)), strict=True)
        rows.append([name, *itertools.chain(*both)])
        print(rows[-1], flush=True)
    return markdown_table(DIVERGES, rows)


def main():
    """Writes the file and the picture."""
    lines, worst = [], {}
    corner = worst_corner(load_scenario("exact_breathing", [OBSERVER, BLOCK]))
    reachy_corner = worst_corner(load_scenario("reachy_nod"))
    of_rows = scenarios(corner, reachy_corner)
    for name, scenario in of_rows.items():
        start = time.process_time()
        loops = linear_loops(scenario, poses_to_stand_at(scenario, POSES, seed=0))
        found = loop_margins(loops)
        lines.append(row(name, loops, found))
        worst[name] = loops.poses[int(found.all_at_once.disk.argmin())]
        print(f"{time.process_time() - start:.1f} s: {lines[-1]}", flush=True)
        if name == SLOW:
            disk = found.all_at_once.disk
            slow_most, slow_low = np.quantile(disk, 0.05), found.all_at_once.gain_low.max()
            lean = lean_at(worst[name])
        if name == SLOW_LIGHTER:
            falling = [lean_at(pose) for pose in loops.poses[found.radius >= 1.0]]
            falls = FALLS.format(share=head_shares()[0], count=len(falling), least=min(falling, default=90))
        if name == MAIN:
            plot_margins(found, Path(__file__).parents[1] / "images" / "margins.png")
    lighter, heavier = head_shares()
    text = TEXT.format(
        poses=POSES,
        corner=words_of(corner),
        reachy_corner="the same" if (reachy_corner == corner).all() else words_of(reachy_corner),
        lighter=lighter,
        heavier=heavier,
        diverges=until_it_diverges(of_rows, worst),
        box=NEAR.words,
        margins="disk | gain | phase [deg] | delay [ticks]",
        rows="\n".join(lines),
        slow_most=slow_most,
        slow_low=slow_low,
        lean=lean,
        falls=falls,
        main=MAIN,
        weights=WEIGHTS,
        pose=", ".join(f"{value:.4g}" for value in worst[MAIN]),
    )
    (OUT / "margins.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
