"""M, bias, J and Λ, compared with those of Pinocchio and MuJoCo: relative to the largest element of each."""

import re

import arms
import numpy as np
import opspace
import pytest

mujoco = pytest.importorskip("mujoco")
pin = pytest.importorskip("pinocchio")

BOUND = 1e-11
POSTURES = 40

ROBOTS = opspace.robots()


def postures(model, seed):
    """Random states within the limits of the joints."""
    random = np.random.default_rng(seed)
    lower, upper = np.clip(model.position_limits, -3.0, 3.0).T
    for _ in range(POSTURES):
        yield random.uniform(lower, upper), random.normal(size=model.n)


def error(own, other):
    return np.abs(own - other).max() / np.abs(other).max()


def inertia(mass_matrix, jacobian, rows):
    """Λ by an orthogonal factorisation: it loses half the digits that products and an inverse lose."""
    lower = np.linalg.cholesky(mass_matrix)
    upper = np.linalg.qr(np.linalg.solve(lower, jacobian[rows].T), mode="r")
    inverse = np.linalg.inv(upper)
    return inverse @ inverse.T


def rows_of(model):
    return list(range(6)) if model.n >= 6 else [0, 2][: model.n]


def compare(worst, model, frame, mass_matrix, bias, jacobian):
    """Notes the largest errors. Λ is compared where it has digits: its error grows with its condition."""
    rows = rows_of(model)
    own = {"M": model.mass_matrix, "bias": model.bias, "J": model.jacobian(frame)}
    for name, other in (("M", mass_matrix), ("bias", bias), ("J", jacobian)):
        worst[name] = max(worst.get(name, 0.0), error(own[name], other))
    mobility = jacobian[rows] @ np.linalg.solve(mass_matrix, jacobian[rows].T)
    if np.linalg.cond(mobility) < 1e6:
        worst["states of Λ"] = worst.get("states of Λ", 0) + 1
        other = inertia(mass_matrix, jacobian, rows)
        worst["Λ"] = max(worst.get("Λ", 0.0), error(model.operational_inertia(frame, rows), other))


def judge(worst, who):
    print(f"{who}: " + ", ".join(f"{name} {value:.2g}" for name, value in worst.items()))
    assert worst["states of Λ"] >= POSTURES // 4, worst
    assert all(worst[name] <= BOUND for name in ("M", "bias", "J", "Λ")), worst


