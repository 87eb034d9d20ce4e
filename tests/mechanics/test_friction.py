import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, vectors

from stewart_drake.mechanics import friction
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.mechanics.friction import Bristles, FrictionLaw, friction_law
from stewart_drake.mechanics.kinematics import pose_jacobian

STEP = 1e-3
COULOMB, BREAK_AWAY, STRIBECK_RATE, VISCOUS = 0.05, 0.08, 0.02, 0.01
LAW = friction_law(COULOMB, BREAK_AWAY, STRIBECK_RATE, VISCOUS, ROBOT.crank_axis_inertias, STEP)
# Cranks' accelerations per torque at home, where every motor moves every crank.
MOBILITY = pose_jacobian(ROBOT, ROBOT.home_pose) @ pose_acceleration_map(ROBOT, ROBOT.home_pose)
SET = BREAK_AWAY / LAW.stiffness[0]

laws = st.builds(
    lambda coulomb, more, rate, viscous, step: (
        friction_law(coulomb, coulomb + more, rate, viscous, ROBOT.crank_axis_inertias, step),
        step,
    ),
    st.floats(0.0, 0.5),
    st.floats(0.001, 0.5),
    st.floats(1e-4, 1.0),
    st.floats(0.0, 0.1),
    st.sampled_from([1e-4, 1e-3, 1e-2]),
)
# Steps of the angles, from a hundredth of the elastic set to a thousand times it.
motions = st.lists(st.tuples(vectors(6), st.sampled_from([1e-2, 0.3, 1.0, 3.0, 1e3])), min_size=1, max_size=40)


def driven(law, step, moves, start=None):
    """Torques (n, 6) at the ends of the steps of a given motion, its increments, and the bristles at its end."""
    size = law.break_away[0] / law.stiffness[0]
    angles = np.zeros(6)
    bristles, torques, increments = start or friction.at_rest(angles), [], []
    for direction, scale in moves:
        increments.append(scale * size * direction)
        angles = angles + increments[-1]
        torques.append(friction.torque(law, bristles, angles, increments[-1] / step))
        bristles = friction.moved(law, bristles, angles, step)
    return np.array(torques), np.array(increments), bristles


@settings(max_examples=200)
@given(laws, motions, vectors(6))
def test_over_any_motion_friction_feeds_at_most_what_its_bristles_held(law_and_step, moves, tension):
    law, step = law_and_step
    stretched = Bristles(tension * law.break_away / law.stiffness, np.zeros(6))
    torques, increments, _ = driven(law, step, moves, stretched)
    held = 0.5 * law.break_away**2 / law.stiffness
    fed = np.cumsum(torques * increments, axis=0)
    assert (fed <= held * (tension**2 + 1e-9)).all()


@given(laws, motions)
def test_a_motion_the_other_way_meets_the_opposite_torque(law_and_step, moves):
    law, step = law_and_step
    there, _, _ = driven(law, step, moves)
    back, _, _ = driven(law, step, [(-direction, scale) for direction, scale in moves])
    np.testing.assert_array_equal(back, -there)


@given(laws, motions)
def test_a_torque_stays_within_break_away_and_the_viscous_part(law_and_step, moves):
    law, step = law_and_step
    torques, increments, _ = driven(law, step, moves)
    assert (np.abs(torques + law.viscous * increments / step) <= law.break_away * (1.0 + 1e-12)).all()


@pytest.mark.parametrize("rate", [1e-5, 0.003, 0.02, 0.05, 1.0])
def test_steady_sliding_meets_the_stribeck_curve_and_the_viscous_part(rate):
    torques, _, bristles = driven(LAW, STEP, [(np.full(6, rate * STEP / SET), 1.0)] * 400)
    curve = COULOMB + (BREAK_AWAY - COULOMB) * np.exp(-((rate / STRIBECK_RATE) ** 2))
    np.testing.assert_allclose(torques[-1], -(curve + VISCOUS * rate), rtol=1e-6)
    np.testing.assert_allclose(bristles.slip, rate, rtol=1e-6)


def test_within_the_elastic_set_nothing_slips_and_all_comes_back():
    # Without damper, so that the spring is seen alone.
    law = LAW._replace(damping=np.zeros(6), viscous=np.zeros(6))
    moves = [(np.ones(6), 0.999 * step) for step in (0.25, 0.25, 0.25, 0.25, -1.0)]
    torques, _, bristles = driven(law, STEP, moves)
    np.testing.assert_allclose(torques[:, 0], -0.999 * BREAK_AWAY * np.array([0.25, 0.5, 0.75, 1.0, 0.0]), atol=1e-12)
    np.testing.assert_array_equal(bristles.anchor, np.zeros(6))


def test_a_motor_that_has_slipped_takes_break_away_to_move_again():
    _, increments, bristles = driven(LAW, STEP, [(np.ones(6), 1e3)] * 5)
    assert friction.level(LAW, bristles.slip).max() < 1.01 * COULOMB
    angles = increments.sum(axis=0)
    rested = friction.moved(LAW, bristles, angles, STEP)
    assert friction.level(LAW, rested.slip).min() > 0.99 * BREAK_AWAY


# --- solved with the motion --------------------------------------------------------------------------------------


