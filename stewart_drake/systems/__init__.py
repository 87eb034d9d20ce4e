"""The LeafSystems of the loop: parts in one shell, and what connects them."""

from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.library import (
    AnnTuner,
    CommandLink,
    ComputedTorque,
    FrictionFeedforward,
    JointPid,
    MotorDrive,
    MotorEncoders,
    PlatformObserver,
    PoseEstimator,
    SafetyLayer,
)
from stewart_drake.systems.lqi_controller import LqiController
from stewart_drake.systems.part_system import PartSystem
from stewart_drake.systems.reference_source import ReferenceSource
from stewart_drake.systems.task_space_sensor import TaskSpaceSensor

__all__ = [
    "AnnTuner",
    "CommandLink",
    "ComputedTorque",
    "DensityFeatures",
    "FrictionFeedforward",
    "JointPid",
    "LqiController",
    "MotorDrive",
    "MotorEncoders",
    "PartSystem",
    "PlatformObserver",
    "PoseEstimator",
    "ReferenceSource",
    "SafetyLayer",
    "TaskSpaceSensor",
]
