#!/usr/bin/env python3
"""Rigid-body quantities of a URDF by MuJoCo, with rotors and a tilted gravity, for opspace to be tested against.

    python3 -m venv venv && venv/bin/pip install mujoco==3.17.0 numpy==2.4.6
    venv/bin/python generate.py ../pinocchio/urdf/ur5.urdf --tip tool0 --samples 5 --seed 1 > ur5.json
    venv/bin/python generate.py ../pinocchio/urdf/ur5.urdf --check ur5.json

The second computes the outputs of an existing file again at its inputs, and fails if any has changed by more
than TOLERANCE.
"""

import argparse
import hashlib
import json
import pathlib
import sys
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

MUJOCO = "3.17.0"
# Relative to max(1, largest entry): another processor may round sums otherwise.
TOLERANCE = 1e-10


class Robot:
    """A MuJoCo model of a URDF without shapes, limits, damping or friction."""

    def __init__(self, urdf, gravity=None, rotor=None):
        root = ElementTree.parse(urdf).getroot()
        for link in root.iter("link"):
            for shape in link.findall("visual") + link.findall("collision"):
                link.remove(shape)
        for joint in root.iter("joint"):
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
        settings = {"fusestatic": "false", "balanceinertia": "false", "strippath": "true"}
        ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", settings)
        self.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
        self.data = mujoco.MjData(self.model)
        self.model.dof_damping[:] = 0
        self.model.dof_frictionloss[:] = 0
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.joints = [self.model.joint(i).name for i in range(self.model.njnt)]
        if gravity is not None:
            self.model.opt.gravity[:] = gravity
            self.model.dof_armature[:] = rotor

    def evaluate(self, sample, tip):
        """All outputs at a sample's inputs."""
        model, data = self.model, self.data
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = sample["q"], sample["dq"], sample["tau_in"]
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        body = model.body(tip).id
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], data.xpos[body], body)
        outputs = {
            "tip_R": data.xmat[body],
            "tip_p": data.xpos[body],
            "J": jacobian,
            "M": mass,
            "nle": data.qfrc_bias,
            "ddq_aba": data.qacc,
        }
        return {key: np.asarray(value).ravel().tolist() for key, value in outputs.items()}


def generate(urdf, tip, count, seed):
    rng = np.random.default_rng(seed)
    n = Robot(urdf).model.nv
    gravity, rotor = rng.uniform(-10, 10, 3), rng.uniform(0.05, 0.5, n)
    robot = Robot(urdf, gravity, rotor)
    samples = []
    for _ in range(count):
        sample = {
            "q": rng.uniform(-2, 2, n).tolist(),
            "dq": rng.uniform(-2, 2, n).tolist(),
            "tau_in": rng.uniform(-20, 20, n).tolist(),
        }
        samples.append(sample | robot.evaluate(sample, tip))
    meta = {
        "robot": urdf.stem,
        "urdf": urdf.name,
        "urdf_sha256": hashlib.sha256(urdf.read_bytes()).hexdigest(),
        "generator": f"generate.py, MuJoCo {MUJOCO}, seed {seed}",
        "joints": robot.joints,
        "tip_frame": tip,
        "gravity": gravity.tolist(),
        "rotor_inertia": rotor.tolist(),
    }
    print('{"meta":' + json.dumps(meta) + ',\n"samples":[')
    print(",\n".join(json.dumps(sample, separators=(",", ":")) for sample in samples))
    print("]}")


def check(urdf, reference):
    meta = reference["meta"]
    if meta["urdf_sha256"] != hashlib.sha256(urdf.read_bytes()).hexdigest():
        sys.exit(f"{urdf} is not the file that the numbers are of")
    robot = Robot(urdf, meta["gravity"], meta["rotor_inertia"])
    worst = {}
    for sample in reference["samples"]:
        for key, value in robot.evaluate(sample, meta["tip_frame"]).items():
            change = np.max(np.abs(np.subtract(value, sample[key]))) / max(1.0, np.max(np.abs(sample[key])))
            worst[key] = max(worst.get(key, 0.0), change)
    for key, change in worst.items():
        print(f"{key:8} {change:.1e}")
    return max(worst.values()) <= TOLERANCE


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("urdf", type=pathlib.Path)
    parser.add_argument("--check", type=pathlib.Path, metavar="FILE", help="compare with this file instead")
    parser.add_argument("--tip", help="the link whose motion is wanted")
    parser.add_argument("--samples", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    if mujoco.__version__ != MUJOCO:
        sys.exit(f"MuJoCo {MUJOCO} is wanted, this is {mujoco.__version__}")
    if args.check:
        sys.exit(0 if check(args.urdf, json.loads(args.check.read_text())) else 1)
    if args.tip is None:
        parser.error("--tip is needed")
    generate(args.urdf, args.tip, args.samples, args.seed)


if __name__ == "__main__":
    main()
