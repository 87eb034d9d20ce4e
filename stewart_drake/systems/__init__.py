"""The LeafSystems of the loop: parts in one shell, and what connects them."""

from stewart_drake.systems.continuous_plant import ClosedFormPlant as ClosedFormPlant
from stewart_drake.systems.library import AnnTuner as AnnTuner
from stewart_drake.systems.library import DensityFeatures as DensityFeatures
from stewart_drake.systems.library import LqiController as LqiController
from stewart_drake.systems.library import PartSystem as PartSystem
from stewart_drake.systems.library import PlatformObserver as PlatformObserver
from stewart_drake.systems.library import ReferenceSource as ReferenceSource
from stewart_drake.systems.library import SafetyLayer as SafetyLayer
from stewart_drake.systems.library import ScenarioSystem as ScenarioSystem
from stewart_drake.systems.library import TaskSpaceSensor as TaskSpaceSensor
from stewart_drake.systems.library import TrackingError as TrackingError
