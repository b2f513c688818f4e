#!/usr/bin/env python3
"""The same robot in awkward axes: every moving link's frame, and the axes of every inertia, are turned at random.

    venv/bin/python turn.py xarm7.urdf --seed 7 > ../urdf/xarm7_turned.urdf

Joint origins and <inertial> origins get a general rpy, joint axes three non-zero numbers. Shapes and all that
is no link or joint are left out. A joint turns and slides as before, and the root stays where it is.
"""

import argparse
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin


def vector(element, attribute, default):
    given = default if element is None else element.get(attribute, default)
    return np.array([float(x) for x in given.split()])


def text(values):
    return " ".join(f"{x + 0.0:.17g}" for x in values)


def placement(parent):
    origin = parent.find("origin")
    return pin.SE3(pin.rpy.rpyToMatrix(vector(origin, "rpy", "0 0 0")), vector(origin, "xyz", "0 0 0"))


def origin(placement):
    rpy = pin.rpy.matrixToRpy(placement.rotation)
    return ElementTree.Element("origin", xyz=text(placement.translation), rpy=text(rpy))


def turned_inertial(inertial, turn, axes):
    """The same inertia for a link turned by `turn`, about axes turned by `axes` in the link."""
    entries = {key: float(value) for key, value in inertial.find("inertia").attrib.items()}
    tensor = np.array([[entries["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
    old = placement(inertial)
    tensor = axes.T @ turn.T @ old.rotation @ tensor @ old.rotation.T @ turn @ axes
    new = ElementTree.Element("inertial")
    new.append(origin(pin.SE3(axes, turn.T @ old.translation)))
    new.append(inertial.find("mass"))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    ElementTree.SubElement(new, "inertia", {f"i{'xyz'[a]}{'xyz'[b]}": f"{tensor[a, b]:.17g}" for a, b in pairs})
    return new


def random_rotation(rng):
    quaternion = rng.normal(size=4)
    return pin.Quaternion(quaternion / np.linalg.norm(quaternion)).matrix()


def turned(robot, rng):
    joints = [joint for joint in robot.findall("joint") if joint.find("child") is not None]
    moved = {joint.find("child").get("link") for joint in joints if joint.get("type") != "fixed"}
    links = [link.get("name") for link in robot.findall("link")]
    turns = {link: random_rotation(rng) if link in moved else np.eye(3) for link in links}
    new = ElementTree.Element("robot", name=robot.get("name"))
    for link in robot.findall("link"):
        copy = ElementTree.SubElement(new, "link", name=link.get("name"))
        if link.find("inertial") is not None:
            copy.append(turned_inertial(link.find("inertial"), turns[link.get("name")], random_rotation(rng)))
    for joint in joints:
        parent, child = (pin.SE3(turns[joint.find(end).get("link")], np.zeros(3)) for end in ("parent", "child"))
        copy = ElementTree.SubElement(new, "joint", name=joint.get("name"), type=joint.get("type"))
        copy.append(origin(parent.inverse() * placement(joint) * child))
        copy.extend(joint.find(end) for end in ("parent", "child"))
        if joint.get("type") != "fixed":
            axis = vector(joint.find("axis"), "xyz", "1 0 0")
            ElementTree.SubElement(copy, "axis", xyz=text(child.rotation.T @ axis))
            copy.append(joint.find("limit"))
    return new


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("urdf")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    robot = turned(ElementTree.parse(args.urdf).getroot(), np.random.default_rng(args.seed))
    for element in robot.iter():
        element.text = element.tail = None
    ElementTree.indent(robot)
    print('<?xml version="1.0"?>')
    print(ElementTree.tostring(robot, encoding="unicode"))


if __name__ == "__main__":
    main()
