"""MuJoCo's simulation of a robot, with the state of `StewartRobot.assemble` to start from: an oracle beside Drake."""

import mujoco
import numpy as np

from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.model_files import mjcf_text


class MujocoRobot:
    def __init__(self, robot, gravity=STANDARD_GRAVITY, options=None):
        self.model = mujoco.MjModel.from_xml_string(mjcf_text(robot, gravity, options))
        self.data = mujoco.MjData(self.model)

    def set_state(self, stewart, state):
        index, data = stewart.indices, self.data
        mujoco.mj_resetData(self.model, data)
        for leg in range(6):
            names = (f"motor_{leg}", f"universal_{leg}_x", f"universal_{leg}_y")
            positions = (index.crank[leg], *index.rod[leg])
            rates = (index.crank_rate[leg], *index.rod_rate[leg])
            for name, position, rate in zip(names, positions, rates, strict=True):
                data.joint(name).qpos, data.joint(name).qvel = state[position], state[rate]
        platform = data.joint("platform")
        platform.qpos = np.concatenate([state[index.position], state[index.quaternion]])
        rotation = rotation_matrix(stewart.pose_and_rate(state)[0][:3])
        # A free joint's angular velocity is in the body's own axes, and comes after the linear one.
        platform.qvel = np.concatenate([state[index.twist[3:]], rotation.T @ state[index.twist[:3]]])

    def advance(self, torque, steps):
        self.data.ctrl = torque
        mujoco.mj_step(self.model, self.data, steps)

    @property
    def acceleration(self):
        # (6,) d(twist)/dt of the platform in the world, where MuJoCo evaluated it last.
        own = self.data.joint("platform").qacc
        return np.concatenate([self.data.body("platform").xmat.reshape(3, 3) @ own[3:], own[:3]])

    @property
    def platform(self):
        # X, Y, Z and the quaternion w, x, y, z.
        return np.array(self.data.joint("platform").qpos)
