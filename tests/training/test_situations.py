import itertools

import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.runs.simulation import run
from stewart_drake.training.situations import HELD_OUT, KINDS, ROBOTS, TRAINING, VALIDATION, kinds_of, situation

EACH = [(kind, robot) for robot in ROBOTS for kind in kinds_of(robot)]


@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_the_same_arguments_give_the_same_run_and_another_seed_another(kind, robot):
    one = situation(kind, robot, TRAINING[3])
    assert one.to_dict() == situation(kind, robot, TRAINING[3]).to_dict()
    assert one.to_dict() != situation(kind, robot, HELD_OUT[3]).to_dict()


@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_a_motion_is_within_the_limits_and_nothing_else_than_drawn_is_changed(kind, robot):
    for seed in (TRAINING[0], HELD_OUT[0]):
        made, base = situation(kind, robot, seed), ROBOTS[robot].base
        assert check_reference(made.robot, made.limits, made.reference, made.duration).feasible
        for name in ("robot", "tuner", "controller", "estimator", "duration", "friction_compensation", "safety"):
            assert getattr(made, name) == getattr(base, name)


def test_seeds_of_training_choice_and_judgement_never_meet():
    ends = [(seeds.start, seeds.stop) for seeds in (TRAINING, VALIDATION, HELD_OUT)]
    assert all(before[1] <= after[0] for before, after in itertools.pairwise(ends))
    assert len({len(seeds) for seeds in (TRAINING, VALIDATION, HELD_OUT)}) == 1


def test_some_kinds_are_never_trained_on():
    for robot in ROBOTS:
        trained, untrained = (set(kinds_of(robot, each)) for each in (True, False))
        assert trained
        assert untrained
        assert not trained & untrained
        assert trained | untrained == set(kinds_of(robot))


def test_pushes_come_within_the_half_that_is_scored():
    for kind in ("pushes", "payload with pushes"):
        for robot in KINDS[kind].robots:
            for seed in range(10):
                made = situation(kind, robot, seed)
                (push,) = made.disturbances
                assert 0.5 * made.duration < push.time < made.duration


@pytest.mark.parametrize(
    ("arguments", "key"),
    [(("holds", "paper", 0), "kind"), (("nod", "paper", 0), "robot"), (("hold", "paper", -1), "seed")],
)
def test_what_there_is_not_is_refused(arguments, key):
    with pytest.raises(ConfigurationError) as caught:
        situation(*arguments)
    assert caught.value.key == key


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "robot"), EACH)
def test_a_run_completes_at_the_default_setting(kind, robot):
    for seed in (TRAINING[1], HELD_OUT[1]):
        assert run(situation(kind, robot, seed).replace({"plant.engine": "reduced"})).status == "completed"
