"""The robot of a live loop in Drake's Meshcat."""

from __future__ import annotations

import logging

from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder

from stewart_drake.live.loop import LiveLoop
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.runs.replay import furnish
from stewart_drake.scenario import Scenario


class LiveView:
    """A Meshcat on this machine alone, and the robot in it.

    Args:
        scenario: Whose robot.

    Attributes:
        url: Of the Meshcat.
    """

    def __init__(self, scenario: Scenario) -> None:
        drake_log = logging.getLogger("drake")
        level = drake_log.level
        # Drake announces its own page; ours shows it.
        drake_log.setLevel(logging.WARNING)
        try:
            self._meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
        finally:
            drake_log.setLevel(level)
        self.url = self._meshcat.web_url()
        furnish(self._meshcat, scenario.robot)
        builder = DiagramBuilder()
        self._stewart = add_plant(builder, scenario.robot, PlantOptions(), visuals=True)
        parameters = MeshcatVisualizerParams(prefix="robot")
        MeshcatVisualizer.AddToBuilder(builder, self._stewart.scene_graph, self._meshcat, parameters)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = self._stewart.plant.GetMyMutableContextFromRoot(self._context)

    def show(self, loop: LiveLoop) -> None:
        """Draws the robot and its reference as they are now."""
        self._context.SetTime(loop.time)
        state = self._stewart.assemble(loop.pose)
        self._stewart.plant.SetPositionsAndVelocities(self._plant_context, state)
        self._diagram.ForcedPublish(self._context)
        wanted = loop.wanted
        self._meshcat.SetTransform("reference", RigidTransform(RollPitchYaw(wanted[:3]), wanted[3:]))
