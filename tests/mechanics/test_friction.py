from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, vectors

from stewart_drake.base.records import record
from stewart_drake.mechanics import friction
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.mechanics.friction import FrictionOptions, bristle_stiffness
from stewart_drake.mechanics.kinematics import pose_jacobian

STEP = 1e-3
COULOMB, BREAK_AWAY, STRIBECK_VELOCITY, VISCOUS = 0.05, 0.08, 0.02, 0.01


def friction_law(coulomb, break_away, velocity, viscous, step):
    levels = {"coulomb": coulomb, "break_away": break_away, "stribeck_velocity": velocity, "viscous": viscous}
    return FrictionOptions.from_dict(levels).record(bristle_stiffness(ROBOT.crank_axis_inertias, step), step)


LAW = friction_law(COULOMB, BREAK_AWAY, STRIBECK_VELOCITY, VISCOUS, STEP)
# Cranks' accelerations per torque at home, where every motor moves every crank.
MOBILITY = pose_jacobian(ROBOT, ROBOT.home_pose) @ pose_acceleration_map(ROBOT, ROBOT.home_pose)
SET = BREAK_AWAY / LAW["stiffness"][0, 0]

laws = st.builds(
    lambda coulomb, more, rate, viscous, step: (friction_law(coulomb, coulomb + more, rate, viscous, step), step),
    st.floats(0.0, 0.5),
    st.floats(0.001, 0.5),
    st.floats(1e-4, 1.0),
    st.floats(0.0, 0.1),
    st.sampled_from([1e-4, 1e-3, 1e-2]),
)
# Steps of the angles, from a hundredth of the elastic set to a thousand times it.
motions = st.lists(st.tuples(vectors(6), st.sampled_from([1e-2, 0.3, 1.0, 3.0, 1e3])), min_size=1, max_size=40)


def of(law):
    """The numbers of a law by name."""
    return SimpleNamespace(**{name: law[name][0] for name in law.dtype.names})


def levels(law, slip):
    k = of(law)
    return k.coulomb + (k.break_away - k.coulomb) * np.exp(-((slip / k.stribeck_velocity) ** 2))


def explicit(law, anchor, slip, angles, rates, step):
    """Torques (6,) by the equation itself, at the end of a step; bristles as at its beginning."""
    k, bound = of(law), levels(law, slip)
    return np.clip(k.stiffness * (anchor - angles - step * rates), -bound, bound) - k.viscous * rates


def implicit(law, anchor, slip, angles, rates, mobility=MOBILITY, step=STEP, sweeps=friction.SWEEPS):
    out, bristles = np.empty(6), np.zeros(1, np.dtype([("anchor", float, 6), ("slip", float, 6)]))
    bristles["anchor"], bristles["slip"] = anchor, slip
    friction.implicit_torque(record(law), record(bristles), angles, rates, mobility, step, sweeps, out)
    return out


def driven(law, step, moves, tension=0.0):
    """Torques (n, 6) at the ends of the steps of a given motion, its increments, and anchors and slips at its end."""
    k = of(law)
    angles, torques, increments = np.zeros(6), [], []
    anchor, slip = tension * k.break_away / k.stiffness + np.zeros(6), np.zeros(6)
    for direction, scale in moves:
        increments.append(scale * k.break_away[0] / k.stiffness[0] * direction)
        angles = angles + increments[-1]
        torques.append(explicit(law, anchor, slip, angles, increments[-1] / step, step))
        friction.update_bristles(record(law), angles, step, anchor, slip)
    return np.array(torques), np.array(increments), anchor, slip


@settings(max_examples=100)
@given(laws, motions, vectors(6))
def test_over_any_motion_friction_feeds_at_most_what_its_bristles_held(law_and_step, moves, tension):
    law, step = law_and_step
    torques, increments, _, _ = driven(law, step, moves, tension)
    held = 0.5 * of(law).break_away ** 2 / of(law).stiffness
    fed = np.cumsum(torques * increments, axis=0)
    assert (fed <= held * (tension**2 + 1e-9)).all()


@pytest.mark.parametrize("rate", [1e-5, 0.003, 0.02, 0.05, 1.0])
def test_steady_sliding_meets_the_stribeck_curve(rate):
    torques, _, _, slip = driven(LAW, STEP, [(np.full(6, rate * STEP / SET), 1.0)] * 400)
    curve = COULOMB + (BREAK_AWAY - COULOMB) * np.exp(-((rate / STRIBECK_VELOCITY) ** 2))
    np.testing.assert_allclose(torques[-1], -(curve + VISCOUS * rate), rtol=1e-6)
    np.testing.assert_allclose(slip, rate, rtol=1e-6)
    assert friction.level(record(LAW), 3, rate) == pytest.approx(curve, rel=1e-12)


@settings(max_examples=40)
@given(laws, vectors(6), vectors(6), vectors(6), st.sampled_from([1e-4, 1e-2, 1.0]))
def test_the_implicit_torque_is_that_of_the_motion_it_makes(law_and_step, tension, slips, rates, size):
    law, step = law_and_step
    anchor, slip, angles = tension * of(law).coulomb / of(law).stiffness, 0.01 * slips, np.zeros(6)
    result = implicit(law, anchor, slip, angles, size * rates, MOBILITY, step, sweeps=100)
    end = size * rates + step * MOBILITY @ result
    expected = explicit(law, anchor, slip, angles + step * end, end, step)
    np.testing.assert_allclose(result, expected, atol=1e-9 * of(law).break_away.max())
