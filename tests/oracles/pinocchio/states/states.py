#!/usr/bin/env python3
"""Many states of a URDF, and every quantity that opspace-model computes at them by Pinocchio.

    python3 -m venv venv && venv/bin/pip install pin==4.1.0 numpy==2.4.6
    venv/bin/python states.py ../urdf/anymal_c.urdf --tip LF_FOOT --second RH_FOOT --floating --seed 1 > anymal_c.json
    venv/bin/python states.py ../urdf/anymal_c.urdf --check anymal_c.json

The first draws states from a seed and prints a file in the format of ../README.md. The second computes the
outputs of an existing file again at its inputs and fails if any has changed by more than TOLERANCE.
"""

import argparse
import hashlib
import json
import pathlib
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin

sys.path.append(str(pathlib.Path(__file__).resolve().parent.parent))
import generate as base

ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
CONVENTIONS = {"aligned": ALIGNED, "local": pin.ReferenceFrame.LOCAL, "world": pin.ReferenceFrame.WORLD}
FORMAT = "opspace-oracle-states/1"
# Relative to max(1, largest entry): eleven digits are printed, and another processor may round sums otherwise.
TOLERANCE = 1e-9
NOTES_FOLDED = [
    "Pinocchio has no ABA, inverse mass matrix, energies, regressor or derivatives with mimic joints: everything "
    "is computed on the unfolded model and folded by G, dq_unfolded = G dq; forward dynamics by solving with GᵀMG"
]


