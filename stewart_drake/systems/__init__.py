"""The LeafSystems of the loop: parts in one shell, and what connects them."""

from stewart_drake.systems.continuous_plant import ClosedFormPlant as ClosedFormPlant
from stewart_drake.systems.library import AnnTuner as AnnTuner
from stewart_drake.systems.library import CommandDelay as CommandDelay
from stewart_drake.systems.library import CommandLink as CommandLink
from stewart_drake.systems.library import CommandSum as CommandSum
from stewart_drake.systems.library import ComputedTorque as ComputedTorque
from stewart_drake.systems.library import DensityFeatures as DensityFeatures
from stewart_drake.systems.library import FrictionFeedforward as FrictionFeedforward
from stewart_drake.systems.library import JointPid as JointPid
from stewart_drake.systems.library import LqiController as LqiController
from stewart_drake.systems.library import MotorDrive as MotorDrive
from stewart_drake.systems.library import MotorEncoders as MotorEncoders
from stewart_drake.systems.library import NetTorque as NetTorque
from stewart_drake.systems.library import PartSystem as PartSystem
from stewart_drake.systems.library import PlatformObserver as PlatformObserver
from stewart_drake.systems.library import PoseEstimator as PoseEstimator
from stewart_drake.systems.library import ReferenceSource as ReferenceSource
from stewart_drake.systems.library import SafetyLayer as SafetyLayer
from stewart_drake.systems.library import TaskSpaceSensor as TaskSpaceSensor
from stewart_drake.systems.library import TrackingError as TrackingError
