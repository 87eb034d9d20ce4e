"""The multibody plant that stands in for the paper's Adams model (section II.C): is it right, and how exact is it?"""

from __future__ import annotations

import numpy as np
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp

from stewart_drake.errors import RunFailure
from stewart_drake.mechanics.dynamics import task_bias, task_inertia
from stewart_drake.mechanics.kinematics import twist_jacobian, twist_to_pose_rate
from stewart_drake.paper.plots.plant_plots import plot_convergence
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot import RobotParameters

START = np.array([0.1, -0.05, 0.1, 0.01, -0.02, 0.01])
"""[rad, m] from home: where the free motion starts, at rest."""
TORQUE = np.array([0.2, 0.3, 0.25, 0.3, 0.2, 0.3])
"""[N m] held constant meanwhile."""
DURATION = 0.15
"""[s]"""


def exact_motion(robot: RobotParameters, gravity: float, time: float = DURATION) -> np.ndarray:
    """Pose (6,) [rad, m] after `time` of `TORQUE` from rest at `START`, by the closed-form model, to about 1e-12.

    Raises:
        RunFailure: This robot does not get that far, such as one that falls into a singularity.
    """

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        pose, twist = state[:6], state[6:]
        load = twist_jacobian(robot, pose).T @ TORQUE - task_bias(robot, pose, twist, gravity)
        return np.concatenate([twist_to_pose_rate(pose, twist), np.linalg.solve(task_inertia(robot, pose), load)])

    start = np.concatenate([robot.home_pose + START, np.zeros(6)])
    result = solve_ivp(derivative, (0.0, time), start, method="DOP853", rtol=1e-12, atol=1e-13)
    if not result.success:
        raise RunFailure(f"the free motion could not be integrated beyond {result.t[-1]:.3g} s: {result.message}")
    return result.y[:6, -1]


def plant_motion(
    robot: RobotParameters, gravity: float, time_step: float, time: float = DURATION
) -> tuple[np.ndarray, float]:
    """The same motion of the multibody plant.

    Returns:
        Pose (6,) [rad, m] and the largest loop gap [m] at the end.
    """
    diagram, plant = build_plant(robot, PlantOptions(time_step=time_step), gravity)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("torque").FixValue(context, TORQUE)
    plant.set_state(context, robot.home_pose + START)
    steps = round(time / time_step)
    simulator.AdvanceTo(steps * plant.plant.time_step())
    state = diagram.GetOutputPort("state").Eval(context)
    return plant.pose_and_rate(state)[0], float(plant.loop_gap(state).max())


def observed_orders(steps: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Order of convergence between neighbouring steps, log(error ratio) / log(step ratio); (n - 1,)."""
    return np.diff(np.log(errors)) / np.diff(np.log(steps))


def make(study: Study) -> Section:
    """The section; see the module."""
    robot, gravity = study.base.robot, study.base.gravity
    steps = np.array(study.pick((2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5), (2e-3, 1e-3, 5e-4)))
    exact = exact_motion(robot, gravity)
    errors, gaps = np.empty((2, len(steps))), np.empty(len(steps))
    for index, step in enumerate(steps):
        pose, gaps[index] = plant_motion(robot, gravity, float(step))
        errors[:, index] = np.abs(pose - exact).reshape(2, 3).max(axis=1)
        study.progress((index + 1) / len(steps))
    numbers = {
        "step": steps.tolist(),
        "position_error": errors[1].tolist(),
        "angle_error": errors[0].tolist(),
        "loop_gap": gaps.tolist(),
        "orders": observed_orders(steps, errors[1]).tolist(),
        "gap_orders": observed_orders(steps, gaps).tolist(),
    }
    figures = {"convergence": plot_convergence(steps, errors[1], gaps)}
    nearest = int(np.argmin(np.abs(steps - study.base.plant.time_step)))
    return study.section("plant", numbers, figures, nearest=nearest, duration=DURATION)
