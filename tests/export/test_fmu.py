"""Units for co-simulation: valid, and in FMPy what they are here."""

import numpy as np
import pytest
from compiled import compiler

from stewart_drake import Controller, load_scenario
from stewart_drake.base.sampling import on_grid
from stewart_drake.export.controller_c import readings_along
from stewart_drake.export.fmu import write_units
from stewart_drake.plant.closed_form import ClosedForm
from stewart_drake.scenario.control_side import control_side
from stewart_drake.scenario.stepped_loop import SteppedLoop

fmpy = pytest.importorskip("fmpy")


@pytest.fixture(scope="module", params=[3, 2])
def units(request, tmp_path_factory):
    from fmpy.validation import validate_fmu

    compiler()
    paths = write_units(load_scenario("reachy_nod"), "reachy_nod", tmp_path_factory.mktemp("units"), request.param)
    assert [validate_fmu(str(path)) for path in paths] == [[], []]
    return paths


class Unit:
    """A unit in FMPy; arrays by name, which are scalars in FMI 2.0."""

    def __init__(self, path, folder):
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        description = fmpy.read_model_description(str(path))
        self.is_scalar = description.fmiVersion == "2.0"
        self.unit = (FMU2Slave if self.is_scalar else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path), str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="unit",
        )
        self.unit.instantiate()
        if self.is_scalar:
            self.unit.setupExperiment(startTime=0.0)
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()
        self.places = {}
        for variable in description.modelVariables:
            self.places.setdefault(variable.name.partition("[")[0], []).append(variable.valueReference)

    def set(self, name, values):
        (self.unit.setReal if self.is_scalar else self.unit.setFloat64)(self.places[name], list(values))

    def get(self, name, size):
        if self.is_scalar:
            return np.array(self.unit.getReal(self.places[name]))
        return np.array(self.unit.getFloat64(self.places[name], size))

    def step(self, now, size):
        self.unit.doStep(currentCommunicationPoint=now, communicationStepSize=size)


@pytest.fixture
def opened(tmp_path):
    return lambda path: Unit(path, tmp_path / path.stem)


def test_the_controller(units, opened):
    scenario = load_scenario("reachy_nod")
    unit, controller, out = opened(units[0]), Controller(scenario), np.empty(6)
    period = on_grid(scenario.controller.period)
    for step, reading in enumerate(readings_along(scenario, control_side(scenario, split=True), 101)):
        controller.step(reading, step * period, out)
        wanted = np.concatenate([controller.signal("reference"), controller.signal("reference_ahead")])
        unit.set("reading", reading)
        unit.set("reference", wanted)
        unit.step(step * period, period)
        np.testing.assert_allclose(unit.get("command", 6), out, rtol=0.0, atol=1e-9)
    unit.unit.terminate()
    unit.unit.freeInstance()


def test_fmpy_simulates_the_robot(units):
    """It yields to a push from above."""
    is_scalar = fmpy.read_model_description(str(units[1])).fmiVersion == "2.0"
    push = {"wrench[6]": -40.0} if is_scalar else {"wrench": [0.0] * 5 + [-40.0]}
    rows = fmpy.simulate_fmu(str(units[1]), stop_time=0.1, output_interval=0.01, start_values=push)
    height = rows["measured[6]"] if is_scalar else rows["measured"][:, 5]
    assert height[-1] < height[0] - 1e-3


def test_the_robot_with_its_motors_and_the_loop_of_both(units, opened):
    """Controller and robot, each a unit, are together the closed loop of the fast engine."""
    scenario = load_scenario("reachy_nod").replace(
        {"plant": {"kind": "closed_form", "motor_damping": 0.095, "motor_friction": 0.058}, "command_delay": 0}
    )
    paths = write_units(scenario, "loop", units[0].parent / "loop", 2 if opened(units[0]).is_scalar else 3)
    controller, robot = opened(paths[0]), opened(paths[1])
    loop, step = SteppedLoop(scenario), on_grid(scenario.plant.time_step)
    loop.begin()
    stride = round(scenario.controller.period / scenario.plant.time_step)
    quantum = scenario.sensors.quantum
    for k in range(1000):
        loop.run_parts()
        if k % stride == 0:
            angles = robot.get("measured", 24)[12:18]
            controller.set("reading", quantum * np.rint(angles / quantum))
            controller.set("reference", loop.runner.signal("reference"))
            controller.step(k * step, stride * step)
            robot.set("command", controller.get("command", 6))
        robot.step(k * step, step)
        loop.move()
        np.testing.assert_allclose(robot.get("measured", 24), loop.measured, rtol=0.0, atol=1e-9)
    assert isinstance(loop.plant, ClosedForm)
