"""Throws the MJCF of `write-mjcf` about by torques, as a policy that has learnt nothing does, and counts what diverges.

python docs/scripts/mjcf_torques.py [RUNS]: for every robot of the package, RUNS = 1,000 runs of 2 s at 1 ms with sines
and as many with random steps of torque, up to 0.1 N m and up to the effort limits.
"""

import sys

import mujoco
import numpy as np

from stewart_drake.plant.model_files import mjcf_text
from stewart_drake.robot.leg import JOINT_SWING
from stewart_drake.robot.robot_files import load_robot, robot_names

HOLD = 20  # Steps for which a random torque is held.


def diverged(model: mujoco.MjModel, limits: np.ndarray, seed: int, random: bool) -> bool:
    """Whether a run of 2 s ends in numbers that are not finite, or absurd."""
    data, draw = mujoco.MjData(model), np.random.default_rng(seed)
    phase, size, step = draw.uniform(0.0, 6.0, 6), limits * draw.uniform(0.2, 1.0, 6), 0
    while data.time < 2.0:
        if not random:
            data.ctrl[:] = size * np.sin(6.0 * data.time + phase)
        elif step % HOLD == 0:
            data.ctrl[:] = limits * draw.uniform(-1.0, 1.0, 6)
        mujoco.mj_step(model, data)
        step += 1
        if not np.isfinite(data.qacc).all() or np.abs(data.qacc).max() > 1e10:
            return True
    return False


def main(runs: int) -> None:
    """Prints a line for every robot and kind of torque."""
    for name in robot_names():
        robot = load_robot(name)
        text = mjcf_text(robot, joint_swing=JOINT_SWING).replace('integrator="Euler"', 'integrator="implicitfast"')
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        for limits in (np.full(6, 0.1), robot.effort_limits):
            for random in (False, True):
                lost = sum(diverged(model, limits, seed, random) for seed in range(runs))
                kind = "random steps" if random else "sines"
                print(f"{name}, {kind} up to {limits.max():.3g} N m: {lost} of {runs} diverge", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