class Robot(base.Robot):
    """A Pinocchio model in opspace's coordinates: one number a joint, followers folded away if wanted.

    Pinocchio knows most algorithms only without mimic joints. The model is therefore the unfolded one, whose
    velocities are `fold @ dq`; as `fold` is constant, torques fold by its transpose.
    """

    def __init__(self, model, sources, floating):
        self.model, self.data, self.floating = model, model.createData(), floating
        # How many numbers of q, how many of dq are the base's.
        self.lead, self.bases = (7, 6) if floating else (0, 0)
        first = 2 if floating else 1
        self.joints = list(model.joints)[first:]
        self.names = list(model.names)[first:]
        self.continuous = [joint.nq == 2 for joint in self.joints]
        # Where each joint's angle comes from: a coordinate's name, a multiplier and an offset.
        self.sources = [sources.get(name, (name, 1.0, 0.0)) for name in self.names]
        self.kept = [i for i, (name, source) in enumerate(zip(self.names, self.sources)) if source[0] == name]
        self.coordinates = [self.names[i] for i in self.kept]
        self.nv = self.bases + len(self.kept)
        self.fold = np.zeros((model.nv, self.nv))
        self.fold[: self.bases, : self.bases] = np.eye(self.bases)
        for joint, (leader, multiplier, _) in zip(self.joints, self.sources):
            self.fold[joint.idx_v, self.bases + self.coordinates.index(leader)] = multiplier
        self.folded = self.nv < model.nv

    @classmethod
    def read(cls, urdf, floating, fold_mimics):
        root = [pin.JointModelFreeFlyer()] if floating else []
        sources = mimics(urdf) if fold_mimics else {}
        return cls(pin.buildModelFromUrdf(str(urdf), *root), sources, floating)

    def configuration(self, q):
        """Pinocchio's q of ours."""
        value = dict(zip(self.coordinates, q[self.lead :]))
        angles = [multiplier * value[leader] + offset for leader, multiplier, offset in self.sources]
        full = super().configuration(angles)
        full[: self.lead] = q[: self.lead]
        return full

    def coordinates_of(self, full, near):
        """Our q of Pinocchio's; a continuous joint's angle is the one nearest to `near`'s."""
        q = list(full[: self.lead])
        for i, guess in zip(self.kept, near):
            joint = self.joints[i]
            angle = full[joint.idx_q]
            if self.continuous[i]:
                angle = np.arctan2(full[joint.idx_q + 1], angle)
                angle += 2 * np.pi * np.round((guess - angle) / (2 * np.pi))
            q.append(angle)
        return np.array(q)

    def neutral(self):
        joints = [0.0] * len(self.coordinates)
        return [0, 0, 0, 0, 0, 0, 1, *joints] if self.floating else joints

    def frame(self, link):
        return self.model.getFrameId(link, pin.FrameType.BODY)

    def joint_of(self, link):
        return self.model.frames[self.frame(link)].parentJoint

    def bodies(self):
        """The link at each joint's child side, in Pinocchio's order; a floating base's root link first."""
        frames = [f for f in self.model.frames if f.type == pin.FrameType.BODY and f.placement.isIdentity(0.0)]
        return [next(f.name for f in frames if f.parentJoint == i) for i in range(1, self.model.njoints)]

    def with_payload(self, payload):
        model = self.model.copy()
        placement = model.frames[self.frame(payload["frame"])].placement
        model.inertias[self.joint_of(payload["frame"])] += placement.act(inertia_of(payload))
        return self.like(model)

    def with_locked(self, locked):
        model = self.model.copy()
        for frame in model.frames:
            # buildReducedModel refuses a link of the same name as its joint.
            if frame.type == pin.FrameType.BODY:
                frame.name = f"link {frame.name}"
        q = self.neutral()
        for name, value in locked:
            q[self.lead + self.coordinates.index(name)] = value
        q = self.configuration(q)
        return self.like(pin.buildReducedModel(model, [model.getJointId(name) for name, _ in locked], q))

    def like(self, model):
        """Another model of the same joints or some of them, folded as this one."""
        return Robot(model, dict(zip(self.names, self.sources)), self.floating)

    def mass_matrix(self, q):
        return self.fold.T @ symmetric(pin.crba(self.model, self.data, q)) @ self.fold

    def bias(self, q, dq):
        return self.fold.T @ pin.nonLinearEffects(self.model, self.data, q, self.fold @ dq)

    def forces(self, q, wrenches):
        """Wrenches at frames in world axes, as Pinocchio wants them: at joints, in their axes."""
        pin.framesForwardKinematics(self.model, self.data, q)
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero() for _ in range(self.model.njoints)])
        for link, wrench in wrenches:
            joint, origin = self.joint_of(link), self.data.oMf[self.frame(link)].translation
            placement = self.data.oMi[joint]
            forces[joint] += pin.SE3(placement.rotation.T, placement.actInv(origin)).act(pin.Force(wrench))
        return forces

    def evaluate_states(self, sample, meta):
        """All outputs at a sample's inputs."""
        sample = {key: np.array(value) for key, value in sample.items()}
        q = self.configuration(sample["q"])
        return self.kinematics(sample, q, meta) | self.dynamics(sample, q, meta) | self.variants(sample, q, meta)

    def kinematics(self, sample, q, meta):
        model, data, x = self.model, self.data, self.fold @ sample["x"]
        dq = self.fold @ sample["dq"]
        tip, second = self.frame(meta["tip_frame"]), self.frame(meta["second_frame"])
        pin.forwardKinematics(model, data, q, dq, np.zeros(model.nv))
        bias = pin.getFrameClassicalAcceleration(model, data, tip, ALIGNED).vector.copy()
        pin.computeJointJacobiansTimeVariation(model, data, q, dq)
        pin.updateFramePlacements(model, data)
        at_tip, at_second = data.oMf[tip].copy(), data.oMf[second].copy()
        columns = {name: pin.getFrameJacobian(model, data, tip, frame) @ x for name, frame in CONVENTIONS.items()}
        rates = {
            name: pin.getFrameJacobianTimeVariation(model, data, tip, frame) @ x for name, frame in CONVENTIONS.items()
        }
        linear, angular = np.split(columns["aligned"], 2)
        other_linear, other_angular = np.split(pin.getFrameJacobian(model, data, second, ALIGNED) @ x, 2)
        apart = at_second.translation - at_tip.translation
        relative = [other_linear - linear - np.cross(angular, apart), other_angular - angular]
        return {
            "tip_R": at_tip.rotation,
            "tip_p": at_tip.translation,
            "second_R": at_second.rotation,
            "second_p": at_second.translation,
            **{f"J_{name}_x": value for name, value in columns.items()},
            **{f"Jdot_{name}_x": value for name, value in rates.items()},
            "Jdot_dq": bias,
            "J_point_x": [linear + np.cross(angular, at_tip.rotation @ meta["point"]), angular],
            "J_relative_x": [at_tip.rotation.T @ part for part in relative],
            "com": pin.centerOfMass(model, data, q).copy(),
            "J_com_x": pin.jacobianCenterOfMass(model, data, q) @ x,
            "Ag_x": pin.computeCentroidalMap(model, data, q) @ x,
            "hg": pin.computeCentroidalMomentum(model, data, q, dq).vector.copy(),
        }

    def dynamics(self, sample, q, meta):
        model, data, fold = self.model, self.data, self.fold
        x, tau = sample["x"], sample["tau"]
        dq, ddq = fold @ sample["dq"], fold @ sample["ddq"]
        none = self.forces(q, [])
        both = self.forces(
            q, [(meta["tip_frame"], sample["wrench_tip"]), (meta["second_frame"], sample["wrench_second"])]
        )
        mass = self.mass_matrix(q)
        if self.folded:
            accelerations = [
                np.linalg.solve(mass, tau - fold.T @ pin.rnea(model, data, q, dq, np.zeros(model.nv), forces))
                for forces in (none, both)
            ]
            minv = np.linalg.inv(mass)
            # At the acceleration that tau causes, d(ddq) = -M⁻¹ d(rnea).
            by_q, by_v, _ = pin.computeRNEADerivatives(model, data, q, dq, fold @ accelerations[0])
            ddq_dq, ddq_dv = -minv @ fold.T @ by_q @ fold, -minv @ fold.T @ by_v @ fold
        else:
            accelerations = [pin.aba(model, data, q, dq, tau, forces).copy() for forces in (none, both)]
            minv = symmetric(pin.computeMinverse(model, data, q))
            ddq_dq, ddq_dv, _ = (np.array(part) for part in pin.computeABADerivatives(model, data, q, dq, tau))
        tau_dq, tau_dv, _ = pin.computeRNEADerivatives(model, data, q, dq, ddq)
        tau_dq, tau_dv = fold.T @ tau_dq @ fold, fold.T @ tau_dv @ fold
        parameters = np.concatenate([inertia_of(body).toDynamicParameters() for body in meta["random_inertias"]])
        return {
            "M_x": mass @ x,
            "Minv_x": minv @ x,
            "C_x": fold.T @ pin.computeCoriolisMatrix(model, data, q, dq) @ fold @ x,
            "g": fold.T @ pin.computeGeneralizedGravity(model, data, q),
            "nle": self.bias(q, sample["dq"]),
            "tau_rnea": fold.T @ pin.rnea(model, data, q, dq, ddq),
            "tau_rnea_ext": fold.T @ pin.rnea(model, data, q, dq, ddq, both),
            "ddq_aba": accelerations[0],
            "ddq_aba_ext": accelerations[1],
            "regressor_tau": fold.T @ pin.computeJointTorqueRegressor(model, data, q, dq, ddq) @ parameters,
            "dtau_dq_x": tau_dq @ x,
            "dtau_dv_x": tau_dv @ x,
            "ddq_dq_x": ddq_dq @ x,
            "ddq_dv_x": ddq_dv @ x,
            "kinetic_energy": pin.computeKineticEnergy(model, data, q, dq),
            "potential_energy": pin.computePotentialEnergy(model, data, q),
        }

    def variants(self, sample, q, meta):
        """Configurations moved, the robot with joints locked, the robot with a payload."""
        x, dq = sample["x"], sample["dq"]
        moved = pin.integrate(self.model, q, self.fold @ x)
        from_neutral = pin.difference(self.model, self.configuration(self.neutral()), q)
        kept = [self.joints[i].idx_v for i in self.kept]
        loaded, locked = self.with_payload(meta["payload"]), self.with_locked(meta["locked"])
        gone = np.array([self.coordinates.index(name) for name, _ in meta["locked"]])
        rest_q = locked.configuration(np.delete(sample["q"], self.lead + gone))
        rest_dq, rest_x = (np.delete(vector, self.bases + gone) for vector in (dq, x))
        return {
            "q_plus": self.coordinates_of(moved, sample["q"][self.lead :] + x[self.bases :]),
            "from_neutral": [*from_neutral[: self.bases], *from_neutral[kept]],
            "reduced_M_x": locked.mass_matrix(rest_q) @ rest_x,
            "reduced_nle": locked.bias(rest_q, rest_dq),
            "payload_M_x": loaded.mass_matrix(q) @ x,
            "payload_nle": loaded.bias(q, dq),
        }


