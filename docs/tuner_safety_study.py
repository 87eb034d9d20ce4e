"""Whether a tuner of settings can make the loop unstable, and docs/results/tuner_safety.md: `make tuner_safety`."""

import itertools
import sys
import time
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from stewart_drake import run
from stewart_drake.control.policy import load_policy
from stewart_drake.control.settings import NAMES, STEP
from stewart_drake.control.tuners import SettingTuner
from stewart_drake.plotting import panels as look
from stewart_drake.registry import TUNERS
from stewart_drake.scenario import load_scenario
from stewart_drake.stability.chains import chains, together
from stewart_drake.stability.linear_loop import LinearLoops, poses_to_stand_at
from stewart_drake.stability.margins import loop_margins
from stewart_drake.stability.setting_loops import setting_loops
from stewart_drake.stability.switching import common_lyapunov, even, greedy, growth, monodromy, shares

HERE = Path(__file__).parent
POSES = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
FEW = max(2, POSES // 100)
"""Poses at which settings change."""
FREQUENCIES = 120


class Box(NamedTuple):
    """Settings from `lowest` on for `width` (4,), around a centre (4,)."""

    lowest: np.ndarray
    width: np.ndarray
    centre: np.ndarray

    def at(self, places):
        """Settings (..., 4) of places of the unit box."""
        return self.lowest + self.width * places


def shipped_box():
    """The box of the policy that is shipped."""
    policy = load_policy()
    return Box(policy.lowest, policy.width, policy.centre)


BOX = shipped_box()
BASE = ["tuner=block", "estimator=observer"]
LOOPS = {
    **{f"paper's robot, 1 kHz, {ticks} ticks": ("exact_breathing", f"command_delay={ticks}") for ticks in range(5)},
    "Reachy Mini, 100 Hz, 1 tick": ("reachy_nod", "command_delay=1"),
}
TUNERS_OF_SETTINGS = "systems.setting_tuner:add_setting_tuner", "control.tuners:chosen_settings"
CENTRE = ((BOX.centre - BOX.lowest) / BOX.width)[None]
CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=4)))
FACES = np.concatenate([np.where(np.eye(4) > 0.0, end, CENTRE) for end in (0.0, 1.0)])
_RNG = np.random.default_rng(0)
RANDOM = np.concatenate([np.repeat(_RNG.uniform(size=(8, 3)), 2, 0), np.tile(_RNG.uniform(size=(2, 1)), (8, 1))], 1)
PLACES = np.concatenate([CENTRE, CORNERS, FACES, RANDOM])
KNOTS = (5, 3, 3, 5)
PERIODS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.6, 0.8, 1.2, 2.0)
"""[s] of settings that go from one corner of the box to the opposite one and back."""


def named(setting):
    """A setting as a text."""
    return ", ".join(f"{name} {value:+.2g}" for name, value in zip(NAMES, setting, strict=True))


def stacked(parts):
    """Loops of several poses as one."""
    a, b, c, period, poses, left_out = zip(*parts, strict=True)
    arrays = (np.concatenate(each) for each in (a, b, c))
    return LinearLoops(*arrays, period[0], np.concatenate(poses), left_out[0])


def frozen(name, places=PLACES):
    """Radius (m, s) of all settings at all poses, poses, and the least disk margin of some of them."""
    scenario = load_scenario(LOOPS[name][0], [*BASE, LOOPS[name][1]])
    poses = poses_to_stand_at(scenario, POSES, seed=0)
    radius = np.array(
        [np.abs(np.linalg.eigvals(each.closed)).max(axis=-1) for each in setting_loops(scenario, poses, BOX.at(places))]
    )
    # All settings at a few poses, and those that are worst there at all poses.
    few = np.array([margin_of(each) for each in setting_loops(scenario, poses[:FEW], BOX.at(places))])
    order = np.argsort(few.min(axis=0))[:3]
    every = setting_loops(scenario, poses, BOX.at(places[order]))
    blocks = iter(lambda: list(itertools.islice(every, 50)), [])
    worst = np.concatenate([margin_of(stacked(block)).reshape(-1, 3) for block in blocks])
    return scenario, poses, radius, few, worst, order