@settings(max_examples=40)
@given(laws, vectors(6), vectors(6), vectors(6), st.sampled_from([1e-4, 1e-2, 1.0]))
def test_the_implicit_torque_is_that_of_the_motion_it_makes(law_and_step, tension, slips, rates, size):
    law, step = law_and_step
    bristles, angles = Bristles(tension * law.coulomb / law.stiffness, 0.01 * slips), np.zeros(6)
    found = friction.implicit_torque(law, bristles, angles, size * rates, MOBILITY, step, sweeps=100)
    end = size * rates + step * MOBILITY @ found
    expected = friction.torque(law, bristles, angles + step * end, end)
    np.testing.assert_allclose(found, expected, atol=1e-9 * law.break_away.max())


@settings(max_examples=20)
@given(vectors(6), vectors(6, 0.3))
def test_thirty_sweeps_are_enough(tension, rates):
    bristles, angles = Bristles(tension * SET, np.zeros(6)), np.zeros(6)
    some, many = (
        friction.implicit_torque(LAW, bristles, angles, rates, MOBILITY, STEP, sweeps=n) for n in (friction.SWEEPS, 120)
    )
    np.testing.assert_allclose(some, many, atol=1e-5 * COULOMB)


def load(ratio, steps, law=LAW, step=STEP):
    """Angles (steps, 6) of cranks under a torque of `ratio` times break-away on each motor, by the exact inertia."""
    angles, rates, torque = np.zeros(6), np.zeros(6), ratio * BREAK_AWAY * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    bristles, seen = friction.at_rest(angles), []
    for _ in range(steps):
        free = rates + step * MOBILITY @ torque
        rates = free + step * MOBILITY @ friction.implicit_torque(law, bristles, angles, free, MOBILITY, step)
        angles = angles + step * rates
        bristles = friction.moved(law, bristles, angles, step)
        seen.append(angles)
    return np.array(seen)


@pytest.mark.parametrize("ratio", [0.5, 0.9, 0.98])
def test_a_load_below_break_away_is_held_at_1_ms(ratio):
    angles = load(ratio, 200)
    assert np.abs(angles).max() < 1.1 * SET
    assert np.abs(angles[-1] - angles[99]).max() / 0.1 < 1e-12
    assert np.abs(load(1.02, 200)[-1]).max() > 1e-3


# --- other arrays ---------------------------------------------------------------------------------------------------


def tensors(named):
    return type(named)(*(torch.as_tensor(each) for each in named))


@pytest.mark.parametrize("width", [0.0, 0.005])
def test_torch_and_batches_give_what_numpy_gives_one_by_one(width):
    rng = np.random.default_rng(4)
    bristles = Bristles(rng.uniform(-1.5, 1.5, (5, 6)) * SET, rng.uniform(-0.05, 0.05, (5, 6)))
    angles, rates = rng.uniform(-1.0, 1.0, (5, 6)) * SET, rng.normal(size=(5, 6)) * 0.1
    laws = FrictionLaw(*(each * rng.uniform(0.5, 2.0, (5, 1)) for each in LAW))

    def each(law, memory, q, v, mobility):
        solved = friction.implicit_torque(law, memory, q, v, mobility, STEP, width)
        return solved, friction.torque(law, memory, q, v, width), *friction.moved(law, memory, q, STEP, width)

    mobility = np.broadcast_to(MOBILITY, (5, 6, 6))
    whole = each(laws, bristles, angles, rates, mobility)
    tensor = each(tensors(laws), tensors(bristles), *map(torch.tensor, (angles, rates, mobility)))
    for k in range(5):
        single = (type(named)(*(x[k] for x in named)) for named in (laws, bristles))
        for got, batch, other in zip(each(*single, angles[k], rates[k], MOBILITY), whole, tensor, strict=True):
            np.testing.assert_allclose(batch[k], got, rtol=1e-12, atol=1e-18)
            np.testing.assert_allclose(other[k].numpy(), got, rtol=1e-9, atol=1e-15)


def test_rounded_corners_have_gradients_that_differences_confirm():
    rng, width = np.random.default_rng(5), 0.01
    memory = torch.tensor(rng.uniform(-1.0, 1.0, (2, 6)) * SET)
    level = torch.tensor(LAW.coulomb)

    def after_two_steps(coulomb, push):
        law = tensors(LAW)._replace(coulomb=coulomb)
        bristles, q, v = Bristles(memory[0], 0.0 * memory[1]), 0.0 * push, 0.0 * push
        mobility = torch.tensor(MOBILITY)
        for _ in range(2):
            free = v + STEP * (mobility @ push)
            v = free + STEP * (
                mobility @ friction.implicit_torque(law, bristles, q, free, mobility, STEP, width, sweeps=10)
            )
            q = q + STEP * v
            bristles = friction.moved(law, bristles, q, STEP, width)
        return 1e3 * v, 1e6 * q

    # At the levels, where sharp corners would have none.
    push = torch.tensor(LAW.break_away * np.array([1.0, -1.0, 0.5, -0.5, 1.5, 0.0]), requires_grad=True)
    assert torch.autograd.gradcheck(after_two_steps, (level.requires_grad_(), push), eps=1e-7, rtol=1e-3, atol=1e-4)


@given(vectors(6, 3.0), st.floats(1e-6, 0.02))
def test_rounding_takes_less_than_its_width(pull, width):
    bristles = Bristles(pull * SET, np.zeros(6))
    sharp, smooth = (friction.torque(LAW, bristles, np.zeros(6), np.zeros(6), w) for w in (0.0, width))
    assert (np.abs(smooth - sharp) <= 0.51 * width).all()
