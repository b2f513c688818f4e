#!/usr/bin/env python3
"""Rigid-body and operational-space quantities of a URDF by Pinocchio, for opspace to be tested against.

    python3 -m venv venv && venv/bin/pip install pin==4.1.0 numpy==2.4.6
    venv/bin/python generate.py urdf/ur5.urdf --tip tool0 --samples 20 --seed 1 > ur5.json
    venv/bin/python generate.py urdf/ur5.urdf --check ur5.json

The first draws states from a seed and prints a file in the format of README.md. The second computes the
outputs of an existing file again at its inputs and fails if any has changed by more than TOLERANCE.
"""

import argparse
import hashlib
import json
import pathlib
import sys

import numpy as np
import pinocchio as pin

PINOCCHIO = "4.1.0"
WORLD_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
MAX_CONDITION = 1e6
# Relative to max(1, largest entry): another processor or BLAS may round sums otherwise.
TOLERANCE = 1e-9


class Robot:
    """A Pinocchio model in coordinates with one number a joint."""

    def __init__(self, urdf):
        self.model = pin.buildModelFromUrdf(str(urdf))
        self.data = self.model.createData()
        self.joints = list(self.model.joints)[1:]
        self.names = list(self.model.names)[1:]
        # A continuous joint is a cosine and a sine in Pinocchio.
        self.continuous = [joint.nq == 2 for joint in self.joints]

    def configuration(self, angles):
        q = pin.neutral(self.model)
        for joint, continuous, angle in zip(self.joints, self.continuous, angles):
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                [np.cos(angle), np.sin(angle)] if continuous else [angle]
            )
        return q

    def kinds(self):
        return [
            "continuous" if c else "prismatic" if "P" in j.shortname()[len("JointModel") :] else "revolute"
            for j, c in zip(self.joints, self.continuous)
        ]

    def limits(self):
        """Position ranges to draw from, and limits of speed and effort."""
        lower, upper, speed = [], [], []
        for joint, kind in zip(self.joints, self.kinds()):
            low = self.model.lowerPositionLimit[joint.idx_q]
            high = self.model.upperPositionLimit[joint.idx_q]
            if kind == "continuous" or not low < high:
                low, high = -np.pi, np.pi
            if kind == "revolute":
                low, high = max(low, -np.pi), min(high, np.pi)
            lower.append(low)
            upper.append(high)
            given = self.model.upperVelocityLimit[joint.idx_v]
            speed.append(min(given, 0.3 if kind == "prismatic" else 3.0))
        return np.array(lower), np.array(upper), np.array(speed), self.model.upperEffortLimit.copy()

    def evaluate(self, sample, tip, rows):
        """All outputs at a sample's inputs."""
        model, data = self.model, self.data
        q = self.configuration(sample["q"])
        dq, ddq, tau, wrench = (np.array(sample[key]) for key in ("dq", "ddq", "tau_in", "f_tip"))
        frame = model.getFrameId(tip)
        joint = model.frames[frame].parentJoint

        pin.forwardKinematics(model, data, q, dq, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        placement = data.oMf[frame].copy()
        velocity = pin.getFrameVelocity(model, data, frame, WORLD_ALIGNED).vector.copy()
        bias = pin.getFrameClassicalAcceleration(model, data, frame, WORLD_ALIGNED).vector.copy()
        jacobian = pin.computeFrameJacobian(model, data, q, frame, WORLD_ALIGNED).copy()
        mass = np.array(pin.crba(model, data, q))
        mass = np.triu(mass) + np.triu(mass, 1).T
        gravity = pin.computeGeneralizedGravity(model, data, q).copy()
        nle = pin.nonLinearEffects(model, data, q, dq).copy()
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq).copy()

        # The wrench acts at the tip in world axes; Pinocchio takes it at the joint in the joint's axes.
        at_tip = pin.SE3(data.oMi[joint].rotation.T, data.oMi[joint].actInv(placement.translation))
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero() for _ in range(model.njoints)])
        forces[joint] = at_tip.act(pin.Force(wrench))

        selected = jacobian[rows]
        minv_jt = np.linalg.solve(mass, selected.T)
        inverse_inertia = selected @ minv_jt
        task_inertia = np.linalg.inv(inverse_inertia)
        task_inertia = (task_inertia + task_inertia.T) / 2
        inverse = minv_jt @ task_inertia
        outputs = {
            "tip_R": placement.rotation,
            "tip_p": placement.translation,
            "tip_vel": velocity,
            "J": jacobian,
            "Jdot_dq": bias,
            "M": mass,
            "g": gravity,
            "nle": nle,
            "C": coriolis,
            "tau_rnea": pin.rnea(model, data, q, dq, ddq).copy(),
            "ddq_aba": pin.aba(model, data, q, dq, tau).copy(),
            "tau_rnea_fext": pin.rnea(model, data, q, dq, ddq, forces).copy(),
            "ddq_aba_fext": pin.aba(model, data, q, dq, tau, forces).copy(),
            "com": pin.centerOfMass(model, data, q).copy(),
            "kinetic_energy": pin.computeKineticEnergy(model, data, q, dq),
            "potential_energy": pin.computePotentialEnergy(model, data, q),
            "Lambda": task_inertia,
            "Jbar": inverse,
            "N": np.eye(model.nv) - inverse @ selected,
            "lambda_inv_cond": np.linalg.cond(inverse_inertia),
        }
        return {
            key: float(value) if np.ndim(value) == 0 else np.asarray(value).ravel().tolist()
            for key, value in outputs.items()
        }


