"""MuJoCo as a plant: the MJCF of the scenario's robot, or any other MJCF of a rotary Stewart platform.

Joints outside of the six legs, such as a body's yaw or antennas, are fixed in the configuration of the file. Geometry
is used only for masses: nothing collides. The model's actuators are removed; torques act on the motors' joints.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, cast

import numpy as np

from stewart_drake.base.atomic_files import check_file
from stewart_drake.base.config import Text, choices_text
from stewart_drake.base.errors import ConfigurationError, NotFiniteError, RunFailure, installed_with, pose_text
from stewart_drake.mechanics.dynamics import base_wrenches
from stewart_drake.mechanics.friction import FrictionOptions
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_rate_to_twist, rotation_matrix
from stewart_drake.plant.model_files import home_frames, mjcf_text
from stewart_drake.plant.mujoco_laws import ModelFrames, apply_forces, measure
from stewart_drake.plant.plant_options import MechanismOptions, Simulated, foreign_state
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.gravity import Gravity, base_reading, gravity_vector
from stewart_drake.robot.leg import Moderate
from stewart_drake.robot.robot_files import robot_model

if TYPE_CHECKING:
    import mujoco

    from stewart_drake.plant.mjcf_legs import Fit

_MAX_BYTES = 10_000_000
_CLOSED, _NOT_CLOSED = 1e-12, 1e-9
"""Errors [m] of loops and pose: Newton's method in `initial` stops below the first and fails above the second."""
_ITERATIONS = 100  # Steps of that method at most.
_NEAR = 3.0  # Times `mjcf_legs.ALLOWED`: error below which that method moves the motors' joints too.
_KEY = "plant.model_file"


