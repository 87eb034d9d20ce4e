"""One change at a time, for the study of sensitivity: robots, plants, controllers and networks; pure but for files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stewart_drake.control.network import TunerNetwork
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.force_map import force_map
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import AnnTuner, Scenario


@dataclass(frozen=True)
class Change:
    """One change to a scenario.

    Attributes:
        factor: What is changed.
        label: To what.
        keys: Keys of the scenario and their values, which a robot or a controller may not allow.
        quick: Part of the quick study too.
    """

    factor: str
    label: str
    keys: Mapping[str, Any]
    quick: bool = False


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


def changes(base: Scenario, folder: Path) -> list[Change]:
    """Everything that is changed, one at a time; nominal values among them change nothing and are left out later.

    Masses, inertias and rods are those of the simulated robot: the controller goes on believing in the nominal ones.

    Args:
        base: Scenario to change.
        folder: Where the weights files of scaled networks go.
    """
    robot, believed = base.robot, {"model_robot": asdict(base.believed_robot)}

    def bodies(name: str, factor: float) -> dict[str, Any]:
        keys = [f"{body}_{name}" for body in ("platform", "rod", "crank")]
        return believed | {f"robot.{key}": (factor * np.array(getattr(robot, key))).tolist() for key in keys}

    def weight(name: Literal["omega_q", "omega_r"], factor: float) -> dict[str, Any]:
        network = base.load_tuner_network()
        if network is None:
            return {f"tuner.{name}": factor * getattr(base.tuner, name)}
        path = folder / f"tuner-{name}-{factor:g}.json"
        folder.mkdir(parents=True, exist_ok=True)
        scaled_network(network, **{name: factor}).save(path)
        return {"tuner.weights_file": str(path.absolute())}

    found = [Change("masses", _percent(f), bodies("mass", f), f in (0.8, 1.2)) for f in (0.8, 0.95, 1.05, 1.2)]
    found += [Change("inertias", _percent(f), bodies("inertia", f)) for f in (0.8, 1.2)]
    for step in (-1.0, 1.0):
        length = (np.array(robot.rod_length) + 1e-3 * step).tolist()
        found.append(Change("rod length", f"{step:+g} mm", believed | {"robot.rod_length": length}))
    found += [Change("motor friction", f"{f:g} N m", {"plant.motor_friction": f}, f == 0.05) for f in (0.0, 0.02, 0.05)]
    found += [Change("motor damping", f"{d:g} N m s/rad", {"plant.motor_damping": d}) for d in (0.0, 0.05)]
    periods = (1.0, 2.0, 5.0, 10.0)
    found += [Change("sample time", f"{p:g} ms", {"controller.period": 1e-3 * p}, p == 10.0) for p in periods]
    if isinstance(base.tuner, AnnTuner):
        found += [Change("window m", str(m), {"tuner.window": m}) for m in (10, 25, 49, 100, 200)]
    found += [Change("omega_Q", _percent(f), weight("omega_q", f), quick=True) for f in (0.5, 1.5)]
    return found + [Change("omega_R", _percent(f), weight("omega_r", f)) for f in (0.5, 1.5)]


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
