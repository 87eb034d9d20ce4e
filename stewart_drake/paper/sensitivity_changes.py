"""One change at a time, for the study of sensitivity: robots, plants, controllers and networks; pure but for files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stewart_drake.control.network import TunerNetwork
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.force_map import force_map
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario


@dataclass(frozen=True)
class Change:
    """One change to a scenario.

    Attributes:
        factor: What is changed.
        label: To what.
        apply: The scenario with it; raises ConfigurationError where the robot or the controller cannot be had.
        quick: Part of the quick study too.
    """

    factor: str
    label: str
    apply: Callable[[Scenario], Scenario]
    quick: bool = False


def scaled_robot(robot: RobotParameters, mass: float = 1.0, inertia: float = 1.0) -> RobotParameters:
    """A robot with masses, or moments of inertia about the centres of mass, of all moving bodies times a factor."""
    changes: dict[str, Any] = {}
    for body in ("platform", "rod", "crank"):
        changes[f"{body}_mass"] = mass * getattr(robot, f"{body}_mass")
        changes[f"{body}_inertia"] = tuple(inertia * moment for moment in getattr(robot, f"{body}_inertia"))
    return robot.replace(**changes)


def scaled_network(network: TunerNetwork, omega_q: float = 1.0, omega_r: float = 1.0) -> TunerNetwork:
    """A network whose answers, and the range in which they are held, are those of `network` times a factor each."""
    factors = np.array([omega_q, omega_r])
    return replace(
        network,
        output_bias=network.output_bias + np.log10(factors),
        omega_min=network.omega_min * factors,
        omega_max=network.omega_max * factors,
    )


def _percent(factor: float) -> str:
    return f"{100.0 * (factor - 1.0):+.0f} %"


def longer(robot: RobotParameters, by: float) -> RobotParameters:
    """A robot with rods longer by `by` [m]."""
    return robot.replace(rod_length=robot.rod_length + by)


def changes(folder: Path) -> list[Change]:
    """Everything that is changed, one at a time; nominal values among them change nothing and are left out later.

    Masses, inertias and rods are those of the simulated robot: the controller goes on believing in the nominal ones.

    Args:
        folder: Where the weights files of scaled networks go.
    """

    def robot(change: Callable[[RobotParameters], RobotParameters]) -> Callable[[Scenario], Scenario]:
        def apply(base: Scenario) -> Scenario:
            return base.replace({"robot": asdict(change(base.robot)), "model_robot": asdict(base.believed_robot)})

        return apply

    def key(name: str, value: float) -> Callable[[Scenario], Scenario]:
        return lambda base: base.replace({name: value})

    def weight(name: Literal["omega_q", "omega_r"], factor: float) -> Callable[[Scenario], Scenario]:
        def apply(base: Scenario) -> Scenario:
            network = base.load_tuner_network()
            if network is None:
                return base.replace({f"tuner.{name}": factor * getattr(base.tuner, name)})
            path = folder / f"tuner-{name}-{factor:g}.json"
            folder.mkdir(parents=True, exist_ok=True)
            scaled_network(network, **{name: factor}).save(path)
            return base.replace({"tuner.weights_file": str(path.absolute())})

        return apply

    found = []
    for factor in (0.8, 0.95, 1.05, 1.2):
        apply = robot(partial(scaled_robot, mass=factor))
        found.append(Change("masses", _percent(factor), apply, quick=factor in (0.8, 1.2)))
    for factor in (0.8, 1.2):
        found.append(Change("inertias", _percent(factor), robot(partial(scaled_robot, inertia=factor))))
    for step in (-1.0, 1.0):
        found.append(Change("rod length", f"{step:+g} mm", robot(partial(longer, by=1e-3 * step))))
    for friction in (0.0, 0.02, 0.05):
        apply = key("plant.motor_friction", friction)
        found.append(Change("motor friction", f"{friction:g} N m", apply, quick=friction == 0.05))
    for damping in (0.0, 0.05):
        found.append(Change("motor damping", f"{damping:g} N m s/rad", key("plant.motor_damping", damping)))
    for period in (1.0, 2.0, 5.0, 10.0):
        apply = key("controller.period", 1e-3 * period)
        found.append(Change("sample time", f"{period:g} ms", apply, quick=period == 10.0))
    for window in (10, 25, 49, 100, 200):
        found.append(Change("window m", str(window), key("tuner.window", window)))
    for factor in (0.5, 1.5):
        found.append(Change("omega_Q", _percent(factor), weight("omega_q", factor), quick=True))
    for factor in (0.5, 1.5):
        found.append(Change("omega_R", _percent(factor), weight("omega_r", factor)))
    return found


def feedforward_share(robot: RobotParameters, believed: RobotParameters, gravity: float) -> float:
    """Vertical force that a wrong gravity feedforward adds along (37), (38), as a share of -M Z''_d.

    (20) leaves the reference's acceleration out, so -M q''_d acts as a disturbance. The torque that would hold the
    believed robot at rest leaves a force on the true one; its part in phase with -m Z''_d, by least squares, either
    adds to that disturbance (positive) or makes up for it (negative).
    """
    pose, _, acceleration = paper_reference().evaluate(np.linspace(0.0, np.pi, 65)[:-1])
    wrong = static_torque(believed, pose, gravity) - static_torque(robot, pose, gravity)
    force = np.einsum("nij,nj->ni", force_map(robot, pose), wrong)[:, 5]
    left_out = -robot.platform_mass * acceleration[:, 5]
    return float(left_out @ (force - force.mean()) / (left_out @ left_out))