class MujocoOptions(MechanismOptions):
    """MuJoCo on an MJCF file, of `robot`, of its maker, or of yours; extra `mujoco`.

    Legs and frames are found in the model and must match those of `robot` within 1 mm. Masses are those of the model.
    So are friction, damping, armature and joint limits, unless a key changes them.
    """

    joints_rub: ClassVar[bool] = True
    kind: Literal["mujoco"] = "mujoco"
    model_file: Text | None = None
    """MJCF file, relative to the file that names it; or `package:NAME==VERSION/path`, a file in an installed package;
    or a robot's name or YAML file, for the MJCF of its key `mjcf`; null generates an MJCF from `robot`."""
    motor_joints: tuple[Text, Text, Text, Text, Text, Text] | None = None
    """Names of the motors' joints, in any order; null takes those with an actuator."""
    motor_class: Text | None = None
    """Default class of the MJCF from which the motors' joints take armature, damping, dry friction and force range;
    null leaves them as they are."""
    passive_friction: Moderate = 1.0
    """[-] factor on damping and dry friction of all joints without a motor; 0 for none."""
    passive_armature: Moderate = 1.0
    """[-] factor on the armature of all joints without a motor, 0 for none. A model may give them that of motors by
    mistake, through a default class."""
    motor_damping: Moderate | None = None  # type: ignore[assignment]
    """[N m s/rad] viscous friction of a motor; null takes that of `model_file`, or 0 without one."""
    motor_friction: Moderate | None = None  # type: ignore[assignment]
    """[N m] dry (Coulomb) friction of a motor; null takes that of `model_file`, or 0 without one."""

    def rules(self) -> None:
        """Friction is given by `friction` or by two other keys, without stiction; two keys need a `model_file`."""
        for name in ("motor_friction", "motor_damping"):
            if self.friction is not None and getattr(self, name) is not None:
                allowed = "null, because `friction` is given and has this value"
                raise ConfigurationError(name, getattr(self, name), allowed)
        if self.friction is not None and self.friction.break_away not in (None, self.friction.coulomb):
            allowed = "the same as `coulomb`, or null: MuJoCo has no stiction"
            raise ConfigurationError("friction.break_away", self.friction.break_away, allowed)
        for name in ("motor_joints", "motor_class"):
            if self.model_file is None and getattr(self, name) is not None:
                raise ConfigurationError(name, getattr(self, name), "null, without a `model_file`")

    @property
    def friction_options(self) -> FrictionOptions:
        """Friction of the motors; if it comes from `model_file`, that of the motor with the most."""
        if self.friction is not None:
            return self.friction
        dry, viscous = self.motor_friction, self.motor_damping
        if self.model_file is not None and (dry is None or viscous is None):
            file = ModelFile(self)
            dofs = file.model.jnt_dofadr[[joint.id for joint in file.motors]]
            dry = float(file.model.dof_frictionloss[dofs].max()) if dry is None else dry
            viscous = float(file.model.dof_damping[dofs].max()) if viscous is None else viscous
        return FrictionOptions.from_dict({"coulomb": dry or 0.0, "viscous": viscous or 0.0})

    def make(self, robot: RobotParameters, gravity: Gravity) -> MujocoPlant:
        return MujocoPlant(robot, self, gravity)

    def simulated(self, robot: RobotParameters) -> Simulated:
        if self.model_file is None:
            return {}, []
        file = ModelFile(self)
        fit, model, legs, root = file.fit(robot), file.model, file.legs, file.mjcf_legs.rigid_roots(file.model)
        motors, passive = ([joint.id for joint in joints] for joints in (file.motors, file.passive))
        of_passive = np.isin(model.dof_jntid, passive)
        mass = [
            [model.body_mass[np.isin(root, bodies)].sum() for bodies in group] for group in (legs.rods, legs.cranks)
        ]
        keys = {
            "platform_mass": model.body_mass[root == legs.platform].sum(),
            "rod_mass": tuple(mass[0]),
            "crank_mass": tuple(mass[1]),
            "rotor_inertia": tuple(model.dof_armature[model.jnt_dofadr[motors]]),
            "effort_limit": tuple(file.limits[:, 1]),
        }
        turns = np.where(model.jnt_limited[motors], np.degrees(np.ptp(model.jnt_range[motors], axis=1)), np.inf)
        facts = [
            (f"misfit of the model ({fit.worst})", 1e3 * fit.residual, "mm"),
            ("range of a motor's joint", turns, "deg"),
            ("damping of passive joints", self.passive_friction * model.dof_damping[of_passive], "N m s/rad"),
            ("dry friction of passive joints", self.passive_friction * model.dof_frictionloss[of_passive], "N m"),
            ("armature of passive joints", self.passive_armature * model.dof_armature[of_passive], "kg m^2"),
        ]
        return keys, facts


def _path(given: str) -> Path:
    """Path of the MJCF file for a value of `model_file`."""
    if re.search(r"\.ya?ml$", given) or not re.search(r"[./:\\]", given):
        given = robot_model(given)
    if not given.startswith("package:"):
        return Path(given)
    requirement, _, inside = given.removeprefix("package:").partition("/")
    name = re.split(r"[=<>~! ]", requirement)[0]
    if not name.isidentifier() or not inside:
        raise ConfigurationError(_KEY, given, "package:NAME/path of an MJCF in it, or package:NAME==VERSION/path")
    # The package is located without importing it, so none of its code runs.
    spec = importlib.util.find_spec(name)
    if spec is None or not spec.submodule_search_locations:
        allowed = f"a file in the installed package {name}; pip install --no-deps {requirement}"
        raise ConfigurationError(_KEY, given, allowed)
    return Path(spec.submodule_search_locations[0]) / inside


