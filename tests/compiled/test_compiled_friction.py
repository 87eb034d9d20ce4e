import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import offsets, robots
from strategies import vectors

from stewart_drake.compiled import friction as compiled
from stewart_drake.mechanics import friction
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.mechanics.friction import Bristles, friction_law
from stewart_drake.mechanics.kinematics import pose_jacobian, reach_margin


@settings(max_examples=60)
@given(robots, offsets(0.3), vectors(6, 1.5), vectors(6), vectors(6), st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_compiled_friction_is_that_of_the_arrays(robot, offset, tension, slips, rates, step):
    pose = robot.home_pose + offset
    if reach_margin(robot, pose).min() < 0.01:
        return
    mobility = pose_jacobian(robot, pose) @ pose_acceleration_map(robot, pose)
    law = friction_law(0.05, 0.03 * np.arange(2, 8), 0.02, 0.01, robot.crank_axis_inertias, step)
    bristles, angles = Bristles(tension * law.break_away / law.stiffness, 0.05 * slips), 0.1 * rates * step
    packed, memory, found = np.stack(law), np.stack(bristles), np.empty(6)
    compiled.implicit_torque(packed, memory, angles, rates, mobility, step, friction.SWEEPS, found)
    expected = friction.implicit_torque(law, bristles, angles, rates, mobility, step)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    pulled, cranks, moved = np.empty(18), np.array([1, 0, 2, 5, 4, 3]), friction.moved(law, bristles, angles, step)
    compiled.pull(packed, memory.ravel(), angles[cranks], cranks, step, pulled)
    compiled.moved(packed, memory, angles, step)
    np.testing.assert_allclose(memory, np.stack(moved), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(pulled[:12], memory.ravel(), rtol=1e-15)
    np.testing.assert_allclose(pulled[12:], friction.relief(law, moved.slip), rtol=1e-12, atol=1e-15)


# --- hunting --------------------------------------------------------------------------------------------------------


def hunted(ratios, seconds=60.0, coulomb=0.05):
    """Errors (n, 6) of six uncoupled motors under PID at rest off the target; break-away is `ratios` times Coulomb.

    Each turns 2e-3 kg m^2; the controller's poles without friction are at -20 rad/s, three times.
    """
    step, inertia, pole = 1e-3, 2e-3, 20.0
    law = np.stack(friction_law(coulomb, coulomb * ratios, 0.02, 0.0, np.full(6, inertia), step))
    angles, rates, integral, found = np.full(6, 0.02), np.zeros(6), np.zeros(6), np.empty(6)
    bristles, mobility, seen = np.stack(friction.at_rest(angles)), np.eye(6) / inertia, []
    for _ in range(round(seconds / step)):
        integral = integral + step * angles
        free = rates - step * (3.0 * pole**2 * angles + 3.0 * pole * rates + pole**3 * integral)
        compiled.implicit_torque(law, bristles, angles, free, mobility, step, 1, found)
        rates = free + step / inertia * found
        angles = angles + step * rates
        compiled.moved(law, bristles, angles, step)
        seen.append(angles)
    return np.array(seen)


@pytest.mark.slow
def test_integral_action_hunts_where_break_away_is_above_coulomb_and_only_there():
    """Hunting needs a level at rest above that in sliding.

    B. Armstrong and B. Amin, "PID control in the presence of static friction" (Automatica 32, 1996): no limit cycle
    where the two are equal. R. Hensen, M. van de Molengraft and M. Steinbuch, "Friction induced hunting limit cycles"
    (Automatica 39, 2003): the same of bristles. A jump from rest begins with the difference of the two, so that the
    amplitude grows with their ratio.
    """
    errors = hunted(np.array([1.0, 1.2, 1.4, 1.6, 1.8, 2.0]))
    middle, end = (np.ptp(part, axis=0) for part in (errors[20000:40000], errors[40000:]))
    assert end[0] < 1e-6
    assert (end[1:] > 1e-4).all()
    assert (np.diff(end) > 0.0).all()
    # A limit cycle: it neither dies nor grows. It stands still at its turning points, and jumps between.
    np.testing.assert_allclose(end[2:], middle[2:], rtol=0.05)
    assert np.mean(np.abs(np.diff(errors[40000:, 5])) < 1e-9) > 0.5
