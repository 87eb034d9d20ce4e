import numpy as np
import pytest

from stewart_drake.studies.tune import minimise

AT = np.array([0.3, -1.2, 4.0])


def quadratic(points):
    return [float(np.sum((point - AT) ** 2 * [1.0, 4.0, 0.1])) for point in points]


@pytest.mark.parametrize("diagonal", [False, True])
@pytest.mark.parametrize("bounded", [False, True])
def test_it_finds_the_least_of_a_quadratic(bounded, diagonal):
    box = {"low": np.array([-1.0, -2.0, 0.0]), "high": np.array([1.0, 2.0, 10.0])} if bounded else {}
    options = {"generations": 60, "population": 8, "seed": 1, "spread": 0.2 if bounded else 1.0, "diagonal": diagonal}
    found, cost = minimise(quadratic, np.array([0.0, 0.0, 5.0]), **box, **options)
    assert cost < 1e-3
    assert found == pytest.approx(AT, abs=0.1)


def test_points_stay_within_the_box_and_the_start_comes_first():
    low, high = np.array([0.0, -0.5]), np.array([0.2, 0.5])
    asked = []

    def evaluate(points):
        asked.append(np.array(points))
        # Outside of the box.
        return [float(np.sum((point - 3.0) ** 2)) for point in points]

    found, _ = minimise(evaluate, np.array([0.1, 0.0]), low, high, generations=20, population=6, seed=2)
    assert asked[0] == pytest.approx(np.array([[0.1, 0.0]]))
    assert all(((points >= low - 1e-12) & (points <= high + 1e-12)).all() for points in asked)
    assert all(len(points) == 6 for points in asked[1:])
    assert found == pytest.approx(high, abs=0.02)


def test_the_same_seed_asks_for_the_same_points_and_another_for_others():
    def points_of(seed):
        asked = []
        minimise(
            lambda points: asked.extend(points) or quadratic(points),
            np.zeros(3),
            generations=3,
            population=5,
            seed=seed,
        )
        return np.array(asked)

    assert np.array_equal(points_of(1), points_of(1))
    assert not np.array_equal(points_of(1)[1:], points_of(2)[1:])


def test_one_number_can_be_searched():
    found, _ = minimise(
        lambda points: [float((point[0] - 0.7) ** 2) for point in points],
        np.array([0.2]),
        np.zeros(1),
        np.ones(1),
        generations=25,
        population=6,
        seed=1,
    )
    assert found.shape == (1,)
    assert found[0] == pytest.approx(0.7, abs=0.02)


def test_a_start_that_is_best_is_what_is_found():
    start = np.array([0.5, 0.5])
    found, cost = minimise(
        lambda points: [0.0 if np.array_equal(point, start) else 1.0 for point in points],
        start,
        generations=2,
        population=4,
        seed=1,
    )
    assert np.array_equal(found, start)
    assert cost == 0.0
