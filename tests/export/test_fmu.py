"""Units for co-simulation: valid, and in FMPy what they are here."""

import numpy as np
import pytest
from compiled import compiler

from stewart_drake import Controller, load_scenario
from stewart_drake.base.sampling import on_grid
from stewart_drake.export.controller_c import readings_along
from stewart_drake.export.fmu import write_units
from stewart_drake.plant.closed_form import ClosedForm
from stewart_drake.scenario.assembly import control_side
from stewart_drake.scenario.stepped_loop import SteppedLoop

fmpy = pytest.importorskip("fmpy")


@pytest.fixture(scope="module")
def units(tmp_path_factory):
    from fmpy.validation import validate_fmu

    compiler()
    paths = write_units(load_scenario("reachy_nod"), "reachy_nod", tmp_path_factory.mktemp("units"))
    assert [validate_fmu(str(path)) for path in paths] == [[], []]
    return paths


@pytest.fixture
def opened(tmp_path):
    from fmpy.fmi3 import FMU3Slave

    def open_(path):
        description = fmpy.read_model_description(str(path))
        unit = FMU3Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path), str(tmp_path / path.stem)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="unit",
        )
        unit.instantiate()
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        places = {variable.name: variable.valueReference for variable in description.modelVariables}
        return unit, places

    return open_


def test_the_controller(units, opened):
    scenario = load_scenario("reachy_nod")
    (unit, at), controller, out = opened(units[0]), Controller(scenario), np.empty(6)
    period = on_grid(scenario.controller.period)
    for step, reading in enumerate(readings_along(scenario, control_side(scenario, split=True), 101)):
        controller.step(reading, step * period, out)
        wanted = np.concatenate([controller.signal("reference"), controller.signal("reference_ahead")])
        unit.setFloat64([at["reading"], at["reference"]], [*reading, *wanted])
        unit.doStep(currentCommunicationPoint=step * period, communicationStepSize=period)
        np.testing.assert_allclose(unit.getFloat64([at["command"]], 6), out, rtol=0.0, atol=1e-9)
    unit.terminate()
    unit.freeInstance()


def test_the_robot_with_its_motors_and_the_loop_of_both(units, opened):
    """Controller and robot, each a unit, are together the closed loop of the fast engine."""
    scenario = load_scenario("reachy_nod").replace(
        {"plant": {"kind": "closed_form", "motor_damping": 0.095, "motor_friction": 0.058}, "command_delay": 0}
    )
    paths = write_units(scenario, "loop", units[0].parent / "loop")
    (controller, to), (robot, at) = opened(paths[0]), opened(paths[1])
    loop, step = SteppedLoop(scenario), on_grid(scenario.plant.time_step)
    loop.begin()
    stride = round(scenario.controller.period / scenario.plant.time_step)
    quantum = scenario.sensors.quantum
    for k in range(1000):
        loop.run_parts()
        if k % stride == 0:
            angles = np.array(robot.getFloat64([at["measured"]], 24))[12:18]
            wanted = loop.runner.signal("reference")
            controller.setFloat64([to["reading"], to["reference"]], [*(quantum * np.rint(angles / quantum)), *wanted])
            controller.doStep(currentCommunicationPoint=k * step, communicationStepSize=stride * step)
            robot.setFloat64([at["command"]], controller.getFloat64([to["command"]], 6))
        robot.doStep(currentCommunicationPoint=k * step, communicationStepSize=step)
        loop.move()
        np.testing.assert_allclose(robot.getFloat64([at["measured"]], 24), loop.measured, rtol=0.0, atol=1e-9)
    assert isinstance(loop.plant, ClosedForm)
