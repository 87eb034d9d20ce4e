"""The LeafSystems of the loop: parts in one shell, and what connects them."""

from stewart_drake.systems.library import (
    AnnTuner,
    CommandLink,
    ComputedTorque,
    DensityFeatures,
    FrictionFeedforward,
    JointPid,
    LqiController,
    MotorDrive,
    MotorEncoders,
    PlatformObserver,
    PoseEstimator,
    SafetyLayer,
)
from stewart_drake.systems.part_system import PartSystem
from stewart_drake.systems.sources import ReferenceSource, TaskSpaceSensor

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
