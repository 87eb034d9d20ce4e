"""Parameters in a Context: of parts, of the plants, and drawn at random."""

from functools import reduce
from operator import getitem

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import MonteCarloSimulation, Simulator
from pydrake.systems.primitives import Linearize
from strategies import ROBOT

from stewart_drake import ClosedFormPlant, ConfigurationError, LqiOptions, Scenario, build_diagram, build_plant, run
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics_laws import robot_record
from stewart_drake.studies.sweep import make_simulator, make_sweep
from stewart_drake.systems import LqiController

SCENARIO = Scenario(
    duration=0.1,
    log_period=0.001,
    tuner="fixed",
    controller={"kind": "lqi", "solver": "split", "feedforward": "gravity", "period": 0.005},
)
HEAVY = SCENARIO.replace({"robot.platform_mass": 1.3, "robot.platform_inertia": [0.004, 0.004, 0.007]})
LQI = LqiOptions(solver="split", period=0.005, feedforward="gravity")


def torque_at_home(controller, context):
    controller.measurement.FixValue(context, [*ROBOT.home_pose, *np.zeros(6)])
    controller.reference.FixValue(context, [*ROBOT.home_pose, *np.zeros(12)])
    controller.weights.FixValue(context, np.ones(2))
    return controller.torque.Eval(context)


def test_a_robot_in_a_context_applies_to_it_and_its_clones_alone():
    controller = LqiController(ROBOT, LQI, 9.81)
    context, other = controller.CreateDefaultContext(), controller.CreateDefaultContext()
    light = torque_at_home(controller, context)
    controller.parameter(context, "robot")[:] = robot_record(HEAVY.robot)
    expected = static_torque(HEAVY.robot, ROBOT.home_pose)
    for each in (context, context.Clone()):
        np.testing.assert_allclose(torque_at_home(controller, each), expected, rtol=1e-9)
        assert controller.parameter(each, "robot")["platform_mass"] == 1.3
    np.testing.assert_array_equal(torque_at_home(controller, other), light)
    controller.parameter(other, "params")["base"] *= 0.5
    np.testing.assert_allclose(torque_at_home(controller, other), 0.5 * light, rtol=1e-9)
    context.SetTimeStateAndParametersFrom(controller.CreateDefaultContext())
    np.testing.assert_array_equal(torque_at_home(controller, context), light)
    with pytest.raises(ConfigurationError, match=r"^parameter: expected robot or params, got 'friction'"):
        controller.parameter(context, "friction")


def errors(loop, context, end=0.1):
    simulator = Simulator(loop, context)
    simulator.AdvanceTo(end)
    return loop.sinks["error"].FindLog(context).data().T


def test_a_loop_whose_context_has_another_robot_is_the_loop_of_that_robot():
    loop, (_, heavy) = build_diagram(SCENARIO), build_plant(HEAVY.robot)
    context, plant = loop.CreateDefaultContext(), loop.plant.plant
    inertia = heavy.plant.GetBodyByName("platform").default_spatial_inertia()
    plant.GetBodyByName("platform").SetSpatialInertiaInBodyFrame(plant.GetMyMutableContextFromRoot(context), inertia)
    loop.systems["controller"].parameter(context, "robot")[:] = robot_record(HEAVY.robot)
    rows = errors(loop, context)
    np.testing.assert_allclose(rows, run(HEAVY)["error"][: len(rows)], atol=1e-12)
    assert np.abs(rows - run(SCENARIO)["error"][: len(rows)]).max() > 1e-6


def test_fixed_weights_and_an_expected_disturbance_are_parameters_too():
    softer = SCENARIO.replace({"tuner": {"kind": "fixed", "omega_q": 10.0, "omega_r": 0.1}})
    loop = build_diagram(SCENARIO)
    context = loop.CreateDefaultContext()
    loop.systems["controller"].parameter(context, "weights")[:] = 10.0, 0.1
    rows = errors(loop, context)
    np.testing.assert_array_equal(rows, run(softer)["error"][: len(rows)])


def test_the_plants_friction_is_a_parameter_and_its_damping_one_of_drakes():
    friction = {"coulomb": 0.02, "break_away": 0.05, "viscous": 0.0}
    sticky = SCENARIO.replace({"plant.friction": friction})
    other = sticky.replace({"plant.friction": {**friction, "coulomb": 0.04, "viscous": 0.03}})
    loop = build_diagram(sticky)
    context, plant = loop.CreateDefaultContext(), loop.plant.plant
    loop.GetSubsystemByName("friction").parameter(context, "friction")["coulomb"] = 0.04
    for leg in range(6):
        loop.plant.joint(f"motor_{leg}").SetDamping(plant.GetMyMutableContextFromRoot(context), 0.03)
    rows = errors(loop, context)
    np.testing.assert_allclose(rows, run(other)["error"][: len(rows)], atol=1e-12)
    assert np.abs(rows - run(sticky)["error"][: len(rows)]).max() > 1e-6