def generate(robot, urdf, tip, rows, count, seed):
    rng = np.random.default_rng(seed)
    n = robot.model.nv
    lower, upper, speed, effort = robot.limits()
    reach = np.array([1.0 if kind == "prismatic" else 5.0 for kind in robot.kinds()])
    samples, rejected = [], 0
    while len(samples) < count:
        q = rng.uniform(lower, upper)
        gravity = pin.computeGeneralizedGravity(robot.model, robot.data, robot.configuration(q))
        sample = {
            "q": q.tolist(),
            "dq": rng.uniform(-speed, speed).tolist(),
            "ddq": rng.uniform(-reach, reach).tolist(),
            "tau_in": (gravity + 0.25 * np.minimum(effort, 20.0) * rng.uniform(-1, 1, n)).tolist(),
            "f_tip": np.concatenate([rng.uniform(-20, 20, 3), rng.uniform(-2, 2, 3)]).tolist(),
        }
        outputs = robot.evaluate(sample, tip, rows)
        if outputs["lambda_inv_cond"] > MAX_CONDITION:
            rejected += 1
            continue
        samples.append(sample | outputs)
    meta = {
        "format": "osc-reference-dynamics/1",
        "robot": urdf.stem,
        "urdf": urdf.name,
        "urdf_sha256": hashlib.sha256(urdf.read_bytes()).hexdigest(),
        "generator": f"generate.py, Pinocchio {PINOCCHIO}, seed {seed}",
        "gravity": [0, 0, -9.81],
        "base": "fixed (URDF root link = world)",
        "nv": n,
        "joints": robot.names,
        "joint_types": robot.kinds(),
        "q_lower": lower.tolist(),
        "q_upper": upper.tolist(),
        "tip_frame": tip,
        "task_rows": rows,
        "total_mass": float(sum(inertia.mass for inertia in list(robot.model.inertias)[1:])),
        "cond_reject": MAX_CONDITION,
        "rejected": rejected,
        "n_samples": count,
    }
    print('{"meta":' + json.dumps(meta) + ',\n"samples":[')
    print(",\n".join(json.dumps(sample, separators=(",", ":")) for sample in samples))
    print("]}")


def check(robot, urdf, reference):
    """The largest relative change of every output; whether all are within TOLERANCE."""
    meta = reference["meta"]
    if meta["urdf_sha256"] != hashlib.sha256(urdf.read_bytes()).hexdigest():
        sys.exit(f"{urdf} is not the file that the numbers are of")
    if meta["joints"] != robot.names or meta["joint_types"] != robot.kinds():
        sys.exit("the joints are not the same, or not in the same order")
    worst = {}
    for sample in reference["samples"]:
        for key, value in robot.evaluate(sample, meta["tip_frame"], meta["task_rows"]).items():
            old, new = np.atleast_1d(sample[key]), np.atleast_1d(value)
            change = np.max(np.abs(new - old)) / max(1.0, np.max(np.abs(old)))
            worst[key] = max(worst.get(key, 0.0), change)
    for key, change in worst.items():
        print(f"{key:18} {change:.1e}")
    return max(worst.values()) <= TOLERANCE


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("urdf", type=pathlib.Path)
    parser.add_argument("--check", type=pathlib.Path, metavar="FILE", help="compare with this file instead")
    parser.add_argument("--tip", help="the frame whose motion is the task")
    parser.add_argument("--rows", type=int, nargs="+", default=list(range(6)), help="rows of its Jacobian")
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    if pin.__version__ != PINOCCHIO:
        sys.exit(f"Pinocchio {PINOCCHIO} is wanted, this is {pin.__version__}")
    robot = Robot(args.urdf)
    if args.check:
        sys.exit(0 if check(robot, args.urdf, json.loads(args.check.read_text())) else 1)
    if args.tip is None:
        parser.error("--tip is needed")
    generate(robot, args.urdf, args.tip, args.rows, args.samples, args.seed)


if __name__ == "__main__":
    main()