class ModelFile:
    """An MJCF model without all that the plant does not use: other joints, other equalities, actuators, geometry.

    A `lenient` one takes bodies that a weld holds for one, and without actuators the hinges on the base for motors.
    """

    def __init__(
        self, options: MujocoOptions, text: str = "", spec: mujoco.MjSpec = None, *, lenient: bool = False
    ) -> None:
        with installed_with("stewart-drake[mujoco]"):
            import mujoco
        from stewart_drake.plant import mjcf_legs

        self.mujoco, self.mjcf_legs, self.name = mujoco, mjcf_legs, options.model_file or ""
        path = None if text or spec else check_file(_path(self.name), f"{_KEY} {self.name}", _MAX_BYTES)
        with self.reading():
            spec = spec or (mujoco.MjSpec.from_string(text) if text else mujoco.MjSpec.from_file(str(path)))
            self.spec = spec
            self._strip()
            model = spec.compile()
        names, known = options.motor_joints, [joint.name for joint in spec.joints]
        for name in names or ():
            if name not in known:
                allowed = f"six joints of {self.name}: {choices_text(name, known)}"
                raise ConfigurationError("plant.motor_joints", name, allowed)
        hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).tolist()
        is_motor = (lambda joint: known[joint] in names) if names else partial(self._actuators, model)
        legs = mjcf_legs.find_legs(model, [joint for joint in hinges if is_motor(joint)], welded=lenient)
        if isinstance(legs, int) and lenient and not names:
            # Without actuators, the hinges on the base: the body with most of them.
            bodies = mjcf_legs.rigid_roots(model)[model.body_parentid[model.jnt_bodyid[hinges]]].tolist()
            base = max(bodies, key=bodies.count, default=0)
            on_base = [joint for joint, body in zip(hinges, bodies, strict=True) if body == base]
            legs = mjcf_legs.find_legs(model, on_base, welded=lenient)
        if isinstance(legs, int):
            allowed = f"a model in which six motors each turn a crank with a rod to one platform, not {legs}"
            hint = "a motor is a hinge with an actuator, or one of plant.motor_joints"
            raise ConfigurationError(_KEY, self.name, f"{allowed}; {hint}")
        self.legs, bodies = legs, {legs.platform, *(body for rods in legs.rods for body in rods)}
        self.limits = np.array([self._force_range(model, joint) for joint in legs.motors])
        passive = [joint for joint in range(model.njnt) if int(model.jnt_bodyid[joint]) in bodies]
        self.motors, self.passive = ([spec.joints[joint] for joint in some] for some in (legs.motors, passive))
        self.closures = [spec.equalities[closure] for closure in legs.closures]
        if options.motor_class is not None:
            self._take_class(options.motor_class)
        with self.reading():
            self._delete(
                spec.actuators,
                [equality for equality in spec.equalities if equality.id not in legs.closures],
                [joint for joint in spec.joints if joint.id not in (*legs.motors, *passive)],
            )
            self.model = spec.compile()

    def _strip(self) -> None:
        """Removes geometry that is not needed for masses, and references to it; its mesh files may be missing."""
        spec = self.spec
        spec.compiler.fusestatic = False  # So that the numbers of bodies do not change.
        self._delete(spec.keys, spec.sensors, spec.pairs, spec.excludes, spec.tuples, spec.skins)
        if spec.compiler.inertiafromgeom != self.mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
            self._delete([geom for geom in spec.geoms if geom.parent.explicitinertial])
        for geom in spec.geoms:
            geom.material = ""
        used = {geom.meshname for geom in spec.geoms}
        self._delete(spec.materials, spec.textures, [mesh for mesh in spec.meshes if mesh.name not in used])

    def _delete(self, *groups: Iterable[object]) -> None:
        for element in [element for group in groups for element in group]:
            self.spec.delete(element)

    def _actuators(self, model: mujoco.MjModel, joint: int) -> list[int]:
        on_joint = int(self.mujoco.mjtTrn.mjTRN_JOINT), int(self.mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        found = (model.actuator_trnid[:, 0] == joint) & np.isin(model.actuator_trntype, on_joint)
        return np.flatnonzero(found).tolist()

    def _force_range(self, model: mujoco.MjModel, joint: int) -> tuple[float, float]:
        """Lowest and highest torque [N m] of the model's actuators of a joint."""
        low, high = model.jnt_actfrcrange[joint] if model.jnt_actfrclimited[joint] else (-np.inf, np.inf)
        for actuator in self._actuators(model, joint):
            if model.actuator_forcelimited[actuator]:
                ends = model.actuator_gear[actuator, 0] * model.actuator_forcerange[actuator]
                low, high = max(low, ends.min()), min(high, ends.max())
        return float(low), float(high)

    def _take_class(self, name: str) -> None:
        default = self.spec.find_default(name)
        if default is None:
            known = re.findall(r'<default class="([^"]+)"', self.spec.to_xml()) or ["none"]
            raise ConfigurationError("plant.motor_class", name, f"a class of {self.name}: {choices_text(name, known)}")
        for joint in self.motors:
            for key in ("armature", "damping", "frictionloss"):
                setattr(joint, key, getattr(default.joint, key))
        self.limits[:] = default.actuator.forcerange if np.any(default.actuator.forcerange) else (-np.inf, np.inf)

    def fit(self, robot: RobotParameters) -> Fit:
        """Match of its legs and frames to the robot's."""
        fit, most = self.mjcf_legs.fit_frames(robot, self.legs), self.mjcf_legs.ALLOWED
        if not fit.residual <= most:
            allowed = f"a model of `robot` within {1e3 * most:g} mm, not {1e3 * fit.residual:.4g} mm ({fit.worst})"
            raise ConfigurationError(_KEY, self.name, f"{allowed}; name the robot of this model, or calibrate it")
        return fit

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Turns an error of MuJoCo into one line."""
        try:
            yield
        except (ValueError, OSError) as error:
            message = " ".join(str(error).split())
            raise ConfigurationError(_KEY, self.name, f"an MJCF that MuJoCo reads ({message})") from None


class MujocoPlant:
    """An MJCF model as a `Plant`; motor torques are limited to the model's force ranges."""

    def __init__(self, robot: RobotParameters, options: MujocoOptions, gravity: Gravity) -> None:
        file = ModelFile(options, mjcf_text(robot, gravity, options) if options.model_file is None else "")
        self._still, self._moved = base_reading(gravity), cast("np.ndarray | None", None)
        self._mujoco, self._mjcf_legs, fit = file.mujoco, file.mjcf_legs, file.fit(robot)
        self._robot, self._home, (self._base, self._origin) = robot, home_frames(robot), fit.base
        site, body = self._add_platform(file, fit.platform, options)
        with file.reading():
            self._model = model = file.spec.compile()
        motors, self._site, self._body = np.array([file.motors[leg].id for leg in fit.order]), site.id, body.id
        self._closures, self._data = [closure.id for closure in file.closures], self._mujoco.MjData(model)
        self._at, self._rates = model.jnt_qposadr[motors], model.jnt_dofadr[motors]
        self._set_options(options, [joint.id for joint in file.passive], gravity)
        self._signs, (low, high) = fit.signs, np.sort(fit.signs * file.limits[fit.order].T, axis=0)
        # Crank angle where a joint of the model is at zero. Its whole turns are chosen so that home is nearest to the
        # middle of the joint's range.
        at_zero = fit.angles - fit.signs * model.qpos0[self._at]
        middle = np.where(model.jnt_limited[motors], model.jnt_range[motors].mean(axis=1), model.qpos0[self._at])
        turns = (self._home.crank_angles - at_zero - fit.signs * middle) / (2.0 * np.pi)
        self._at_zero = at_zero + 2.0 * np.pi * np.round(turns)
        frames = {"base": self._base, "origin": self._origin, "signs": fit.signs, "angles": self._at_zero}
        self._frames, self._measured = ModelFrames.new(**frames, low=low, high=high), np.zeros(24)
        # Views of MuJoCo's memory.
        data, self._motion = self._data, np.zeros(6)
        self._place = data.site_xpos[self._site]
        self._pushed = self._place, data.xipos[self._body], data.qfrc_applied, data.xfrc_applied[self._body]
        joints = self._at, data.qpos, self._rates, data.qvel
        self._moving = self._place, data.site_xmat[self._site], self._motion, *joints
        kinds = self._mujoco.mjtIntegrator
        moves = {int(kinds.mjINT_EULER): self._mujoco.mj_Euler, int(kinds.mjINT_RK4): self._runge_kutta}
        self._integrate: Callable[..., None] = moves.get(int(model.opt.integrator), self._mujoco.mj_implicit)

    def _add_platform(
        self, file: ModelFile, frame: tuple[np.ndarray, np.ndarray], options: MujocoOptions
    ) -> tuple[mujoco.MjsSite, mujoco.MjsBody]:
        """Adds site P to a model, and the payload to its body; returns both."""
        data, quaternion, (rotation, place) = self._mujoco.MjData(file.model), np.empty(4), frame
        self._mujoco.mj_kinematics(file.model, data)
        body, axes = file.spec.bodies[file.legs.platform], data.xmat[file.legs.platform].reshape(3, 3)
        place = axes.T @ (place - data.xpos[file.legs.platform])
        self._mujoco.mju_mat2Quat(quaternion, (axes.T @ rotation).ravel())
        # Also added for a payload without mass, so that the size of a saved state does not depend on the payload.
        load = body.add_body(pos=place + axes.T @ rotation @ np.array(options.payload_position), ipos=np.zeros(3))
        load.mass, load.explicitinertial = options.payload_mass, True
        return body.add_site(pos=place, quat=quaternion), body

    def _set_options(self, options: MujocoOptions, passive: list[int], gravity: Gravity) -> None:
        model, bits, friction = self._model, self._mujoco.mjtDisableBit, options.friction_options
        model.opt.timestep, model.opt.gravity[:] = options.time_step, self._base @ gravity_vector(gravity)
        model.opt.disableflags |= bits.mjDSBL_CONTACT | bits.mjDSBL_SENSOR
        of_passive = np.isin(model.dof_jntid, passive)
        # `dof_dampingpoly`, damping with higher powers of a rate, does not exist in every version of MuJoCo.
        damping = [name for name in ("dof_damping", "dof_dampingpoly") if hasattr(model, name)]
        for name in ("dof_frictionloss", *damping):
            getattr(model, name)[of_passive] *= options.passive_friction
        model.dof_armature[of_passive] *= options.passive_armature
        if options.friction is not None or options.motor_friction is not None:
            model.dof_frictionloss[self._rates] = friction.coulomb
        if options.friction is not None or options.motor_damping is not None:
            for name in damping:
                getattr(model, name)[self._rates] = 0.0
            model.dof_damping[self._rates] = friction.viscous
        self._mujoco.mj_setConst(model, self._data)

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """Begins at a pose (6,) and its rate (6,), loops closed; RunFailure if the model cannot reach the pose."""
        self._mujoco.mj_resetData(self._model, self._data)
        theta = self._home.crank_angles + self._home.motor_angles(inverse_kinematics(self._robot, pose))
        self._data.qpos[self._at] = self._signs * (theta - self._at_zero)
        jacobian = self._assemble(pose)
        turn, shift = pose_rate_to_twist(pose, pose_rate).reshape(2, 3) @ self._base.T
        wanted = np.concatenate([np.zeros(len(jacobian) - 6), shift, self._robot.characteristic_length * turn])
        self._data.qvel[:] = np.linalg.lstsq(jacobian, wanted, rcond=None)[0]
        return self._measure()

    def _assemble(self, pose: np.ndarray) -> np.ndarray:
        """Closes all loops at a pose (6,) by Newton's method on the joints' positions; returns the Jacobian of `_gaps`.

        Far from the solution the motors are fixed, so that no crank changes its branch.
        """
        for _ in range(_ITERATIONS):
            error, jacobian = self._gaps(pose)
            if (size := float(np.abs(error).max())) < _CLOSED:
                return jacobian
            free = jacobian.copy()
            if size > _NEAR * self._mjcf_legs.ALLOWED:
                free[:, self._rates] = 0.0
            step = np.linalg.lstsq(free, -error, rcond=1e-10)[0]
            self._mujoco.mj_integratePos(self._model, self._data.qpos, min(1.0, 0.5 / np.abs(step).max()) * step, 1.0)
        if not size < _NOT_CLOSED:
            text = f"the model of {_KEY} does not close its loops at pose {pose_text(pose)}: {size:.2g} m open"
            raise RunFailure(text, reason="unreachable_pose")
        return jacobian

    def _gaps(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gaps (n,) [m] of the loops, the last six being the error of the pose, and their Jacobian (n, nv)."""
        mujoco, model, data, length = self._mujoco, self._model, self._data, self._robot.characteristic_length
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        gaps, jacobians = [], []
        for equality in self._closures:
            ends, moved = self._mjcf_legs.connect_ends(model, data, equality), np.zeros((2, 3, model.nv))
            for (body, place), jacobian in zip(ends, moved, strict=True):
                mujoco.mj_jac(model, data, jacobian, None, place, body)
            gaps.append(ends[0][1] - ends[1][1])
            jacobians.append(moved[0] - moved[1])
        moved, axes = np.zeros((2, 3, model.nv)), data.site_xmat[self._site].reshape(3, 3)
        mujoco.mj_jacSite(model, data, *moved, self._site)
        # To first order, half the sum of the axes' cross products is the rotation vector.
        turn = 0.5 * np.cross((self._base @ rotation_matrix(pose[:3])).T, axes.T).sum(axis=0)
        gaps += [data.site_xpos[self._site] - self._origin - self._base @ pose[3:], length * turn]
        return np.concatenate(gaps), np.concatenate([*jacobians, moved[0], length * moved[1]])

    def step(self, torque: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """A step; NotFiniteError if the simulation has diverged."""
        mujoco, model, data = self._mujoco, self._model, self._data
        apply_forces(self._frames, torque, wrench, self._rates, *self._pushed)
        if self._moved is not None:
            self._move_base(self._moved)
        # The same as `mj_step`, except that it does not write a log file and reset the state if numbers are bad.
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)
        self._integrate(model, data)
        return self._measure()

    def set_base(self, base: np.ndarray) -> None:
        self._moved = base - self._still

    def _move_base(self, change: np.ndarray) -> None:
        """Adds the forces of a base that moves, which differ from those of gravity at rest by a change (9,)."""
        model, data, first = self._model, self._data, 1
        at, spin = data.xipos[first:], data.cvel[first:, :3]
        velocity = data.cvel[first:, 3:] + np.cross(spin, at - data.subtree_com[model.body_rootid[first:]])
        axes = data.ximat[first:].reshape(-1, 3, 3)
        inertia = axes * model.body_inertia[first:, None] @ axes.swapaxes(1, 2)
        in_world = (np.reshape(change, (3, 3)) @ self._base.T).ravel()
        moment, force = base_wrenches(in_world, model.body_mass[first:], at - self._origin, velocity, spin, inertia)
        body = data.xfrc_applied[self._body].copy()
        data.xfrc_applied[first:] = np.hstack([force, moment])
        data.xfrc_applied[self._body] += body

    def _runge_kutta(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._mujoco.mj_RungeKutta(model, data, 4)

    def _measure(self) -> np.ndarray:
        mujoco, model, data = self._mujoco, self._model, self._data
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, self._site, self._motion, 0)
        if not measure(self._frames, *self._moving, self._measured):
            raise NotFiniteError("MuJoCo's state", self._measured[:6])
        return self._measured

    def save(self) -> np.ndarray:
        kind = self._mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(self._mujoco.mj_stateSize(self._model, kind))
        self._mujoco.mj_getState(self._model, self._data, state, kind)
        return state

    def restore(self, state: np.ndarray) -> np.ndarray:
        kind = self._mujoco.mjtState.mjSTATE_INTEGRATION
        if getattr(state, "shape", None) != (size := self._mujoco.mj_stateSize(self._model, kind),):
            raise foreign_state(state, f"a model of MuJoCo with {size} numbers")
        self._mujoco.mj_setState(self._model, self._data, state, kind)
        return self._measure()
