"""Whether a tuner of settings can make the loop unstable, and docs/results/tuner_safety.md: `make tuner_safety`."""

import itertools
import time
from pathlib import Path

import numpy as np

from stewart_drake.analysis.linear_loop import linear_loops, poses_to_stand_at
from stewart_drake.analysis.margins import loop_margins
from stewart_drake.control.policy import NAMES, STEP, Policy, disturbance_of, weights_of
from stewart_drake.plotting import save_figure
from stewart_drake.plotting import style as look
from stewart_drake.scenario.scenario import load_scenario

DOCS = Path(__file__).parents[1]
POSES, FEW = 1000, 10
"""Poses; and of them those at which all settings have their margins looked at."""
FREQUENCIES = 120


POLICY = Policy.load()
"""Its box are the settings from `lowest` on for `width` (4,), around `centre`."""
BASE = ["tuner=block", "estimator=observer"]
LOOPS = {
    **{f"paper's robot, 1 kHz, {ticks} ticks": ("exact_breathing", f"command_delay={ticks}") for ticks in range(5)},
    "Reachy Mini, 100 Hz, 1 tick": ("reachy_nod", "command_delay=1"),
}
PICTURED = ("paper's robot, 1 kHz, 1 ticks", "Reachy Mini, 100 Hz, 1 tick")
CENTRE = ((POLICY.centre - POLICY.lowest) / POLICY.width)[None]
CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=4)))
FACES = np.concatenate([np.where(np.eye(4) > 0.0, end, CENTRE) for end in (0.0, 1.0)])
_RNG = np.random.default_rng(0)
RANDOM = np.concatenate([np.repeat(_RNG.uniform(size=(8, 3)), 2, 0), np.tile(_RNG.uniform(size=(2, 1)), (8, 1))], 1)
PLACES = np.concatenate([CENTRE, CORNERS, FACES, RANDOM])


def at_places(places):
    """Settings (..., 4) of places of the unit box."""
    return POLICY.lowest + POLICY.width * places


def named(setting):
    """A setting as a text."""
    return ", ".join(f"{name} {value:+.2g}" for name, value in zip(NAMES, setting, strict=True))


def setting_loops(scenario, poses, settings):
    """The loops at poses (m, 6) of one setting (4,) after the other, by its weights and the observer's disturbance."""
    base, names = np.array(scenario.tuner.weights), ("q_pose", "q_rate", "q_integral", "r")
    for setting in settings:
        weights = weights_of(base, setting).tolist()
        level = float(disturbance_of(scenario.estimator.disturbance, setting))
        tuner = {"kind": "block", **dict(zip(names, weights, strict=True))}
        yield linear_loops(scenario.replace({"tuner": tuner, "estimator.disturbance": level}), poses)


def frozen(name):
    """Radius (m, s) of all settings at all poses, and the least disk margin of some of them."""
    scenario = load_scenario(LOOPS[name][0], [*BASE, LOOPS[name][1]])
    poses = poses_to_stand_at(scenario, POSES, seed=0)
    loops = setting_loops(scenario, poses, at_places(PLACES))
    radius = np.stack([np.abs(np.linalg.eigvals(each.closed)).max(axis=-1) for each in loops], axis=-1)
    # All settings at a few poses, and those that are worst there at all poses.
    few = np.stack([margin_of(each) for each in setting_loops(scenario, poses[:FEW], at_places(PLACES))], axis=-1)
    order = np.argsort(few.min(axis=0))[:3]
    worst = np.stack([margin_of(each) for each in setting_loops(scenario, poses, at_places(PLACES[order]))], axis=-1)
    return scenario, radius, few, worst, order


def margin_of(loops):
    """Disk margins (s,), all motors at once."""
    return loop_margins(loops, FREQUENCIES).all_at_once.disk