def mimics(urdf):
    """Of each follower: its leader, multiplier and offset."""
    tags = [(joint, joint.find("mimic")) for joint in ElementTree.parse(urdf).getroot().findall("joint")]
    return {
        joint.get("name"): (tag.get("joint"), float(tag.get("multiplier", 1)), float(tag.get("offset", 0)))
        for joint, tag in tags
        if tag is not None
    }


def symmetric(matrix):
    """Pinocchio may leave the lower triangle as it was."""
    return np.triu(matrix) + np.triu(matrix, 1).T


def inertia_of(body):
    xx, xy, yy, xz, yz, zz = body["inertia"]
    about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return pin.Inertia(body["mass"], np.array(body["com"]), about_com)


def random_inertia(rng):
    """A box of random size, turned at random."""
    mass, second_moments = rng.uniform(0.2, 3), rng.uniform(0.001, 0.01, 3)
    axes = pin.Quaternion(unit(rng.normal(size=4))).matrix()
    tensor = axes @ np.diag(mass * (second_moments.sum() - second_moments)) @ axes.T
    entries = [tensor[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    return {"mass": mass, "com": rng.uniform(-0.2, 0.2, 3), "inertia": entries}


def unit(vector):
    return vector / np.linalg.norm(vector)


def away_from_zero(rng, n):
    return rng.choice([-1, 1], n) * rng.uniform(0.1, 1, n)


def draw_locked(robot, rng, lower, upper):
    """Two joints that nothing follows; the first carries another joint."""
    followed = {leader for name, (leader, _, _) in zip(robot.names, robot.sources) if leader != name}
    parents = {robot.model.parents[robot.model.getJointId(name)] for name in robot.names}
    free = [name for name in robot.coordinates if name not in followed]
    first = rng.choice([name for name in free if robot.model.getJointId(name) in parents])
    second = rng.choice([name for name in free if name != first])
    places = [robot.coordinates.index(name) for name in (first, second)]
    return [[robot.coordinates[i], rng.uniform(lower[i], upper[i])] for i in places]


def draw_sample(robot, rng, limits):
    """A state; numbers are rounded so that their text is short."""
    lower, upper, speed, effort, reach = limits
    q = rng.uniform(lower, upper).round(6)
    dq, ddq = rng.uniform(-speed, speed), rng.uniform(-reach, reach)
    if robot.floating:
        q = [*rng.uniform(-1, 1, 3).round(6), *unit(rng.normal(size=4)), *q]
        dq = np.concatenate([rng.uniform(-1, 1, 3), rng.uniform(-3, 3, 3), dq])
        ddq = np.concatenate([rng.uniform(-5, 5, 6), ddq])
        effort = np.concatenate([[20.0] * 6, effort])
    q = as_printed(q)
    gravity = robot.fold.T @ pin.computeGeneralizedGravity(robot.model, robot.data, robot.configuration(q))
    inputs = {
        "dq": dq,
        "ddq": ddq,
        "tau": gravity + 0.25 * np.minimum(effort, 20.0) * rng.uniform(-1, 1, robot.nv),
        "wrench_tip": np.concatenate([rng.uniform(-20, 20, 3), rng.uniform(-2, 2, 3)]),
        "wrench_second": np.concatenate([rng.uniform(-20, 20, 3), rng.uniform(-2, 2, 3)]),
        "x": away_from_zero(rng, robot.nv),
    }
    return {"q": q} | {key: as_printed(value.round(6)) for key, value in inputs.items()}


def as_printed(values):
    """Rounded to the fourteen digits of a file, nested lists and objects included."""
    if isinstance(values, dict):
        return {key: as_printed(value) for key, value in values.items()}
    if isinstance(values, (list, tuple, np.ndarray)):
        return [as_printed(value) for value in values]
    if isinstance(values, (float, np.floating)):
        return float(f"{values:.11g}")
    return values


def flat(value):
    return float(value) if np.ndim(value) == 0 else np.ravel(value).tolist()


def draw(robot, urdf, args):
    rng = np.random.default_rng(args.seed)
    joint_limits = robot.limits()
    efforts = joint_limits[3][robot.bases :]
    kinds = [robot.kinds()[i] for i in robot.kept]
    reach = np.array([1.0 if kind == "prismatic" else 5.0 for kind in kinds])
    limits = [part[robot.kept] for part in (*joint_limits[:3], efforts)] + [reach]
    meta = {
        "format": FORMAT,
        "robot": urdf.stem,
        "urdf": urdf.name,
        "urdf_sha256": hashlib.sha256(urdf.read_bytes()).hexdigest(),
        "generator": f"states.py, Pinocchio {pin.__version__}, numpy {np.__version__}, seed {args.seed}",
        "floating": args.floating,
        "fold_mimics": args.fold_mimics,
        "nq": robot.nv + robot.lead - robot.bases,
        "nv": robot.nv,
        "joints": robot.coordinates,
        "joint_types": kinds,
        "tip_frame": args.tip,
        "second_frame": args.second,
        "point": away_from_zero(rng, 3) / 5,
        "total_mass": sum(inertia.mass for inertia in list(robot.model.inertias)[1:]),
        "random_inertias": [{"link": link} | random_inertia(rng) for link in robot.bodies()],
        "payload": {"frame": args.tip} | random_inertia(rng),
        "locked": draw_locked(robot, rng, *limits[:2]),
        "notes": NOTES_FOLDED if robot.folded else [],
    }
    meta = as_printed(meta)
    samples = []
    for _ in range(args.samples):
        sample = draw_sample(robot, rng, limits)
        outputs = robot.evaluate_states(sample, meta)
        samples.append(as_printed(sample | {key: flat(value) for key, value in outputs.items()}))
    return meta, samples


def compact(value):
    """JSON with fourteen digits a number."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{json.dumps(key)}:{compact(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",".join(compact(item) for item in value) + "]"
    return f"{value:.11g}" if isinstance(value, float) else json.dumps(value, ensure_ascii=False)


def check(robot, urdf, reference):
    """Whether all outputs are within TOLERANCE; prints the largest change of each."""
    meta = reference["meta"]
    if meta["urdf_sha256"] != hashlib.sha256(urdf.read_bytes()).hexdigest():
        sys.exit(f"{urdf} is not the file that the numbers are of")
    if meta["joints"] != robot.coordinates:
        sys.exit("the joints are not the same, or not in the same order")
    worst = {}
    for sample in reference["samples"]:
        for key, value in robot.evaluate_states(sample, meta).items():
            old, new = np.ravel(sample[key]), np.ravel(value)
            change = np.max(np.abs(new - old)) / max(1.0, np.max(np.abs(old)))
            worst[key] = max(worst.get(key, 0.0), change)
    for key, change in worst.items():
        print(f"{key:18} {change:.1e}")
    return max(worst.values()) <= TOLERANCE


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("urdf", type=pathlib.Path)
    parser.add_argument("--check", type=pathlib.Path, metavar="FILE", help="compare with this file instead")
    parser.add_argument("--tip", help="the link whose Jacobian is taken; the first wrench and the payload are there")
    parser.add_argument("--second", help="the link of the relative Jacobian and the second wrench")
    parser.add_argument("--floating", action="store_true", help="the root link moves freely")
    parser.add_argument("--fold-mimics", action="store_true", help="a mimic joint is no coordinate of its own")
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    if pin.__version__ != base.PINOCCHIO:
        sys.exit(f"Pinocchio {base.PINOCCHIO} is wanted, this is {pin.__version__}")
    if args.check:
        reference = json.loads(args.check.read_text())
        meta = reference["meta"]
        robot = Robot.read(args.urdf, meta["floating"], meta["fold_mimics"])
        sys.exit(0 if check(robot, args.urdf, reference) else 1)
    if args.tip is None or args.second is None:
        parser.error("--tip and --second are needed")
    meta, samples = draw(Robot.read(args.urdf, args.floating, args.fold_mimics), args.urdf, args)
    print('{"meta":' + compact(meta) + ',\n"samples":[')
    print(",\n".join(compact(sample) for sample in samples))
    print("]}")


if __name__ == "__main__":
    main()