def margin_of(loops):
    """Disk margins (s,), all motors at once."""
    return loop_margins(loops, FREQUENCIES).all_at_once.disk


def frozen_row(name):
    """A line of the table of frozen loops, the poses that are worst, and the decay [1/s] of all settings."""
    scenario, poses, radius, few, worst, order = frozen(name)
    period = scenario.controller.period
    pose, place = np.unravel_index(radius.argmax(), radius.shape)
    decay = -np.log(radius) / period
    disk = min(few.min(), worst.min())
    tight = order[np.unravel_index(worst.argmin(), worst.shape)[1]]
    line = (
        f"| {name} | {(radius < 1.0).sum()} of {radius.size} | {radius.max():.5f} | {decay.min():.2f} | "
        f"{named(BOX.at(PLACES[place]))} | {np.median(decay[:, 0]):.2f} | {disk:.3f} | {np.median(few[:, 0]):.3f} | "
        f"{named(BOX.at(PLACES[tight]))} |"
    )
    chosen = np.unique([pose, worst.min(axis=-1).argmin(), radius.max(axis=-1).argmin(), *range(FEW)])[:FEW]
    return line, poses[np.unique([pose, worst.min(axis=-1).argmin(), *chosen])], decay


def share_of_box(scenario, pose):
    """Largest part of the box, to 0.05, over which settings may jump at will, and by what [1/s] a norm then falls."""
    good, bad, fall = 0, 21, 0.0
    while bad - good > 1:
        middle = (good + bad) // 2
        fastest = common_growth(scenario, pose, 0.05 * middle)
        if fastest < 1.0:
            good, fall = middle, -np.log(fastest) / scenario.controller.period
        else:
            bad = middle
    return 0.05 * good, fall


def common_growth(scenario, pose, share):
    """By what factor a common norm of the whole loop grows in a tick over a part of the box; infinite without one."""
    vertices = CENTRE + share * (np.concatenate([CENTRE, CORNERS, FACES]) - CENTRE)
    between = CENTRE + share * (np.random.default_rng(1).uniform(size=(40, 4)) - CENTRE)
    loops = next(setting_loops(scenario, pose[None], BOX.at(vertices)))
    found, norms = chains(loops, scenario.lqi.length), []
    for each in found.matrices:
        norms.append(common_lyapunov(each))
        if norms[-1] is None:
            return np.inf
    closed = next(setting_loops(scenario, pose[None], BOX.at(np.concatenate([vertices, between])))).closed
    one = np.ones((len(closed), 1))
    return growth(closed, together(found.axes, np.stack(norms)[:, None]), one, one[:, None]).max()