def frozen_row(name):
    """A line of the table, and the decay [1/s] of all settings at all poses."""
    scenario, radius, few, worst, order = frozen(name)
    period = scenario.controller.period
    place = np.unravel_index(radius.argmax(), radius.shape)[1]
    decay = -np.log(radius) / period
    disk = min(few.min(), worst.min())
    tight = order[np.unravel_index(worst.argmin(), worst.shape)[1]]
    line = (
        f"| {name} | {(radius < 1.0).sum()} of {radius.size} | {radius.max():.5f} | {decay.min():.2f} | "
        f"{named(at_places(PLACES[place]))} | {np.median(decay[:, 0]):.2f} | {disk:.3f} | {np.median(few[:, 0]):.3f} | "
        f"{named(at_places(PLACES[tight]))} |"
    )
    return line, decay


TEXT = """# Whether a tuner of settings can make the loop unstable

`make tuner_safety` writes this page. A setting is four decades
({names}), see `control/policy.py`. Their ranges, the box: {box};
a setting changes by at most {step:g} % of its range in a tick. The decades are relative to the default weights of
`tuner: block` for each robot and to the observer's default disturbance of 16. The loops are those of
[margins](margins.md), with observer, encoders, delay and the exact model in the LQI; without friction, saturation and
encoder resolution.

There are {poses} random poses near home (seed 0) and {places} settings: the centre of the box, all corners, the centres
of all faces, and {random} random ones. *Radius* is the largest spectral radius. *Decay* is -ln(radius) per period: the
slowest, and the median over poses at the centre; the slowest mode is the integral's. *Disk* is the disk margin of all
motors at once at {frequencies} frequencies, for all settings at {few} poses and for the three worst of them at all
poses: the least, and the median at the centre.

| loop | stable | radius | slowest decay [1/s] | at | centre [1/s] | least disk | centre | at |
|---|---|---|---|---|---|---|---|---|
{frozen}

At revision eb925fb the lowest speed was -0.1: there 5 of the 41000 loops of Reachy Mini were unstable, all at one
pose, with a radius of up to 1.00139.

Changing settings were studied up to revision 1c46462 (docs/tuner_safety_study.py there). With swings between opposite
corners at the rate limit the loop decayed at 3.73 1/s or faster for the paper's robot with one tick of delay, and at
0.55 1/s or faster for Reachy Mini. With jumps instead, Reachy Mini's loop can grow.

![Decay of frozen settings](../images/tuner_safety.png)

`make results` recomputes some of these numbers.
"""


@look.styled
def picture(decays):
    """Decay over poses and settings."""
    figure, ((panel,),) = look.panels(1, 1, 4.6)
    for (name, values), color in zip(decays.items(), (look.SKY, look.ORANGE), strict=True):
        ordered = np.sort(values.ravel())
        panel.plot(ordered, 100.0 * np.arange(1, len(ordered) + 1) / len(ordered), color=color, label=name)
    look.logarithmic(panel, "x")
    title = "Settings that stay: how many decay more slowly"
    panel.set(title=title, xlabel="decay [1/s]", ylabel="of settings and poses [%]")
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18))
    save_figure(figure, DOCS / "images" / "tuner_safety.png")


def main():
    """Writes the file and the picture."""
    start, rows, decays = time.process_time(), [], {}
    for name in LOOPS:
        line, decay = frozen_row(name)
        rows.append(line)
        print(f"{time.process_time() - start:.0f} s: {line}", flush=True)
        if name in PICTURED:
            decays[name] = decay
    picture(decays)
    ends = zip(NAMES, POLICY.lowest, POLICY.lowest + POLICY.width, strict=True)
    text = TEXT.format(
        names=", ".join(NAMES),
        box=", ".join(f"{key} {low:+.2f} to {high:+.2f}" for key, low, high in ends),
        step=100.0 * STEP,
        poses=POSES,
        places=len(PLACES),
        random=len(RANDOM),
        frequencies=FREQUENCIES,
        few=FEW,
        frozen="\n".join(rows),
    )
    (DOCS / "results" / "tuner_safety.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
