"""Section II.C: the multibody plant that stands in for the paper's Adams model moves as rigid-body mechanics says."""

from __future__ import annotations

from functools import partial

import numpy as np
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp

from stewart_drake.errors import RunFailure
from stewart_drake.mechanics.dynamics import task_bias, task_inertia
from stewart_drake.mechanics.kinematics import twist_jacobian, twist_to_pose_rate
from stewart_drake.paper.study import Claim, Result, Study
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plotting.panels import chart
from stewart_drake.robot import RobotParameters

START = np.array([0.1, -0.05, 0.1, 0.01, -0.02, 0.01])
"""[rad, m] from home: where the free motion starts, at rest."""
TORQUE = np.array([0.2, 0.3, 0.25, 0.3, 0.2, 0.3])
"""[N m] held constant meanwhile."""
DURATION = 0.15
"""[s]"""


def exact_motion(robot: RobotParameters, gravity: float, time: float = DURATION) -> np.ndarray:
    """Pose (6,) [rad, m] after `time` of `TORQUE` from rest at `START`, by the closed-form model, to about 1e-12."""

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        pose, twist = state[:6], state[6:]
        load = twist_jacobian(robot, pose).T @ TORQUE - task_bias(robot, pose, twist, gravity)
        return np.concatenate([twist_to_pose_rate(pose, twist), np.linalg.solve(task_inertia(robot, pose), load)])

    start = np.concatenate([robot.home_pose + START, np.zeros(6)])
    result = solve_ivp(derivative, (0.0, time), start, method="DOP853", rtol=1e-12, atol=1e-13)
    if not result.success:
        raise RunFailure(f"the free motion could not be integrated beyond {result.t[-1]:.3g} s: {result.message}")
    return result.y[:6, -1]


def plant_motion(robot: RobotParameters, gravity: float, time_step: float) -> tuple[np.ndarray, float]:
    """Pose (6,) [rad, m] of Drake's plant after the same motion, and its largest loop gap [m]."""
    diagram, plant = build_plant(robot, PlantOptions(time_step=time_step), gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("torque").FixValue(context, TORQUE)
    plant.set_state(context, robot.home_pose + START)
    simulator.AdvanceTo(round(DURATION / time_step) * plant.plant.time_step())
    state = diagram.GetOutputPort("state").Eval(context)
    return plant.pose_and_rate(state)[0], float(plant.loop_gap(state).max())


def observed_orders(steps: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Order of convergence between neighbouring steps, log(error ratio) / log(step ratio); (n - 1,)."""
    return np.diff(np.log(errors)) / np.diff(np.log(steps))


def reproduce(study: Study) -> Result:
    """Free motion for ever smaller steps of the plant, against the exact one."""
    robot, gravity = study.base.robot, study.base.gravity
    steps = np.array(study.pick((2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5), (2e-3, 1e-3, 5e-4)))
    motions = [plant_motion(robot, gravity, float(step)) for step in steps]
    off = np.abs([pose for pose, _ in motions] - exact_motion(robot, gravity)).reshape(-1, 2, 3).max(axis=2)
    gaps = np.array([gap for _, gap in motions])
    orders = observed_orders(steps, off[:, 1])
    numbers = {
        "step": steps.tolist(),
        "position_error": off[:, 1].tolist(),
        "angle_error": off[:, 0].tolist(),
        "loop_gap": gaps.tolist(),
        "orders": orders.tolist(),
        "gap_orders": observed_orders(steps, gaps).tolist(),
    }
    at_1_ms = 1e3 * float(off[1, 1])
    claims = [
        Claim(
            "II.C: the plant against mechanics, order of the error", "valid", float(orders[-1]), "", orders[-1] > 0.9
        ),
        Claim("II.C: error of the plant at 1 ms after 0.15 s", "-", at_1_ms, "mm", None),
    ]
    curves = {"position error": (1e3 * steps, off[:, 1]), "loop gap": (1e3 * steps, gaps)}
    draw = partial(chart, "The plant against exact mechanics", "step [ms]", "[m]", curves, "o-", "xy")
    return Result(numbers, claims, {"plant": draw})