@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_are_those_of_pinocchio(robot):
    """Each robot folder: its URDF in Pinocchio, with the armature of the folder's robot.toml."""
    model = opspace.Model.from_robot(ROBOTS[robot])
    (urdf,) = ROBOTS[robot].glob("*.urdf")
    other = pin.buildModelFromUrdf(str(urdf))
    assert other.nv == model.n
    order = [other.joints[other.getJointId(joint)].idx_v for joint in model.joints]
    assert order == list(range(model.n)), "Pinocchio has another order"
    other.armature = model.armature
    data = other.createData()
    frame = model.frames[-1]
    worst = {}
    for q, dq in postures(model, 1):
        own_q = np.concatenate(
            [
                [np.cos(x), np.sin(x)] if other.joints[i + 1].nq == 2 else [x]
                for i, x in enumerate(q)
            ]
        )
        model.update(q, dq)
        pin.computeAllTerms(other, data, own_q, dq)
        pin.updateFramePlacements(other, data)
        jacobian = pin.getFrameJacobian(
            other, data, other.getFrameId(frame), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        mass_matrix = np.triu(data.M) + np.triu(data.M, 1).T
        compare(worst, model, frame, mass_matrix, data.nle, jacobian)
        pin.forwardKinematics(other, data, own_q, dq, np.zeros(model.n))
        axes = other.getFrameId(frame), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        velocity = pin.getFrameVelocity(other, data, *axes).vector
        acceleration = pin.getFrameClassicalAcceleration(other, data, *axes).vector
        assert np.allclose(model.velocity(frame), velocity, atol=1e-12 * max(1.0, np.abs(velocity).max()))
        assert np.allclose(
            model.bias_acceleration(frame), acceleration, atol=1e-12 * max(1.0, np.abs(acceleration).max())
        )
        position, quaternion = model.pose(frame)
        place = data.oMf[other.getFrameId(frame)]
        assert np.allclose(position, place.translation, atol=1e-13)
        x, y, z, w = pin.Quaternion(place.rotation).coeffs()
        assert abs(abs(quaternion @ [w, x, y, z]) - 1.0) < 1e-13
        assert np.allclose(model.gravity, pin.computeGeneralizedGravity(other, other.createData(), own_q), atol=1e-12)
    judge(worst, f"{robot} against Pinocchio {pin.__version__}")


def of_mujoco(compiled, model, q, dq):
    """State of a compiled model with the positions and velocities of the robot's joints."""
    data = mujoco.MjData(compiled)
    joints = [compiled.joint(name) for name in model.joints]
    for joint, position, velocity in zip(joints, q, dq, strict=True):
        data.qpos[joint.qposadr] = position
        data.qvel[joint.dofadr] = velocity
    return data, [int(joint.dofadr[0]) for joint in joints]


def dynamics_of_mujoco(compiled, data, frame):
    """M, bias and J of all degrees of freedom."""
    mujoco.mj_forward(compiled, data)
    mass_matrix = np.zeros((compiled.nv, compiled.nv))
    for column, unit in zip(mass_matrix.T, np.eye(compiled.nv), strict=True):
        product = np.zeros(compiled.nv)
        mujoco.mj_mulM(compiled, data, product, unit)
        column[:] = product
    jacobian = np.zeros((6, compiled.nv))
    names = [compiled.site(i).name for i in range(compiled.nsite)]
    if frame in names:
        mujoco.mj_jacSite(compiled, data, jacobian[:3], jacobian[3:], names.index(frame))
    else:
        mujoco.mj_jacBody(compiled, data, jacobian[:3], jacobian[3:], compiled.body(frame).id)
    return mass_matrix, data.qfrc_bias.copy(), jacobian


@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_are_those_of_mujoco(robot):
    """Each robot folder: its URDF compiled by MuJoCo, against the folder's model, and against the compiled model read back."""
    own = opspace.Model.from_robot(ROBOTS[robot])
    (urdf,) = ROBOTS[robot].glob("*.urdf")
    text = re.sub(r"<(visual|collision)>.*?</\1>", "", urdf.read_text(), flags=re.DOTALL)
    compiler = '<mujoco><compiler fusestatic="false" balanceinertia="false" inertiafromgeom="false"/></mujoco>'
    text = re.sub(r"(<robot[^>]*>)", rf"\1{compiler}", text, count=1)
    if robot == "planar-2-link":
        # Its links are rods: MuJoCo has no bodies without inertia about an axis.
        with pytest.raises(ValueError, match="positive eigenvalues"):
            mujoco.MjModel.from_xml_string(text)
        return
    compiled = mujoco.MjModel.from_xml_string(text)
    compiled.dof_armature[:] = own.armature
    read = opspace.Model.from_mujoco(compiled)
    assert read.joints == own.joints
    assert np.array_equal(read.position_limits, own.position_limits)
    frame = own.frames[-1]
    for model in (own, read):
        worst = {}
        for q, dq in postures(model, 2):
            model.update(q, dq)
            data, _ = of_mujoco(compiled, model, q, dq)
            compare(worst, model, frame, *dynamics_of_mujoco(compiled, data, frame))
        judge(worst, f"{robot} against MuJoCo {mujoco.__version__}")


@pytest.mark.parametrize(("text", "frame"), [(arms.SERIAL, "tool"), (arms.SERIAL, "plate"), (arms.SIX, "flange")])
def test_arms_of_mujoco(text, frame):
    """Compiled arms: offsets and reference positions of joints, three joints in a body, a slide, fixed bodies, sites."""
    compiled = mujoco.MjModel.from_xml_string(text)
    model = opspace.Model.from_mujoco(compiled)
    assert np.array_equal(model.armature, compiled.dof_armature)
    assert np.array_equal(model.friction, compiled.dof_frictionloss)
    assert np.array_equal(model.damping, compiled.dof_damping)
    worst = {}
    for q, dq in postures(model, 3):
        model.update(q, dq)
        data, _ = of_mujoco(compiled, model, q, dq)
        compare(worst, model, frame, *dynamics_of_mujoco(compiled, data, frame))
        position, _ = model.pose(frame)
        names = [compiled.site(i).name for i in range(compiled.nsite)]
        place = data.site(frame).xpos if frame in names else data.body(frame).xpos
        assert np.allclose(position, place, atol=1e-13)
    judge(worst, f"{model.name} ({frame}) against MuJoCo {mujoco.__version__}")


def test_names_and_limits_of_mujoco():
    """The arm's names and limits, by hand."""
    model = opspace.Model.from_mujoco(mujoco.MjModel.from_xml_string(arms.SERIAL))
    assert model.name == "serial"
    assert model.joints == ["j1", "j2", "j3", "j4", "j5", "j6", "j7"]
    assert {"world", "one", "wrist", "plate", "tool"} <= set(model.frames)
    assert model.position_limits[0].tolist() == [np.deg2rad(-2.9), np.deg2rad(2.9)]
    assert model.position_limits[2].tolist() == [-np.inf, np.inf]
    assert model.effort_limits[2] == 60.0 and np.isinf(model.effort_limits[0])


def test_equalities_of_mujoco():
    """A finger that another follows, and a locked joint: M of MuJoCo, restricted to what the equalities leave."""
    compiled = mujoco.MjModel.from_xml_string(arms.GRIPPER)
    with pytest.raises(opspace.OpspaceError, match="box_joint.*free"):
        opspace.Model.from_mujoco(compiled)
    kept = [compiled.joint(i).name for i in range(compiled.njnt) if compiled.joint(i).name != "box_joint"]
    model = opspace.Model.from_mujoco(compiled, joints=kept)
    assert model.joints == ["yaw", "left_shoulder", "left_elbow", "finger_joint"]
    assert model.armature[3] == pytest.approx(0.1 + 12**2 * 0.05, rel=1e-14)
    assert model.friction.shape == (4,)
    worst = {}
    for q, dq in postures(model, 4):
        q[3] = abs(q[3]) * 0.01
        model.update(q, dq)
        data, dofs = of_mujoco(compiled, model, q, dq)
        # Angles of the file are degrees: thumb - 0.2 deg = 0.1 + 12 (finger - 0.01).
        data.joint("thumb_joint").qpos = np.deg2rad(0.2) + 0.1 + 12 * (q[3] - 0.01)
        data.joint("thumb_joint").qvel = 12 * dq[3]
        data.joint("right_shoulder").qpos = 0.3
        mass_matrix, bias, jacobian = dynamics_of_mujoco(compiled, data, "thumb")
        left = np.zeros((compiled.nv, 4))
        left[dofs, range(4)] = 1.0
        left[compiled.joint("thumb_joint").dofadr[0], 3] = 12.0
        own = {"M": model.mass_matrix, "bias": model.bias, "J": model.jacobian("thumb")}
        others = {"M": left.T @ mass_matrix @ left, "bias": left.T @ bias, "J": jacobian @ left}
        for name, other in others.items():
            worst[name] = max(worst.get(name, 0.0), error(own[name], other))
    print(worst)
    assert all(value <= BOUND for value in worst.values()), worst


def test_refused_equalities():
    """An equality that is not linear, and one that closes a loop."""
    curved = arms.GRIPPER.replace("0.1 12 0 0 0", "0.1 12 3 0 0")
    arm = ["left_elbow", "finger_joint", "thumb_joint"]
    with pytest.raises(opspace.OpspaceError, match="thumb_joint.*not linear"):
        opspace.Model.from_mujoco(mujoco.MjModel.from_xml_string(curved), joints=arm)
    loop = arms.GRIPPER.replace("<equality>", '<equality><connect body1="finger" body2="right" anchor="0 0 0"/>')
    with pytest.raises(opspace.OpspaceError, match="loop"):
        opspace.Model.from_mujoco(mujoco.MjModel.from_xml_string(loop), joints=arm)
    # Where no joint of the robot is between the two bodies, the loop is none of the robot's.
    opspace.Model.from_mujoco(mujoco.MjModel.from_xml_string(loop), joints=["yaw"])


@pytest.mark.parametrize("robot", ROBOTS)
def test_batch_equals_updates(robot):
    """Many states in one call against one after the other, bit for bit."""
    model = opspace.Model.from_robot(ROBOTS[robot])
    frame = model.frames[-1]
    states = list(postures(model, 5))
    q, dq = np.array([q for q, _ in states]), np.array([dq for _, dq in states])
    batch = model.batch(q, dq, frame)
    for k, (q, dq) in enumerate(states):
        model.update(q, dq)
        assert np.array_equal(batch.mass_matrix[k], model.mass_matrix)
        assert np.array_equal(batch.bias[k], model.bias)
        assert np.array_equal(batch.gravity[k], model.gravity)
        assert np.array_equal(batch.jacobian[k], model.jacobian(frame))
        position, quaternion = model.pose(frame)
        assert np.array_equal(batch.position[k], position)
        assert np.array_equal(batch.quaternion[k], quaternion)
    assert model.batch(np.zeros((0, model.n))).mass_matrix.shape == (0, model.n, model.n)
    assert model.batch(np.array([q for q, _ in states])).jacobian is None
