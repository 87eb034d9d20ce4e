"""A URDF or SDF as a model for MuJoCo, read by Drake's parser, with all joints at zero.

A loop is closed by a joint, by `drake:ball_constraint`, or where a frame at the free end of a rod meets a frame of the
platform. Drake's plant is never finalised, so loops of joints are no error.
"""

from __future__ import annotations

import logging
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, FrameIndex, Joint
from scipy.optimize import linear_sum_assignment

from stewart_drake.base.errors import ConfigurationError, DrakeCheckError, drake_guard

PREFIX = "__"
"""In place of the colon in names of elements, such as drake:joint."""
_BALLS = ("universal", "ball_rpy")  # Types of joints that are balls here: only their points matter.
_ROUNDING = 1e-10
_MEETS = 1e-3  # [-] Largest distance of frames that meet, over the mean distance from motors to the platform's frames.
_SAME = 1e-9  # [m] Distance of frames that are one.
_Ends = list[tuple[int, np.ndarray]]  # Two bodies, and points on them in the world [m].


def read_drake(path: Path, tree: ET.Element, key: str) -> mujoco.MjSpec:
    """The model of a URDF or SDF file.

    Raises:
        ConfigurationError: Drake's parser does not read it.
    """
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.CRITICAL)  # Of friction, which is not read, there is a warning a joint.
    try:
        with drake_guard("Drake"):
            return _Model(path, tree).spec()
    except DrakeCheckError as error:
        raise ConfigurationError(key, f"<{tree.tag}>", f"a file that Drake's parser reads; {error}") from None
    finally:
        logger.setLevel(level)


