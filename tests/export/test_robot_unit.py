"""The robot as a unit of co-simulation, called as FMI 3.0 and 2.0 say: what it steps as, and what it refuses."""

import ctypes
import zipfile
from io import BytesIO
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from compiled import compiler

from stewart_drake import load_scenario
from stewart_drake.base.sampling import on_grid
from stewart_drake.export.fmu import robot_unit

OK, ERROR = 0, 3
BASE = load_scenario("reachy_nod")
COMMAND, WRENCH, MEASURED = 1, 2, 3  # References of its variables.


class Unit:
    def __init__(self, scenario, folder):
        self._library = _extracted(scenario, folder, 3)[0]
        self._library.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
        nothing = [None, None, None, False, False, False, False, None, ctypes.c_size_t(0), None, None, None]
        self._unit = ctypes.c_void_p(self._library.fmi3InstantiateCoSimulation(*nothing))

    def measured(self):
        values = (ctypes.c_double * 25)()
        assert self._library.fmi3GetFloat64(self._unit, *_references(0, MEASURED), values, ctypes.c_size_t(25)) == OK
        return np.array(values)

    def set(self, reference, values):
        given = (ctypes.c_double * len(values))(*values)
        size = ctypes.c_size_t(len(values))
        assert self._library.fmi3SetFloat64(self._unit, *_references(reference), given, size) == OK

    def step(self, now, size):
        flags, last = (ctypes.c_bool * 3)(), ctypes.c_double()
        told = [ctypes.byref(flags, k) for k in range(3)]
        times = ctypes.c_double(now), ctypes.c_double(size)
        return self._library.fmi3DoStep(self._unit, *times, False, *told, ctypes.byref(last)), last.value


def _extracted(scenario, folder, fmi):
    """The library of a unit, and its description."""
    compiler()
    with zipfile.ZipFile(BytesIO(robot_unit(scenario, "nod", fmi))) as archive:
        (library,) = (name for name in archive.namelist() if name.startswith("binaries/"))
        description = ET.fromstring(archive.read("modelDescription.xml"))
        return ctypes.CDLL(archive.extract(library, folder)), description


def _references(*numbers):
    return (ctypes.c_uint32 * len(numbers))(*numbers), ctypes.c_size_t(len(numbers))


@pytest.mark.parametrize("integrator", ["semi_implicit", "rk4"])
def test_it_steps_as_its_scenario_says(integrator, tmp_path):
    """With dry friction, and motors that turn round: the plant of the fast engine under the same torques."""
    plant = {"kind": "closed_form", "integrator": integrator, "motor_damping": 0.095, "motor_friction": 0.058}
    scenario = BASE.replace({"plant": plant})
    unit, chain, step = Unit(scenario, tmp_path), scenario.plant.make(scenario.robot, scenario.gravity), 0.001
    chain.initial(*scenario.start())
    for k in range(200):
        command = 0.3 * np.sin(0.2 * k + np.arange(6))
        unit.set(COMMAND, command)
        assert unit.step(k * on_grid(step), step)[0] == OK
        expected = chain.step(command, np.zeros(6))
    np.testing.assert_allclose(unit.measured()[1:], expected, rtol=0.0, atol=1e-9)
    assert np.abs(expected[18:]).max() > 0.1


def test_a_step_that_is_none_is_an_error_and_moves_nothing(tmp_path):
    unit = Unit(BASE, tmp_path)
    assert unit.step(0.0, 0.02) == (OK, 0.02)
    before = unit.measured()
    odd = (-1.0, 0.0, np.nan, np.inf, 1e300, 1e5)
    for now, size in (*((0.02, each) for each in odd), (0.0, 0.02), (0.04, 0.02), (np.nan, 0.02)):
        assert unit.step(now, size) == (ERROR, 0.02)
    np.testing.assert_array_equal(unit.measured(), before)
    # Points are sums of floating-point numbers.
    assert all(unit.step(k * 0.02, 0.02)[0] == OK for k in range(1, 100))
    assert unit.measured()[0] == pytest.approx(2.0)
    unit.set(COMMAND, [np.nan] * 6)
    assert unit.step(2.0, 0.02)[0] == ERROR


def test_in_version_2_it_is_the_same_robot_by_scalars(tmp_path):
    library, description = _extracted(BASE, tmp_path / "2", 2)
    variables = [(each.get("name"), each.get("causality")) for each in description.iter("ScalarVariable")]
    names = [
        f"{name}[{k}]" for name, size in (("command", 6), ("wrench", 6), ("measured", 24)) for k in range(1, size + 1)
    ]
    assert [name for name, _ in variables] == ["time", *names]
    for tag in ("Outputs", "InitialUnknowns"):
        (listed,) = description.iter(tag)
        assert all(variables[int(each.get("index")) - 1][1] == "output" for each in listed)
        assert len(listed) == 24
    library.fmi2Instantiate.restype = ctypes.c_void_p
    callbacks = (ctypes.c_void_p * 5)()
    arguments = b"one", 1, None, None, callbacks, 0, 0
    unit, other = ctypes.c_void_p(library.fmi2Instantiate(*arguments)), Unit(BASE, tmp_path / "3")
    assert library.fmi2Instantiate(b"one", 0, *arguments[2:]) is None  # no model exchange
    command = 0.3 * np.sin(np.arange(6))
    other.set(COMMAND, command)
    other.step(0.0, 0.05)
    assert library.fmi2SetReal(unit, *_references(*range(1, 7)), (ctypes.c_double * 6)(*command)) == OK
    assert library.fmi2DoStep(unit, ctypes.c_double(0.0), ctypes.c_double(0.05), 0) == OK
    values = (ctypes.c_double * 25)()
    assert library.fmi2GetReal(unit, *_references(0, *range(13, 37)), values) == OK
    np.testing.assert_array_equal(np.array(values), other.measured())
    assert library.fmi2DoStep(unit, ctypes.c_double(0.0), ctypes.c_double(0.05), 0) == ERROR
    assert library.fmi2SetReal(unit, *_references(13), values) == ERROR
    library.fmi2FreeInstance(unit)
