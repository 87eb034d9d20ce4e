"""A rotary Stewart platform in somebody's model file, as a robot: MJCF, or URDF and SDF by Drake's parser.

Frame B is the base's, with z across the shafts towards the platform. If the file has the robot assembled, home is as in
the file. Positions and axes are in the file's world if not said otherwise.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stewart_drake.base.atomic_files import Document, read_checked
from stewart_drake.base.errors import ConfigurationError, installed_with
from stewart_drake.plant.mujoco_plant import ModelFile, MujocoOptions
from stewart_drake.robot.geometry import wrapped
from stewart_drake.robot.leg import LEG_COUNT, crank_equation
from stewart_drake.robot.leg_table import FromTable, from_table

if TYPE_CHECKING:
    import mujoco

    from stewart_drake.plant.mjcf_legs import Legs

_MAX_BYTES = 10_000_000
_GAP = 1e-3  # [-] Largest gap of the loops, over the radius of the shafts, of a robot that is assembled in the file.
_NEAR = 0.25  # [-] Largest distance of a body's origin from the middle of its points, over that radius, to be kept.
_TILT = math.cos(
    math.radians(10.0)
)  # Of the largest angle from the shafts' normal to an axis of the base taken for it.
_OFF_CENTRE = 0.05  # [-] Distance of a link's centre of mass from its middle, over its length, that is mentioned.
_NO_MASS = 1e-9  # [kg] Masses of bodies without one; MuJoCo needs some.
_DIFFERENT = 0.01  # [-] Relative differences of the legs' masses that are mentioned.
_NOT_READ = {
    "visual": "pictures", "collision": "collision shapes", "geom": "shapes", "damping": "dampings",
    "friction": "frictions", "frictionloss": "frictions", "stiffness": "springs", "spring_stiffness": "springs",
    "plugin": "plugins", "sensor": "sensors", "transmission": "transmissions", "tendon": "tendons",
    "keyframe": "keyframes",
}  # fmt: skip
"""Tags and attributes of model files -> what they are called in messages."""
FORMATS = {"robot": "URDF", "sdf": "SDF", "mujoco": "MJCF"}
"""Root elements of model files."""


class Imported(NamedTuple):
    """A robot from a model file."""

    read: FromTable
    given: Document  # Parameters that the file has.
    motors: list[tuple[str, str, str]]  # Leg, joint, and theta [deg] at the joint's zero.
    notes: list[str]  # What was assumed or not read.


def read_model(path: Path, motors: Sequence[str], parameters: Document) -> Imported:
    """A robot from a URDF, SDF or MJCF file.

    Args:
        path: The file.
        motors: Names of the motors' joints in the order of the legs; empty to find them.
        parameters: Of `RobotParameters`, in place of the file's.

    Raises:
        ConfigurationError: A file that its program does not read, or without six legs.
    """
    key = f"model {path}"
    text = read_checked(path, key, _MAX_BYTES).decode("utf-8", "replace")
    try:
        # Prefixes such as drake: are often not declared.
        tree = ET.fromstring(re.sub(r"(</?|\s)(\w+):(?=[\w.]+[\s=/>])", r"\1\2__", text))
    except ET.ParseError as error:
        raise ConfigurationError(key, str(error), f"a file of {', '.join(FORMATS.values())}") from None
    if tree.tag not in FORMATS or "xacro" in text[:2000]:
        hint = "; run xacro first" if "xacro" in text[:2000] else ""
        raise ConfigurationError(key, f"<{tree.tag}>", f"a file of {', '.join(FORMATS.values())}{hint}")
    if len(motors) not in (0, LEG_COUNT):
        raise ConfigurationError("--motor", list(motors), "six joints, or none to find them")
    with installed_with("stewart-drake[mujoco]"):
        import mujoco
    spec = None
    if tree.tag != "mujoco":
        from stewart_drake.plant.drake_reader import read_drake

        spec = read_drake(path, tree, key)
    try:
        options = MujocoOptions.from_dict({"model_file": str(path), "motor_joints": list(motors) or None})
        file = ModelFile(options, spec=spec, lenient=True)
    except ConfigurationError as error:
        raise ConfigurationError(
            key, error.value, error.allowed.replace("one of plant.motor_joints", "on the base, or one of --motor")
        ) from None
    data = mujoco.MjData(file.model)
    mujoco.mj_kinematics(file.model, data)
    try:
        return _robot(file, data, motors, parameters, tree)
    except ConfigurationError as error:
        if not error.key.startswith("table: "):
            raise
        allowed = error.allowed.replace("is the unit mm?", "is the file in mm? it has to be in m")
        raise ConfigurationError(error.key.replace("table", key, 1), error.value, allowed) from None


def _robot(
    file: ModelFile, data: mujoco.MjData, motors: Sequence[str], parameters: Document, tree: ET.Element
) -> Imported:
    """The robot of a model: B, P and theta are chosen, all else is the file's."""
    model, notes = file.model, list[str]()
    names = [joint.name for joint in file.motors]
    order = [names.index(name) for name in motors] or np.argsort(file.legs.motors).tolist()
    legs = file.legs.ordered(order)
    centre, middle = legs.centres.mean(axis=0), legs.seats.mean(axis=0)
    radius = float(np.linalg.norm(legs.centres - centre, axis=-1).mean())
    gap = float(np.abs(np.linalg.norm(legs.seats - legs.tips, axis=-1) - legs.rod_lengths).max())
    assembled = gap <= _GAP * radius
    below = _common_body(model.body_parentid, [int(model.body_parentid[crank]) for crank in legs.cranks])
    of_base, of_platform = ((data.xmat[body].reshape(3, 3), data.xpos[body]) for body in (below, legs.platform))
    normal = np.linalg.svd(legs.centres - centre)[2][-1]
    side = float(normal @ (middle - centre)) if assembled else float(normal @ of_base[0][:, 2])
    base, origin = _base_frame(of_base, math.copysign(1.0, side) * normal, centre, radius)
    at_platform, in_base = (base.T @ (place - origin) for place in (of_platform[1], middle))
    near = abs(at_platform[2] - in_base[2]) <= radius and np.hypot(*(at_platform - in_base)[:2]) <= _NEAR * radius
    plate, at_plate = base, origin + base @ [0.0, 0.0, at_platform[2] if near else in_base[2]]
    if not assembled:
        # At home the frames of both bodies are taken to be parallel.
        plate, at_plate = of_platform[0] @ of_base[0].T @ base, of_platform[1] if near else middle
        notes.append(f"the loops are open by up to {1e3 * gap:.4g} mm in the file: home is where cranks are level")
    crank, axis = (legs.tips - legs.centres) @ base, legs.axes @ base
    lengths = np.linalg.norm(crank, axis=-1)
    zero = _zero_directions(crank / lengths[:, None], axis)
    quarter = np.cross(axis, zero)
    theta = np.arctan2(np.sum(crank * quarter, axis=-1), np.sum(crank * zero, axis=-1))
    shafts, joints = (legs.centres - origin) @ base, (legs.seats - at_plate) @ plate
    columns = {"crank_length": lengths, "rod_length": legs.rod_lengths}
    for name, vectors in {"shaft": shafts, "joint": joints, "crank": zero, "up": quarter}.items():
        columns |= {f"{name}_{letter}": vectors[:, i] for i, letter in enumerate("xyz")}
    given = _masses(file, data, legs, (plate, at_plate), notes)
    if assembled:
        given["home_height"] = float(base[:, 2] @ (at_plate - origin))
        span = joints + [0.0, 0.0, given["home_height"]] - shafts
        along, up, _ = crank_equation(span, zero, quarter, lengths, legs.rod_lengths)
        columns["branch"] = np.where(wrapped(theta - np.arctan2(up, along)) > 0.0, 1.0, -1.0)
    at_zero = theta - model.qpos0[model.jnt_qposadr[(numbers := [file.motors[leg].id for leg in order])]]
    stops = model.jnt_range[numbers] + at_zero[:, None]
    if model.jnt_limited[numbers].all() and (np.ptp(stops, axis=-1) <= 2.0 * math.pi).all():
        columns |= {"low": stops[:, 0], "high": stops[:, 1]}
    efforts = np.min(np.abs(file.limits[order]), axis=-1)
    known = np.isfinite(efforts).all() and "effort_limit" not in parameters
    given |= {"effort_limit": float(efforts.min())} if known else {}
    read = from_table(columns, "m", "outwards", given | parameters)
    if known and np.ptp(efforts) > 0.0:
        for leg, effort in zip(read.parameters["legs"], efforts, strict=True):
            leg["effort_limit"] = float(effort)
    degrees = np.round(np.degrees(wrapped(at_zero)), 2) + 0.0
    rows = [(str(i), names[leg], f"{degrees[i]:.2f}") for i, leg in enumerate(order)]
    return Imported(read, given | parameters, rows, [*notes, *_remarks(base, tree)])


