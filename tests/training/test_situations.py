import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.runs.simulation import run
from stewart_drake.training.situations import HELD_OUT, KINDS, ROBOTS, TRAINING, kinds_of, situation

EACH = [(kind, robot) for robot in ROBOTS for kind in kinds_of(robot)]


@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_a_motion_is_within_the_limits_and_nothing_else_than_drawn_is_changed(kind, robot):
    for seed in (TRAINING[0], HELD_OUT[0]):
        made, base = situation(kind, robot, seed), ROBOTS[robot].base
        assert check_reference(made.robot, made.limits, made.reference, made.duration).feasible
        assert made.to_dict() == situation(kind, robot, seed).to_dict()
        for name in ("robot", "tuner", "controller", "estimator", "duration", "friction_compensation", "safety"):
            assert getattr(made, name) == getattr(base, name)


def test_pushes_come_within_the_half_that_is_scored():
    for kind in ("pushes", "payload with pushes"):
        for robot in KINDS[kind].robots:
            for seed in range(10):
                made = situation(kind, robot, seed)
                (push,) = made.disturbances
                assert 0.5 * made.duration < push.time < made.duration


def test_a_kind_that_a_robot_does_not_have_is_refused():
    with pytest.raises(ConfigurationError, match=r"kind: expected one of hold, .*, for paper"):
        situation("nod", "paper", 0)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_a_run_completes_at_the_default_setting(kind, robot):
    for seed in (TRAINING[1], HELD_OUT[1]):
        assert run(situation(kind, robot, seed).replace({"plant.engine": "reduced"})).status == "completed"