class _Model:
    """Bodies, joints and closures of a parsed file."""

    def __init__(self, path: Path, tree: ET.Element) -> None:
        self.plant, self.tree = MultibodyPlant(0.0), tree
        self.floating = _adapted(tree)
        parser = Parser(self.plant)
        if tree.tag == "robot":
            parser.AddModelsFromString(ET.tostring(tree, encoding="unicode").replace(PREFIX, ":"), "urdf")
        else:
            parser.AddModels(str(path))
        # A link without a mass has one of 1 kg in SDF.
        masses = {link.get("name"): _numbers(_value(link.find("inertial/mass"))) for link in tree.iter("link")}
        self.massless = {name for name, mass in masses.items() if not (mass and mass[0] > 0.0)}
        self.joints: list[Joint] = [self.plant.get_joint(joint) for joint in self.plant.GetJointIndices()]
        self.inner: dict[int, Joint] = {}  # Body -> the joint that carries it in the tree.
        self.poses = {0: RigidTransform()}
        self._place_bodies()
        hinges = [self._top(_bodies(joint)[0]) for joint in self.joints if joint.type_name() == "revolute"]
        self.base = max(hinges, key=hinges.count, default=0)

    def _place_bodies(self) -> None:
        """Poses of all bodies; a free body has that of the file."""
        carried = {_bodies(joint)[1] for joint in self.joints}
        for body in set(range(1, self.plant.num_bodies())) - carried:
            self.poses[body] = self.plant.GetDefaultFloatingBaseBodyPose(self.plant.get_body(BodyIndex(body)))
        for joint in self.joints * len(self.joints):
            parent, child = _bodies(joint)
            if parent in self.poses and child not in self.poses:
                turn = joint.X_FM() if joint.type_name() == "weld" else RigidTransform()
                in_parent = joint.frame_on_parent().GetFixedPoseInBodyFrame()
                in_child = joint.frame_on_child().GetFixedPoseInBodyFrame()
                self.poses[child] = self.poses[parent] @ in_parent @ turn @ in_child.inverse()
                self.inner[child] = joint

    def _at(self, frame: Frame) -> tuple[int, np.ndarray]:
        """Body and place of a frame."""
        body = int(frame.body().index())
        return body, (self.poses[body] @ frame.GetFixedPoseInBodyFrame()).translation()

    def _top(self, body: int) -> int:
        """The topmost body that a body is fixed to."""
        while body in self.inner and self.inner[body].type_name() == "weld":
            body = _bodies(self.inner[body])[0]
        return body

    def spec(self) -> mujoco.MjSpec:
        """The model: bodies with masses, joints, and a connection at each closure."""
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-12  # Massless bodies.
        made = {0: spec.worldbody}
        for body in self.poses:  # A body is after the one that carries it.
            if body > 0:
                made[body] = self._add_body(made, body)
        ends = list(self._closures())
        for number, pair in enumerate([*ends, *self._cut(ends)]):
            for side, (body, place) in enumerate(pair):
                made[body].add_site(name=f"{number} {side}", pos=self.poses[body].inverse() @ place)
            equality = spec.add_equality(name1=f"{number} 0", name2=f"{number} 1")
            equality.type, equality.objtype = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_SITE
        return spec

    def _add_body(self, made: dict[int, mujoco.MjsBody], body: int) -> mujoco.MjsBody:
        joint, link = self.inner.get(body), self.plant.get_body(BodyIndex(body))
        inertia = link.default_spatial_inertia()
        is_free = body != self.base if joint is None else joint.name() in self.floating
        parent = 0 if joint is None or is_free else _bodies(joint)[0]
        pose = self.poses[parent].inverse() @ self.poses[body]
        added = made[parent].add_body(pos=pose.translation(), quat=pose.rotation().ToQuaternion().wxyz())
        if inertia.get_mass() > 0.0 and link.name() not in self.massless:
            about = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
            moments, axes = np.linalg.eigh(about)
            # MuJoCo takes no largest moment above the sum of the others, by rounding.
            excess = max(moments[2] - (1.0 - _ROUNDING) * (moments[0] + moments[1]), 0.0)
            about = about - excess * np.outer(axes[:, 2], axes[:, 2])
            added.mass, added.ipos, added.explicitinertial = inertia.get_mass(), inertia.get_com(), True
            added.fullinertia = [*np.diag(about), *about[np.triu_indices(3, 1)]]
        if is_free:
            added.add_freejoint()
        elif joint is not None and joint.type_name() != "weld":
            self._add_joint(added, joint)
        return added

    def _add_joint(self, added: mujoco.MjsBody, joint: Joint) -> None:
        frame = joint.frame_on_child().GetFixedPoseInBodyFrame()
        new = added.add_joint(name=joint.name(), pos=frame.translation())
        if joint.type_name() in _BALLS:
            new.type = mujoco.mjtJoint.mjJNT_BALL
        elif joint.type_name() != "revolute":
            new.type = mujoco.mjtJoint.mjJNT_SLIDE  # It does not move.
        else:
            new.axis = frame.rotation() @ joint.revolute_axis()
            new.range = [*joint.position_lower_limits(), *joint.position_upper_limits()]
            new.limited = bool(np.isfinite(new.range).all())
            given = self.tree.find(f"joint[@name='{joint.name()}']/limit[@effort]")  # Of a URDF.
            effort = 0.0 if given is None else float(given.get("effort", 0.0))
            for index in self.plant.GetJointActuatorIndices():
                actuator = self.plant.get_joint_actuator(index)
                if actuator.joint().index() == joint.index():
                    new.armature = actuator.default_reflected_inertia()
                    effort = actuator.effort_limit()
            if 0.0 < effort < math.inf:
                new.actfrcrange, new.actfrclimited = [-effort, effort], True

    def _closures(self) -> Iterator[_Ends]:
        """Loops closed by joints and by ball constraints, which the plant does not give back."""
        for joint in self.joints:
            if self.inner.get(_bodies(joint)[1]) is not joint:
                yield [self._at(joint.frame_on_parent()), self._at(joint.frame_on_child())]
        for element in self.tree.iter(f"drake{PREFIX}ball_constraint"):
            ends: _Ends = []
            for names in (("body_A", "p_AP"), ("body_B", "p_BQ")):
                name, text = (_value(element.find(f"drake{PREFIX}ball_constraint_{part}")) for part in names)
                body = int(self.plant.GetBodyByName(name.split("::")[-1]).index())
                place = np.array(_numbers(text or "0 0 0"))
                if place.shape != (3,):
                    raise RuntimeError(f"drake:ball_constraint_{names[1]} of {name}: three numbers, not {text}")
                ends.append((body, self.poses[body] @ place))
            yield ends

    def _cut(self, closures: list[_Ends]) -> list[_Ends]:
        """Loops that the file cuts: frames at the free ends of rods, joined to the nearest frames of the platform."""
        joined: dict[int, list[np.ndarray]] = {}
        inner = ([self._at(j.frame_on_parent()), self._at(j.frame_on_child())] for j in self.inner.values())
        for joint, ends in zip(self.inner.values(), inner, strict=True):
            for body, place in ends if joint.type_name() in ("revolute", *_BALLS) else ():
                joined.setdefault(self._top(body), []).append(place)
        for body, place in (end for ends in closures for end in ends):
            joined.setdefault(self._top(body), []).append(place)
        frames: dict[int, list[tuple[int, np.ndarray]]] = {}
        for index in range(self.plant.num_frames()):
            frame = self.plant.get_frame(FrameIndex(index))
            body, place = self._at(frame)
            top = self._top(body)
            taken = [*joined.get(top, ()), *(other for _, other in frames.get(top, ()))]
            is_origin = body == top and frame.name() == frame.body().name()
            if is_origin or top in (0, self.base):
                continue
            if all(np.linalg.norm(place - other) > _SAME for other in taken):
                frames.setdefault(top, []).append((body, place))
        platform = max(frames, key=lambda top: len(frames[top]), default=0)
        rods = [top for top in frames if top != platform and len(joined.get(top, ())) == 1]
        if not rods:
            return []
        seats = np.array([place for _, place in frames[platform]])
        apart = [np.array([np.linalg.norm(seats - place, axis=-1) for _, place in frames[rod]]) for rod in rods]
        # Where frames do not meet because the loops are open, the seat that is nearest to the leg's motor is taken.
        away = np.linalg.norm(np.array([self._motor(rod) for rod in rods])[:, None] - seats, axis=-1)
        meet = np.array([distance.min(axis=0) for distance in apart]) < _MEETS * away.mean()
        pairs = zip(*linear_sum_assignment(np.where(meet, 0.0, away)), strict=True)
        return [[frames[rods[row]][int(apart[row][:, seat].argmin())], frames[platform][seat]] for row, seat in pairs]

    def _motor(self, body: int) -> np.ndarray:
        """Place of the joint on the base by which a body hangs on it."""
        place = self.poses[body].translation()
        while body in self.inner and self._top(body) not in (0, self.base):
            _, place = self._at(self.inner[body].frame_on_parent())
            body, _ = _bodies(self.inner[body])
        return place


def _bodies(joint: Joint) -> tuple[int, int]:
    return int(joint.parent_body().index()), int(joint.child_body().index())


def _adapted(tree: ET.Element) -> list[str]:
    """Changes joints of a URDF that Drake does not know; returns those that float, which it would move."""
    floating = []
    for joint in tree.findall("joint") if tree.tag == "robot" else ():
        if joint.get("type") == "floating":
            joint.set("type", "prismatic")
            floating.append(joint.get("name", ""))
        elif joint.get("type") == "spherical":
            joint.tag = f"drake{PREFIX}joint"
            joint.set("type", "ball")
    return floating


def _value(element: ET.Element | None) -> str:
    """Text of an element of SDF, or the attribute in URDF."""
    return "" if element is None else (element.get("name") or element.get("value") or element.text or "").strip()


def _numbers(text: str) -> list[float]:
    """Finite numbers of a text; empty if one is none."""
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return []
    return numbers if np.isfinite(numbers).all() else []
