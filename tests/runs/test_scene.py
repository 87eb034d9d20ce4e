"""Where a browser draws the robot's links, against Drake's own kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stewart_drake import DrakeOptions, RobotParameters, build_plant, inverse_kinematics, load_robot
from stewart_drake.runs.scene import link_poses

ROBOTS = {"paper": RobotParameters(), "reachy_mini": load_robot("reachy_mini")}


@pytest.fixture(params=["universal", "ball"])
def joint(request):
    return request.param


@pytest.mark.parametrize("name", ROBOTS)
def test_links_are_where_drake_has_them(name, joint):
    robot, rng = ROBOTS[name], np.random.default_rng(3)
    diagram, stewart = build_plant(robot, DrakeOptions(rod_joint=joint))
    context = diagram.CreateDefaultContext()
    mine = stewart.plant.GetMyMutableContextFromRoot(context)
    poses = np.array(robot.home_pose) + rng.uniform(-0.05, 0.05, (5, 6)) * ([1.0] * 3 + [robot.home_height] * 3)
    states = stewart.assemble(poses)
    # A rod that has broken: off its way, and no other.
    states[..., stewart.indices.rod[2]] += 0.3
    links = link_poses(robot, poses, stewart.crank_angles(states), poses, stewart.rod_directions(states))
    for state, pose, at in zip(states, poses, links, strict=True):
        stewart.plant.SetPositionsAndVelocities(mine, state)
        names = [f"{kind}_{leg}" for kind in ("crank", "rod") for leg in range(6)] + ["platform"]
        for body, seven in zip(names, at, strict=False):
            wanted = stewart.plant.GetBodyByName(body).EvalPoseInWorld(mine)
            np.testing.assert_allclose(seven[:3], wanted.translation(), atol=1e-12)
            turn, wanted_turn = Rotation.from_quat(seven[3:]).as_matrix(), wanted.rotation().matrix()
            # A rod looks the same however it spins about its own axis.
            columns = [2] if body.startswith("rod") else [0, 1, 2]
            np.testing.assert_allclose(turn[:, columns], wanted_turn[:, columns], atol=1e-12)
        np.testing.assert_allclose(at[-1], at[-2], atol=1e-12)
        closed = link_poses(robot, pose, inverse_kinematics(robot, pose), pose)
        whole = [leg for leg in range(13) if leg != 8]
        np.testing.assert_allclose(closed[whole], at[whole], atol=1e-9)