def test_the_continuous_plant_and_its_linearisation_take_the_numbers_of_the_context():
    plant, heavy = ClosedFormPlant(ROBOT), ClosedFormPlant(HEAVY.robot, gravity=3.7)
    contexts = [each.CreateDefaultContext() for each in (plant, heavy)]
    plant.parameter(contexts[0], "robot")[:] = robot_record(HEAVY.robot)
    plant.parameter(contexts[0], "gravity")[:] = 3.7
    rates, gains = [], []
    for each, context in zip((plant, heavy), contexts, strict=True):
        each.torque.FixValue(context, np.full(6, 0.2))
        rates.append(each.EvalTimeDerivatives(context).CopyToVector())
        each.torque.FixValue(context, static_torque(HEAVY.robot, ROBOT.home_pose, 3.7))
        gains.append(Linearize(each, context, each.torque.get_index(), each.measurement.get_index()).B())
    np.testing.assert_array_equal(*rates)
    np.testing.assert_array_equal(*gains)


def test_a_start_at_random_is_closed_and_moves_as_the_scenario_does():
    loop, (pose, rate) = build_diagram(SCENARIO), SCENARIO.start()
    u = Expression(Variable("u", Variable.Type.RANDOM_UNIFORM))
    place = np.array([Expression(pose[3]), Expression(pose[4]), pose[5] + 0.01 * u])
    loop.plant.joint("platform").set_random_translation_distribution(place)
    simulator = Simulator(loop)
    context, plant = simulator.get_mutable_context(), loop.plant.plant
    heights = []
    for seed in (1, 2, 1):
        loop.SetRandomContext(context, RandomGenerator(seed))
        simulator.Initialize()
        state = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(context))
        assert loop.plant.loop_gap(state).max() < 1e-12
        start = loop.plant.pose_and_rate(state)
        np.testing.assert_allclose(start[1], rate, atol=1e-12)
        heights.append(start[0][5] - pose[5])
    assert 0.0 < heights[0] == heights[2] != heights[1] < 0.01


def test_monte_carlo_by_drake_is_the_sweep_for_the_same_numbers():
    drawn = {
        "initial_offset[5]": {"kind": "uniform", "low": -0.005, "high": 0.005},
        "robot.platform_mass": {"kind": "uniform", "low": 0.8, "high": 1.2, "factor": True},
    }
    sweep = make_sweep(
        {
            **{"scenario": "paper_fig7", "runs": 4, "seed": 3, "mismatch": True, "distributions": drawn},
            "set": {"duration": 0.05, "controller.solver": "split", "tuner": "fixed"},
        }
    )

    def error(loop, context):
        return np.abs(loop.sinks["error"].FindLog(context).data()[:, :10]).max()

    samples = MonteCarloSimulation(make_simulator(sweep), error, 0.05, 2, RandomGenerator(5))
    for sample in samples:
        log = run(sweep.trials.trial(sample.generator_snapshot()).scenario())
        assert sample.output == np.abs(log["error"][:10]).max()
    assert samples[0].output != samples[1].output
    # A run of the sweep by its number.
    simulator = make_simulator(sweep)(lambda: 3)
    simulator.AdvanceTo(0.05)
    assert error(simulator.get_system(), simulator.get_context()) == np.abs(run(sweep.scenario(3))["error"][:10]).max()


@pytest.mark.parametrize(("part", "count"), [("observer", "ahead"), ("observer", "age"), ("safety", "residual.half")])
def test_rows_of_a_parts_memory_are_no_parameter(part, count):
    loop = build_diagram(SCENARIO.replace({"sensors": "encoders", "estimator": "observer", "safety": {}}))
    simulator = Simulator(loop)
    *records, name = count.split(".")
    reduce(getitem, records, loop.systems[part].parameter(simulator.get_mutable_context(), "params"))[name] = np.nan
    with pytest.raises(
        ConfigurationError, match=rf"^params\.{count}: expected \d+, which its part is built for, got .*nan"
    ):
        simulator.AdvanceTo(0.01)
