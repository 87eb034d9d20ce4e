import numpy as np
import pytest
from plant_runs import Run
from strategies import UNEQUAL

from stewart_drake import ConfigurationError, DrakeOptions, load_robot
from stewart_drake.base.registry import PLANTS
from stewart_drake.control.friction_compensation import FrictionCompensation
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.friction import FrictionOptions

SIGNS = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
SMALL = load_robot("reachy_mini")


def test_the_rotors_keep_their_inertia_beside_friction():
    # Drake takes the rotor of a joint from one of its actuators.
    masses = []
    for options in ({}, {"motor_friction": 0.1}, {"friction": FrictionOptions(coulomb=(0.1, 0.0) * 3)}):
        plant = Run(robot=UNEQUAL, **options).stewart.plant
        masses.append(plant.CalcMassMatrix(plant.CreateDefaultContext()))
    for other in masses[1:]:
        np.testing.assert_allclose(other, masses[0], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("share", [1.0, 0.5], ids=["coulomb", "stribeck"])
@pytest.mark.parametrize(
    ("robot", "break_away", "viscous"), [(UNEQUAL, 0.3, 0.0), (SMALL, 0.058, 0.095)], ids=["unequal", "small"]
)
def test_below_break_away_a_motor_yields_5e_6_rad_at_most_and_then_rests(robot, break_away, viscous, share):
    said = FrictionOptions(coulomb=share * break_away, break_away=break_away, stribeck_velocity=0.02, viscous=viscous)
    run = Run(robot=robot, friction=said)
    # The closed loops of the plant stand a little off: what is left of the load beside friction is known to 1e-3.
    run.hold(static_torque(robot, robot.home_pose) + 0.98 * break_away * SIGNS)
    angles = [run.angles, *(run.to(0.01 * step).angles for step in range(1, 21))]
    assert np.abs(np.array(angles) - angles[0]).max() <= 5e-6
    assert np.abs(np.diff(angles[10:], axis=0)).max() < 1e-9
    assert np.abs(run.rates).max() < 1e-8


def test_bad_friction_is_refused_in_a_line():
    with pytest.raises(ConfigurationError, match=r"plant\.friction\.break_away: expected at least"):
        DrakeOptions.from_dict({"friction": {"coulomb": 0.1, "break_away": 0.05}})
    with pytest.raises(ConfigurationError, match=r"plant\.motor_friction: expected 0, because `friction`"):
        DrakeOptions.from_dict({"friction": {}, "motor_friction": 0.1})


@pytest.mark.parametrize("kind", ["drake", "closed_form", "mujoco"])
def test_brakes_hold_each_crank_by_its_motors_limit_whatever_friction_was_given(kind):
    plant = PLANTS.section({"kind": kind, "motor_friction": 0.1, "motor_damping": 0.01})
    held = plant.braked(UNEQUAL).friction_options
    assert (held.coulomb, held.viscous) == (tuple(UNEQUAL.effort_limits), (0.0,) * 6)


def test_a_record_of_friction_has_the_names_of_the_keys():
    levels = {"coulomb": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "stribeck_velocity": 0.05, "viscous": 0.02}
    law = DrakeOptions.from_dict({"friction": levels}).friction_of(UNEQUAL)[0]
    assert law["coulomb"].tolist() == law["break_away"].tolist() == levels["coulomb"]
    assert set(law["stribeck_velocity"]) == {0.05}
    assert set(law["viscous"]) == {0.02}
    np.testing.assert_allclose(law["stiffness"], 1000.0 * UNEQUAL.crank_axis_inertias / 0.001**2)
    believed = FrictionCompensation(break_away=0.3, width=0.01).record()[0]
    assert (believed["break_away"][0], believed["width"], believed["stiffness"].any()) == (0.3, 0.01, False)