def swings(step, period, tick):
    """Places (k, 4) through which opposite corners are visited in turn; each number moves at most a step a tick."""
    count = max(2, round(period / tick))
    wanted = np.where(np.arange(count) < count // 2, 1.0, 0.0)
    place, path = 0.0, []
    for _ in range(3):
        path = []
        for each in wanted:
            place += np.clip(each - place, -step, step)
            path.append(place)
    return np.array(path)


class Switched(NamedTuple):
    """What comes of settings that change at one pose.

    Attributes:
        limited: (p,) [1/s] least decay of swings between opposite corners at the rate limit, for each period.
        jumping: (p,) the same with jumps.
        adversary: Largest norm of a greedy adversary's state, from 1, over the largest norm at any frozen corner.
        left: Share of that largest norm that is left after 3 s.
        random: [1/s] least decay of settings that wander at random.
    """

    limited: np.ndarray
    jumping: np.ndarray
    adversary: float
    left: float
    random: float


def switched(scenario, pose):
    """See `Switched`; by the six chains of the loop."""
    tick = scenario.controller.period
    knots = np.array(list(itertools.product(*[np.linspace(0.0, 1.0, count) for count in KNOTS])))
    loops = next(setting_loops(scenario, pose[None], BOX.at(np.concatenate([CENTRE, knots]))))
    rng = np.random.default_rng(2)
    limited, jumping, wander, grown, left = [], [], [], [], []
    ticks = round(3.0 / tick)
    for each in chains(loops, scenario.lqi.length).matrices:
        inward = even(each[0])
        matrices = (inward @ each @ np.linalg.inv(inward))[1:]
        for limit, into in ((STEP, limited), (1.0, jumping)):
            paths = [swings(limit, period, tick)[:, None] for period in PERIODS]
            for corner in CORNERS:
                mixed = [shares(corner + path * (1.0 - 2.0 * corner), KNOTS) for path in paths]
                into.append([-np.log(monodromy(np.tensordot(each, matrices, 1))) / tick for each in mixed])
        kept = [np.linalg.matrix_power(matrices[at], count) for at in corners_of(KNOTS) for count in powers(ticks)]
        calm = np.linalg.norm(kept, 2, axis=(1, 2)).max()
        for _ in range(2):
            state = rng.normal(size=matrices.shape[-1])
            sizes = np.array(
                [
                    np.linalg.norm(x)
                    for x, _ in greedy(CENTRE[0], matrices, KNOTS, STEP, state / np.linalg.norm(state), ticks)
                ]
            )
            grown.append(sizes.max() / calm)
            left.append(sizes[-1] / sizes.max())
            wander.append(wandering(rng, matrices, STEP, ticks) / tick)
    return Switched(np.min(limited, axis=0), np.min(jumping, axis=0), max(grown), max(left), min(wander))


def corners_of(knots):
    """Places of the corners of the box among the knots."""
    found = shares(CORNERS, knots)
    return found.argmax(axis=-1)


def powers(ticks):
    """Numbers of ticks at which a frozen loop is looked at."""
    return np.unique(np.geomspace(1, ticks, 40).astype(int))


def wandering(rng, matrices, step, ticks):
    """Mean decay a tick of a state while the setting goes to one random corner after the other."""
    place, target, state, total = CENTRE[0], CENTRE[0], rng.normal(size=matrices.shape[-1]), 0.0
    state = state / np.linalg.norm(state)
    for _ in range(ticks):
        if rng.uniform() < step / 2.0:
            target = rng.integers(0, 2, 4).astype(float)
        place = place + np.clip(target - place, -step, step)
        state = np.tensordot(shares(place, KNOTS), matrices @ state, 1)
        size = np.linalg.norm(state)
        total, state = total - np.log(size), state / size
    return total / ticks


class Player:
    """Wants two opposite corners in turn; see `control.policy.Chooser`."""

    def __init__(self, corner, half):
        self.centre, self.lowest, self.width = BOX.centre, BOX.lowest, BOX.width
        self.first, self.half = np.array(corner), half

    def choose(self, _, held, period):
        """The first corner, or the other; it remembers the time."""
        second = self.half > 0.0 and held % (2.0 * self.half) >= self.half
        return BOX.at(1.0 - self.first if second else self.first), 1.0, held + period

    def compiled(self):
        """Nothing to compile."""
        return self


class SequenceTuner(SettingTuner):
    """Settings that go from one corner of the box to the opposite one and back."""

    kind: Literal["sequence"] = "sequence"
    corner: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """First corner, of the unit box."""
    half: float = 0.0
    """[s] at each corner; 0 for the first one alone."""

    def chooser(self):
        """See `SettingTuner.chooser`."""
        return Player(self.corner, self.half)


HALVES = (0.0, 0.1, 0.4, 0.8)
"""[s] at each corner, the way to it included; 0 for a corner that stays."""
PUSHED = {"paper's robot, 1 kHz, 1 ticks": 5.0, "Reachy Mini, 100 Hz, 1 tick": 0.4}
"""[N] along X and -Z, from 0.8 s to 1.6 s of 2.5 s."""


def pushed(name):
    """Ends (halves, corners) and largest errors [mm] of runs with a push, for each of `HALVES`."""
    changes = [*BASE, LOOPS[name][1], "plant.engine=reduced", "duration=2.5"]
    base, force = load_scenario(LOOPS[name][0], changes), PUSHED[name]
    push = {"kind": "step", "wrench": [0.0, 0.0, 0.0, force, 0.0, -force], "time": 0.8, "until": 1.6}
    base = base.replace({"disturbances": [push], "tuner": "sequence"})
    ends, errors = [], np.zeros((len(HALVES), len(CORNERS)))
    for k, half in enumerate(HALVES):
        for j, corner in enumerate(CORNERS):
            log = run(base.replace({"tuner.corner": tuple(corner.tolist()), "tuner.half": half}), check=False)
            ends.append(log.status)
            errors[k, j] = 1e3 * np.linalg.norm((log["pose"] - log["reference"][:, :6])[:, 3:], axis=1).max()
    return np.reshape(ends, errors.shape), errors


TEXT = """# Whether a tuner of settings can make the loop unstable

`make tuner_safety` (this page: `python docs/tuner_safety_study.py {poses}`). A setting is four decades
({names}), see `control/settings.py`. The box: {box};
a setting moves by {step:g} % of it in a tick. Base: the default weights of `tuner: block` for each robot, and the
observer's own disturbance of 16. Loops: those of [margins](margins.md), with observer, encoders, delay and the exact
model in the LQI; no friction, no saturation, no counts.

## A setting that stays

{poses} poses of the near box (seed 0) and {places} settings: the centre, all corners, the centres of all faces, and
{random} more. *Radius*: largest spectral radius of all. *Decay*: -ln(radius) per period, the slowest of all, and the
median over poses at the centre of the box; the slowest mode is that of the integral. *Disk*: disk margin of all motors
at once, {frequencies} frequencies, all settings at {few} poses and the three worst of them at all poses; least of all,
and the median at the centre.

| loop | stable | radius | slowest decay [1/s] | at | centre [1/s] | least disk | centre | at |
|---|---|---|---|---|---|---|---|---|
{frozen}

At eb925fb the box went down to a speed of -0.1: there 5 of the 41000 loops of Reachy Mini were unstable, all at one
pose, with a radius of up to 1.00139.

## A setting that changes

At {few_poses} poses for each loop, those with the largest radius and the least disk margin among them.

*Jumps*: the largest part of the box, about its centre and to 0.05, over which settings may change at will because one
quadratic norm of the whole loop falls at every tick, a common Lyapunov function: found by a semidefinite program for
the six chains of the loop (`stability/chains.py`) at centre, corners and faces of that part, then looked at in the
whole loop, there and at 40 more settings in between. Fall: of that norm [1/s]. *Swings*: from a corner towards the
opposite one and back, as far as {step:g} % a tick allow, {periods} periods from {shortest:g} to {longest:g} s, all
corners: decay of the slowest Floquet multiplier, and that of jumps for comparison. *Adversary*: moves the setting, at
the rate limit, to where the state grows most in the next tick, for 3 s, in the norm that is fair to the centre: largest
state from 1, over the largest that any corner alone makes of it; and how much of it is left in the end. *Wandering*:
random corners, mean decay of the slowest. Decays in 1/s.

| loop | share for jumps: least, median | fall | swings: least decay | with jumps | adversary | left | wandering |
|---|---|---|---|---|---|---|---|
{switched}

{verdict}

## Runs with friction, noise and a push

On the reduced engine, the motions of `exact_breathing` and `reachy_nod` with a push ({pushes}): largest error of the
position [mm] over the 16 corners, each alone, and with swings towards the opposite one, each way for so long, and how
many of these runs were completed.

| loop | corner alone, worst | {halves} |
|---|---|{lines}|
{pushed}

![Decay of frozen settings and of swings](../images/tuner_safety.png)
"""


def picture(decays, periods):
    """Decay over poses and settings, and of swings by their period."""
    figure, ((left, right),) = look.panels(1, 2, 4.6)
    for (name, values), color in zip(decays.items(), (look.SKY, look.ORANGE), strict=True):
        ordered = np.sort(values.ravel())
        left.plot(ordered, 100.0 * np.arange(1, len(ordered) + 1) / len(ordered), color=color, label=name)
        limited, jumping = periods[name]
        right.plot(PERIODS, limited, color=color, label=f"{name}, {100.0 * STEP:g} % a tick")
        right.plot(PERIODS, jumping, color=color, ls=":", label=f"{name}, jumps")
    right.axhline(0.0, color=look.QUIET, lw=0.8)
    look.logarithmic(left, "x")
    look.logarithmic(right, "x")
    look.label(left, "Settings that stay: how many decay more slowly", "decay [1/s]", "of settings and poses [%]")
    look.label(right, "Swings from corner to corner", "period [s]", "slowest decay [1/s]")
    for panel in (left, right):
        look.legend(panel, loc="upper center", bbox_to_anchor=(0.5, -0.18))
    figure.savefig(HERE / "images" / "tuner_safety.png", dpi=130)


def main():
    """Writes the file and the picture."""
    TUNERS.add(SequenceTuner, *TUNERS_OF_SETTINGS)
    start, frozen_rows, rows, decays, curves, pushes, worst = time.process_time(), [], [], {}, {}, [], []
    for name, (scenario_name, change) in LOOPS.items():
        line, poses, decay = frozen_row(name)
        frozen_rows.append(line)
        print(f"{time.process_time() - start:.0f} s: {line}", flush=True)
        if name not in PUSHED:
            continue
        decays[name] = decay
        scenario = load_scenario(scenario_name, [*BASE, change])
        free = [share_of_box(scenario, pose) for pose in poses]
        found = [switched(scenario, pose) for pose in poses]
        curves[name] = tuple(
            np.min([getattr(each, which) for each in found], axis=0) for which in ("limited", "jumping")
        )
        share, fall = np.array(free).T
        worst.append(min(each.limited.min() for each in found))
        rows.append(
            f"| {name} | {share.min():.2f}, {np.median(share):.2f} | {fall.min():.2f} | {worst[-1]:.2f} | "
            f"{min(each.jumping.min() for each in found):.2f} | {max(each.adversary for each in found):.2f} | "
            f"{max(each.left for each in found):.1e} | {min(each.random for each in found):.2f} |"
        )
        print(f"{time.process_time() - start:.0f} s: {rows[-1]}", flush=True)
        ends, errors = pushed(name)
        parts = [
            f"{own.max():.2f}, {(end == 'completed').sum()} of {len(end)}"
            for own, end in zip(errors, ends, strict=True)
        ]
        pushes.append(f"| {name} | {' | '.join(parts)} |")
        print(f"{time.process_time() - start:.0f} s: {pushes[-1]}", flush=True)
    picture(decays, curves)
    ends = zip(NAMES, BOX.lowest, BOX.lowest + BOX.width, strict=True)
    text = TEXT.format(
        names=", ".join(NAMES),
        box=", ".join(f"{key} {low:+.2f} to {high:+.2f}" for key, low, high in ends),
        step=100.0 * STEP,
        poses=POSES,
        places=len(PLACES),
        random=len(RANDOM),
        frequencies=FREQUENCIES,
        few=FEW,
        few_poses=len(found),
        frozen="\n".join(frozen_rows),
        periods=len(PERIODS),
        shortest=PERIODS[0],
        longest=PERIODS[-1],
        switched="\n".join(rows),
        verdict="All swings at the rate limit decay." if min(worst) > 0.0 else "Some swings at the rate limit grow.",
        pushes=", ".join(f"{force:g} N along X and -Z: {name}" for name, force in PUSHED.items()),
        halves=" | ".join(f"swings, {half:g} s" for half in HALVES[1:]),
        lines="|".join(["---"] * (len(HALVES) - 1)),
        pushed="\n".join(pushes),
    )
    (HERE / "results" / "tuner_safety.md").write_text(text)


if __name__ == "__main__":
    main()
