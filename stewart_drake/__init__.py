"""Closed-loop torque control of rotary Stewart platforms, on Drake.

    from stewart_drake import Scenario, run
    log = run(Scenario(duration=2.0))

Names below load on first use: the pure modules (kinematics, control law) need no Drake, and nothing here needs torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stewart_drake.calibration.fit import calibrate as calibrate
    from stewart_drake.calibration.measurements import MeasurementNoise as MeasurementNoise
    from stewart_drake.calibration.pose_plan import plan_poses as plan_poses
    from stewart_drake.calibration.result import Calibration as Calibration
    from stewart_drake.control.base import Measurement as Measurement
    from stewart_drake.control.base import Setpoint as Setpoint
    from stewart_drake.control.lqi import LqiOptions as LqiOptions
    from stewart_drake.control.network import load_network as load_network
    from stewart_drake.controller import Controller as Controller
    from stewart_drake.errors import ConfigurationError as ConfigurationError
    from stewart_drake.errors import StewartDrakeError as StewartDrakeError
    from stewart_drake.files.code_trust import trusting_code as trusting_code
    from stewart_drake.identification.excitation import excite as excite
    from stewart_drake.identification.identified import Identification as Identification
    from stewart_drake.identification.identify import identify as identify
    from stewart_drake.identification.recording import Recording as Recording
    from stewart_drake.logs.log import SimulationLog as SimulationLog
    from stewart_drake.logs.log import load_log as load_log
    from stewart_drake.logs.metric_table import Metric as Metric
    from stewart_drake.logs.metric_table import add_metric as add_metric
    from stewart_drake.logs.metrics import run_metrics as run_metrics
    from stewart_drake.mechanics.dynamics import forward_dynamics as forward_dynamics
    from stewart_drake.mechanics.dynamics import inverse_dynamics as inverse_dynamics
    from stewart_drake.mechanics.kinematics import forward_kinematics as forward_kinematics
    from stewart_drake.mechanics.kinematics import inverse_kinematics as inverse_kinematics
    from stewart_drake.mechanics.kinematics import leg_geometry as leg_geometry
    from stewart_drake.planning.feasibility import check_reference as check_reference
    from stewart_drake.planning.limits import Limits as Limits
    from stewart_drake.plant.multibody_plant import StewartPlant as StewartPlant
    from stewart_drake.plant.multibody_plant import add_plant as add_plant
    from stewart_drake.plant.multibody_plant import build_plant as build_plant
    from stewart_drake.plant.plant_options import PlantOptions as PlantOptions
    from stewart_drake.plant.sdf_model import write_sdf as write_sdf
    from stewart_drake.references import HoldReference as HoldReference
    from stewart_drake.references import SineReference as SineReference
    from stewart_drake.references import paper_reference as paper_reference
    from stewart_drake.robot import RobotParameters as RobotParameters
    from stewart_drake.robot.leg import LegParameters as LegParameters
    from stewart_drake.robot.robot_files import load_robot as load_robot
    from stewart_drake.robot.robot_files import save_robot as save_robot
    from stewart_drake.runs.simulation import run as run
    from stewart_drake.sampling import on_grid as on_grid
    from stewart_drake.scenario import AnnTuner as AnnTuner
    from stewart_drake.scenario import BlockTuner as BlockTuner
    from stewart_drake.scenario import FixedTuner as FixedTuner
    from stewart_drake.scenario import Scenario as Scenario
    from stewart_drake.scenario import load_scenario as load_scenario
    from stewart_drake.systems.diagram import ClosedLoop as ClosedLoop
    from stewart_drake.systems.diagram import build_diagram as build_diagram

    __version__: str

_HOME = {
    "Calibration": "calibration.result",
    "MeasurementNoise": "calibration.measurements",
    "calibrate": "calibration.fit",
    "plan_poses": "calibration.pose_plan",
    "Controller": "controller",
    "LqiOptions": "control.lqi",
    "Measurement": "control.base",
    "Setpoint": "control.base",
    "ClosedLoop": "systems.diagram",
    "build_diagram": "systems.diagram",
    "ConfigurationError": "errors",
    "StewartDrakeError": "errors",
    "trusting_code": "files.code_trust",
    "check_reference": "planning.feasibility",
    "forward_kinematics": "mechanics.kinematics",
    "inverse_kinematics": "mechanics.kinematics",
    "leg_geometry": "mechanics.kinematics",
    "Identification": "identification.identified",
    "Recording": "identification.recording",
    "excite": "identification.excitation",
    "identify": "identification.identify",
    "Limits": "planning.limits",
    "SimulationLog": "logs.log",
    "load_log": "logs.log",
    "Metric": "logs.metric_table",
    "add_metric": "logs.metric_table",
    "run_metrics": "logs.metrics",
    "load_network": "control.network",
    "StewartPlant": "plant.multibody_plant",
    "add_plant": "plant.multibody_plant",
    "build_plant": "plant.multibody_plant",
    "PlantOptions": "plant.plant_options",
    "HoldReference": "references",
    "SineReference": "references",
    "paper_reference": "references",
    "forward_dynamics": "mechanics.dynamics",
    "inverse_dynamics": "mechanics.dynamics",
    "LegParameters": "robot.leg",
    "RobotParameters": "robot",
    "load_robot": "robot.robot_files",
    "save_robot": "robot.robot_files",
    "on_grid": "sampling",
    "AnnTuner": "scenario",
    "BlockTuner": "scenario",
    "FixedTuner": "scenario",
    "Scenario": "scenario",
    "load_scenario": "scenario",
    "write_sdf": "plant.sdf_model",
    "run": "runs.simulation",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


if not TYPE_CHECKING:
    # A type checker that saw this would take every misspelt name for one of the package.
    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from stewart_drake.logs.versions import package_version

            return package_version("stewart-drake") or "not installed"
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return __all__
