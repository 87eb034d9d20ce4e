"""Elements of an SDF file: joints, inertias, shapes, and numbers as text."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np

_Geometry = tuple[str, dict[str, str]]
"""Tag of an SDF shape and its sizes as text."""

_COLOURS = {
    "plate": (0.55, 0.58, 0.62, 1.0),
    "motor": (0.25, 0.27, 0.30, 1.0),
    "crank": (0.90, 0.48, 0.15, 1.0),
    "rod": (0.80, 0.82, 0.85, 1.0),
    "joint": (0.38, 0.40, 0.44, 1.0),
    "disc": (0.25, 0.55, 0.80, 1.0),
    "tool": (0.92, 0.93, 0.95, 1.0),
}


def add_joint(model: ET.Element, name: str, kind: str, parent: str, child: str) -> ET.Element:
    """A joint between two links."""
    joint = add_element(model, "joint", name=name, type=kind)
    add_element(joint, "parent", parent)
    add_element(joint, "child", child)
    return joint


def add_axis(
    joint: ET.Element, tag: str, direction: Iterable[float], effort: float, stops: Iterable[float] = (-np.inf, np.inf)
) -> None:
    """An axis of a joint with its effort limit and, where they are finite, its stops [rad]."""
    axis = add_element(joint, tag)
    add_element(axis, "xyz", exact_text(direction))
    limit = add_element(axis, "limit")
    for name, stop in zip(("lower", "upper"), stops, strict=True):
        if np.isfinite(stop):
            add_element(limit, name, exact_text((stop,)))
    add_element(limit, "effort", exact_text((effort,)))


def add_inertial(
    link: ET.Element,
    mass: float,
    moments: Iterable[float],
    centre: Iterable[float],
    products: Iterable[float] = (0.0, 0.0, 0.0),
) -> None:
    """Mass [kg], centre of mass [m], moments and products of inertia [kg m^2] about it."""
    inertial = add_element(link, "inertial")
    add_element(inertial, "pose", exact_text((*centre, 0.0, 0.0, 0.0)))
    add_element(inertial, "mass", exact_text((mass,)))
    inertia = add_element(inertial, "inertia")
    for tag, moment in zip(("ixx", "iyy", "izz"), moments, strict=True):
        add_element(inertia, tag, exact_text((moment,)))
    for tag, product in zip(("ixy", "ixz", "iyz"), products, strict=True):
        add_element(inertia, tag, exact_text((product,)))


def add_shape(
    link: ET.Element,
    name: str,
    geometry: _Geometry,
    position: Iterable[float],
    rpy: Iterable[float] = (0.0, 0.0, 0.0),
    *,
    colour: str,
) -> None:
    """A picture of a link, in one of `_COLOURS`."""
    visual = _geometry(link, "visual", name, geometry, position, rpy)
    add_element(add_element(visual, "material"), "diffuse", exact_text(_COLOURS[colour]))


def add_collision(
    link: ET.Element,
    name: str,
    geometry: _Geometry,
    position: Iterable[float],
    rpy: Iterable[float] = (0.0, 0.0, 0.0),
) -> None:
    """A collision shape: boxes and spheres alone.

    Drake's penetration depth is exact for those. For capsules and cylinders as slender as links, and for thin discs, it
    is found by iteration, which in one deep overlap of five ends far off, by up to the length of the link.
    """
    _geometry(link, "collision", f"{name}_collision", geometry, position, rpy)


def add_disc_collision(link: ET.Element, name: str, radius: float, thickness: float, z: float) -> None:
    """A regular prism of twelve sides in the circle, as six boxes across it."""
    half = math.pi / 12.0
    bar = box(2.0 * radius * math.cos(half), 2.0 * radius * math.sin(half), thickness)
    for side in range(6):
        add_collision(link, f"{name}_{side}", bar, (0.0, 0.0, z), (0.0, 0.0, 2.0 * half * side))


def free_length(span: float, radius: float) -> float:
    """Length of a link that may collide: all but two radii at either joint of the two that are `span` apart."""
    return max(span - 4.0 * radius, radius)


def _geometry(
    link: ET.Element,
    tag: str,
    name: str,
    geometry: _Geometry,
    position: Iterable[float],
    rpy: Iterable[float],
) -> ET.Element:
    element = add_element(link, tag, name=name)
    add_element(element, "pose", _rounded((*position, *rpy)))
    kind, sizes = geometry
    shape = add_element(add_element(element, "geometry"), kind)
    for size, text in sizes.items():
        add_element(shape, size, text)
    return element


def cylinder(radius: float, length: float) -> _Geometry:
    """About z; lengths in m."""
    return "cylinder", {"radius": _rounded((radius,)), "length": _rounded((length,))}


def box(*size: float) -> _Geometry:
    """Sides in m."""
    return "box", {"size": _rounded(size)}


def sphere(radius: float) -> _Geometry:
    """Radius in m."""
    return "sphere", {"radius": _rounded((radius,))}


def ellipsoid(*radii: float) -> _Geometry:
    """Half axes in m."""
    return "ellipsoid", {"radii": _rounded(radii)}


def add_element(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    """A child of an element."""
    element = ET.SubElement(parent, tag, attributes)
    element.text = text
    return element


def note(parent: ET.Element, text: str) -> None:
    """A comment."""
    parent.append(ET.Comment(f" {text} "))


def exact_text(values: Iterable[float]) -> str:
    """Shortest text that reads back as the same doubles; what is zero up to rounding is written as zero."""
    return " ".join(repr(0.0 if abs(value) < 1e-15 else float(value)) for value in values)


def _rounded(values: Iterable[float]) -> str:
    """Text of shapes, which need no more than seven digits."""
    return exact_text(float(f"{value:.7g}") for value in values)


def rendered(element: ET.Element, indent: str = "") -> str:
    """XML with one element a line, and what fits on a line kept on it."""
    flat = indent + ET.tostring(element, encoding="unicode")
    if len(flat) <= 120 and all(isinstance(child.tag, str) for child in element.iter()):
        return flat
    if len(element) == 0:
        return flat
    opening = "".join(f' {name}="{value}"' for name, value in element.attrib.items())
    children = [rendered(child, indent + "  ") for child in element]
    return "\n".join([f"{indent}<{element.tag}{opening}>", *children, f"{indent}</{element.tag}>"])
