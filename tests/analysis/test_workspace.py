import numpy as np
import pytest
from strategies import ROBOT, ROBOTS

from stewart_drake.analysis.workspace import (
    COORDINATES,
    LIMIT_NAMES,
    boundary,
    governing_limit,
    spanning_grid,
    spread_directions,
    study_poses,
    survey,
    utilisation,
)
from stewart_drake.mechanics.dynamics import force_map, static_torque
from stewart_drake.mechanics.kinematics import conditioning, leg_geometry, reach_margin, rod_lines
from stewart_drake.scenario.limits import ReferenceLimits, limit_margins, measure_poses

HOME = ROBOT.home_pose
LIMITS = ReferenceLimits()
WIDE = np.array([1.2, 1.55, 1.6, 0.1, 0.1, 0.08])


def wide_poses(count, seed=0, robot=ROBOT):
    """Poses far and wide, in reach or not, beyond singularities or not."""
    return robot.home_pose + np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 6)) * WIDE


def poses_at(kind, points):
    """Poses with three coordinates from points (n, 3), the others from home."""
    pose = np.tile(HOME, (len(points), 1))
    pose[:, COORDINATES[kind]] = points
    return pose


def reachable(pose, robot=ROBOT):
    return pose[(reach_margin(robot, pose) >= 0.0).all(axis=-1)]


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_measures_are_the_extremes_of_what_mechanics_gives(robot):
    pose = reachable(wide_poses(3000, robot=robot), robot)
    measures = measure_poses(robot, pose)
    legs, home = leg_geometry(robot, pose), rod_lines(leg_geometry(robot, robot.home_pose))
    side = np.sign(np.linalg.det(rod_lines(legs)) * np.linalg.det(home))
    assert (side < 0.0).any()
    np.testing.assert_allclose(measures.transmission, np.abs(legs.transmission).min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(measures.conditioning, side * conditioning(robot, pose), rtol=0.0, atol=1e-13)
    torque = np.abs(static_torque(robot, pose)).max(axis=1)
    assert (np.abs(measures.holding_torque / torque - 1.0) * np.abs(measures.conditioning) < 1e-14).all()


def test_force_and_moment_are_the_inscribed_balls_of_the_statics_map():
    pose = reachable(wide_poses(400, 1))
    pose = pose[measure_poses(ROBOT, pose).holding_torque < ROBOT.effort_limit]
    assert len(pose) > 20
    measures = measure_poses(ROBOT, pose)
    held, inverse = static_torque(ROBOT, pose), np.linalg.inv(force_map(ROBOT, pose, "statics"))
    directions = np.random.default_rng(2).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for part, found in ((slice(0, 3), measures.moment), (slice(3, 6), measures.force)):
        for k in range(len(pose)):
            rows = inverse[k][:, part]
            worst = rows / np.linalg.norm(rows, axis=1, keepdims=True)
            per_unit = np.concatenate([directions, worst, -worst]) @ rows.T
            # Along one direction the motors allow r until the first |t_i + r g_i| reaches the limit.
            along = np.min((ROBOT.effort_limit - held[k] * np.sign(per_unit)) / np.abs(per_unit), axis=1)
            assert found[k] <= along.min() * (1.0 + 1e-9)
            assert found[k] == pytest.approx(along.min(), rel=1e-6)
            size = found[k] * (1.0 - 1e-9)
            assert (np.abs(held[k] + size * per_unit) <= ROBOT.effort_limit).all()


def test_utilisation_is_above_one_exactly_where_a_margin_is_negative():
    pose = wide_poses(4000, 4)
    robot = ROBOT.replace(legs=[{"crank_angle_range": (-0.8, 1.8)}] * 6)
    use = utilisation(robot, LIMITS, pose, measure_poses(robot, pose))
    assert tuple(use) == LIMIT_NAMES
    # At rest, and seen from home: margins count a changed side of the parallel singularity from the first sample.
    seen = np.concatenate([HOME[None], pose])
    margins = limit_margins(robot, LIMITS, seen, np.zeros_like(seen), np.zeros_like(seen), 9.81)
    margins["ball_swing"], margins["universal_swing"] = np.hsplit(margins["joint_swing"], 2)
    for name in LIMIT_NAMES:
        broken = (margins[name][1:] < 0.0).any(axis=1)
        np.testing.assert_array_equal(use[name] > 1.0, broken, err_msg=name)
        assert 0 < broken.sum() < len(pose), name


@pytest.mark.parametrize("kind", ["position", "orientation"])
def test_rays_end_where_the_named_limit_is_met(kind):
    rng = np.random.default_rng(6)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ends = boundary(ROBOT, LIMITS, kind, HOME, directions)
    radius = ends.radius
    start = HOME[COORDINATES[kind]]

    def use_at(at):
        pose = poses_at(kind, start + at[:, None] * directions)
        return governing_limit(utilisation(ROBOT, LIMITS, pose, measure_poses(ROBOT, pose)))

    for share in (0.25, 0.6, 1.0):
        assert (use_at(share * radius)[0] <= 1.0).all()
    beyond, cause = use_at(radius + 1e-5)
    assert (beyond > 1.0).all()
    np.testing.assert_array_equal(cause, ends.limit)


def test_directions_cover_the_sphere_evenly_and_rays_and_grid_agree_on_the_volume():
    directions = spread_directions(2000)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(directions.T @ directions / 2000, np.eye(3) / 3.0, atol=1e-3)
    surface = boundary(ROBOT, LIMITS, "position", HOME, spread_directions(500))
    found = survey(ROBOT, LIMITS, spanning_grid(ROBOT, "position", HOME, 20_000))
    volume = 4.0 / 3.0 * np.pi * (surface.radius**3).mean()
    assert volume == pytest.approx(found.size(found.connected), rel=0.03)
    numbers, _ = study_poses(ROBOT, LIMITS, 9.81, HOME, 2000, 500)
    assert numbers["workspaces"]["position"]["inscribed_radius"] == surface.radius.min()
    ends = boundary(ROBOT, LIMITS, "position", HOME, np.eye(3)).radius
    np.testing.assert_array_equal(numbers["ranges"][1][3:], HOME[3:] + ends)