def _common_body(parents: np.ndarray, bodies: Sequence[int]) -> int:
    """The nearest body that is each of `bodies` or above it."""

    def above(body: int) -> list[int]:
        return [body] if body == 0 else [body, *above(int(parents[body]))]

    chains = [above(body) for body in bodies]
    return next(body for body in chains[0] if all(body in chain for chain in chains))


def _base_frame(
    frame: tuple[np.ndarray, np.ndarray], normal: np.ndarray, centre: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and origin of B in the world: the base's frame where that is upright and in the middle."""
    rotation, origin = frame
    axes = np.hstack([rotation, -rotation]).T
    best = axes[int((axes @ normal).argmax())]
    z = best if best @ normal >= _TILT else normal
    x = next(axis - (axis @ z) * z for axis in rotation.T if abs(axis @ z) < 0.9)
    x = x / np.linalg.norm(x)
    result = np.stack([x, np.cross(z, x), z], axis=-1)
    off = result.T @ (centre - origin)
    if math.hypot(*off[:2]) > _NEAR * radius:
        origin = origin + result @ [off[0], off[1], 0.0]
    # So that the platform is above the origin.
    return result, origin if abs(off[2]) <= 3.0 * radius else origin + result @ [0.0, 0.0, off[2]]


def _zero_directions(crank: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Horizontal directions (6, 3) of the cranks, on their side in the file; of a crank about z, as in the file."""
    level = np.cross([0.0, 0.0, 1.0], axis)
    size = np.linalg.norm(level, axis=-1, keepdims=True)
    level = level / np.maximum(size, 1e-9) * np.where(np.sum(level * crank, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.where(size > 1e-3, level, crank)


def _masses(
    file: ModelFile, data: mujoco.MjData, legs: Legs, frame: tuple[np.ndarray, np.ndarray], notes: list[str]
) -> Document:
    """Masses and inertias, where the file has them; those of cranks and rods are means of the six."""
    root, model, given = file.mjcf_legs.rigid_roots(file.model), file.model, Document()
    axes = data.ximat.reshape(-1, 3, 3)
    of_bodies = axes * model.body_inertia[:, None] @ np.swapaxes(axes, -1, -2)

    def summed(tops: Sequence[int]) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass, centre and inertia about it of bodies that are fixed together, in the world."""
        which = np.isin(root, tops)
        masses, centres = model.body_mass[which], data.xipos[which]
        centre = masses @ centres / masses.sum()
        arms = centres - centre
        steiner = np.sum(arms * arms, axis=-1)[:, None, None] * np.eye(3) - arms[:, :, None] * arms[:, None, :]
        return float(masses.sum()), centre, np.sum(of_bodies[which] + masses[:, None, None] * steiner, axis=0)

    mass, centre, inertia = summed([legs.platform])
    if mass > _NO_MASS:
        moments = frame[0].T @ inertia @ frame[0]
        given |= {"platform_mass": mass, "platform_inertia": _physical(np.diag(moments))}
        given["platform_products"] = tuple(moments[np.triu_indices(3, 1)].tolist())
        given["platform_center_of_mass"] = tuple((frame[0].T @ (centre - frame[1])).tolist())
    rotors = model.dof_armature[model.jnt_dofadr[[joint.id for joint in file.motors]]]
    has_rotors = bool(rotors.any())
    for name, tops, start, end in (
        ("crank", [[crank] for crank in legs.cranks], legs.centres, legs.tips),
        ("rod", legs.rods, legs.tips, legs.seats),
    ):
        masses, centres, inertias = map(np.array, zip(*map(summed, tops), strict=True))
        if not masses.min() > _NO_MASS:
            continue
        if np.ptp(masses) > _DIFFERENT * masses.mean():
            notes.append(f"{name}s have {masses.min():.4g} to {masses.max():.4g} kg: the mean is taken")
        length = np.linalg.norm(end - start, axis=-1)
        x = (end - start) / length[:, None]
        y = legs.axes if name == "crank" else np.linalg.svd(x[:, None])[2][:, 1]
        moments = np.mean([np.einsum("nk,nkl,nl->n", v, inertias, v) for v in (x, y, np.cross(x, y))], axis=1)
        share = np.sum((centres - start) * x, axis=-1) / length
        if np.abs(share - 0.5).max() > _OFF_CENTRE:
            notes.append(f"the centre of mass of a {name} is taken at half its length, not at {share.mean():.2f} of it")
        given[f"{name}_mass"] = float(masses.mean())
        if name == "crank":
            given["crank_inertia"] = _physical(moments)
            # About the motor's axis the inertia is that of the file.
            arm = np.linalg.norm(np.cross(centres - start, legs.axes), axis=-1)
            rotors = rotors + masses * (arm**2 - 0.25 * length**2)
        else:
            across = 0.5 * (moments[1] + moments[2])
            given["rod_inertia"] = _physical(np.array([across, across, moments[0]]))
    if has_rotors:
        given["rotor_inertia"] = float(rotors.mean())
    else:
        notes.append("no rotor inertia in the file: that of a geared servo is its largest; --set rotor_inertia=...")
    return given


def _physical(moments: np.ndarray) -> tuple[float, ...]:
    """Moments of inertia, none above the sum of the others by rounding."""
    largest = int(moments.argmax())
    result = moments.copy()
    result[largest] = min(moments[largest], moments.sum() - moments[largest])
    return tuple(result.tolist())


def _remarks(base: np.ndarray, tree: ET.Element) -> list[str]:
    """How the base is turned in the file, and what is not read."""
    counts: Counter[str] = Counter()
    for element in tree.iter():
        names = (element.tag, *element.attrib)
        counts.update(_NOT_READ[name] for name in names if name in _NOT_READ)
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, base[2, 2]))))
    turned = f"z of B is {tilt:.4g} deg from the vertical of the file; gravity of a scenario is along -z of B"
    not_read = ", ".join(f"{count} {name}" for name, count in counts.items())
    return [turned] * (tilt > 0.1) + [f"not read: {not_read}"] * bool(counts)
