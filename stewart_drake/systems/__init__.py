"""The LeafSystems of the loop, one a file: thin shells around the pure modules."""

from stewart_drake.systems.ann_tuner import AnnTuner
from stewart_drake.systems.density_features import DensityFeatures
from stewart_drake.systems.lqi_controller import LqiController
from stewart_drake.systems.reference_source import ReferenceSource
from stewart_drake.systems.task_space_sensor import TaskSpaceSensor

__all__ = ["AnnTuner", "DensityFeatures", "LqiController", "ReferenceSource", "TaskSpaceSensor"]
