"""Programs of others judge the simulated servo bus, and the driver on a bus that they have calibrated.

    judge.py SIMULATED_BUS PACE OPSPACE

The arguments are the examples `simulated-bus` and `pace` of opspace-feetech, and the program `opspace`. The judges are LeRobot's own bus for Feetech's
servos, rustypot, and feetech-servo-sdk. LeRobot is installed without its dependencies: torch, accelerate and datasets, which its
bus does not use but its package imports, are empty modules here. Nothing else of LeRobot is replaced.
"""

import contextlib
import dataclasses
import importlib.abc
import importlib.machinery
import json
import math
import runpy
import signal
import subprocess
import sys
import tempfile
import time
import types
from pathlib import Path


class Empty(types.ModuleType):
    """Module or class without contents: every name in it is empty, too."""

    __path__ = []

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


class EmptyModules(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds empty modules in place of packages that are not installed."""

    NAMES = {"torch", "accelerate", "datasets"}

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in self.NAMES:
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec):
        return Empty(spec.name)

    def exec_module(self, module):
        pass


sys.meta_path.append(EmptyModules())

MOTORS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]


def check(condition, words):
    if not condition:
        raise SystemExit(f"failed: {words}")


def lerobot_registers(program):
    """Compares the table of registers with LeRobot's."""
    from lerobot.motors.feetech.tables import STS_SMS_SERIES_CONTROL_TABLE, STS_SMS_SERIES_ENCODINGS_TABLE

    lines = subprocess.run([program, "--registers"], check=True, capture_output=True, text=True).stdout.splitlines()
    for name, address, width, sign in (line.split("\t") for line in lines):
        check(name in STS_SMS_SERIES_CONTROL_TABLE, f"LeRobot has no register {name}")
        theirs = STS_SMS_SERIES_CONTROL_TABLE[name]
        check(theirs == (int(address), int(width)), f"{name}: ({address}, {width}), LeRobot {theirs}")
        theirs = STS_SMS_SERIES_ENCODINGS_TABLE.get(name)
        # LeRobot reads currents without their signs.
        if name != "Present_Current":
            check(theirs == (int(sign) if sign else None), f"{name}: sign bit {sign!r}, LeRobot {theirs}")
    print(f"lerobot: {len(lines)} registers have its addresses, widths and signs")


def rustypot_registers(program):
    """Compares the table of registers with rustypot's."""
    from rustypot import Sts3215PyController

    theirs = {register.name: (register.addr, register.size) for register in Sts3215PyController.registers()}
    lines = subprocess.run([program, "--registers"], check=True, capture_output=True, text=True).stdout.splitlines()
    compared = 0
    for name, address, width, _ in (line.split("\t") for line in lines):
        if name.lower() in theirs:
            compared += 1
            check(theirs[name.lower()] == (int(address), int(width)), f"{name}: rustypot {theirs[name.lower()]}")
    check(compared >= 30, f"only {compared} registers have names of rustypot")
    print(f"rustypot: {compared} registers have its addresses and widths")


def lerobot(port):
    """LeRobot connects, configures, calibrates and moves the arm. Returns its calibration."""
    from lerobot.motors import Motor, MotorCalibration, MotorNormMode
    from lerobot.motors.feetech import FeetechMotorsBus, OperatingMode

    motors = {name: Motor(id, "sts3215", MotorNormMode.DEGREES) for id, name in enumerate(MOTORS, 1)}
    bus = FeetechMotorsBus(port, motors)
    bus.connect()
    check(bus.broadcast_ping() == dict.fromkeys(range(1, 7), 777), "broadcast ping")
    bus.disable_torque()
    bus.configure_motors()
    for motor in MOTORS:
        bus.write("Operating_Mode", motor, OperatingMode.POSITION.value)
        bus.write("P_Coefficient", motor, 32)
    offsets = bus.set_half_turn_homings()
    # The simulated servos measure once in a millisecond.
    time.sleep(0.01)
    positions = bus.sync_read("Present_Position", normalize=False)
    # Joints with weight sink meanwhile.
    check(all(abs(position - 2047) <= 40 for position in positions.values()), f"half-turn homings: {positions}")
    check(abs(positions["wrist_roll"] - 2047) <= 1, f"half-turn homings: {positions}")
    calibration = {
        motor: MotorCalibration(motors[motor].id, 0, offsets[motor], 900 + 10 * motors[motor].id, 3200)
        for motor in MOTORS
    }
    bus.write_calibration(calibration)
    check(bus.is_calibrated, "the calibration that was written is not read back")

    bus.enable_torque()
    before = bus.sync_read("Present_Position")
    bus.sync_write("Goal_Position", {motor: before[motor] + 10 for motor in MOTORS})
    time.sleep(1.0)
    moved = {motor: bus.sync_read("Present_Position")[motor] - before[motor] for motor in MOTORS}
    # The weights deflect P = 32, 17.8 Nm/rad, by up to 2 degrees, friction by 0.2.
    check(all(abs(angle - 10) < 2.5 for angle in moved.values()), f"moved by {moved} degrees instead of 10")
    check(abs(moved["shoulder_pan"] - 10) < 0.5, f"a joint without weight moved by {moved['shoulder_pan']}")
    check(bus.read("Present_Voltage", "gripper") == 74, "voltage")
    begun = time.perf_counter()
    for _ in range(100):
        bus.sync_read("Present_Position")
    each_ms = (time.perf_counter() - begun) * 10
    bus.disconnect(disable_torque=True)
    print(f"lerobot: connected, calibrated, moved by 10 degrees; sync_read {each_ms:.2f} ms")
    return calibration


def rustypot(port):
    from rustypot import Sts3215PyController

    arm = Sts3215PyController(serial_port=port, baudrate=1_000_000, timeout=0.5)
    ids = list(range(1, 7))
    check([arm.ping(id) for id in [1, 6, 9]] == [True, True, False], "ping")
    positions = arm.sync_read_present_position(ids)
    arm.sync_write_goal_position(ids, positions)
    arm.sync_write_torque_enable(ids, [True] * 6)
    time.sleep(0.5)
    positions = arm.sync_read_present_position(ids)
    counts = arm.sync_read_raw_present_position(ids)
    check(all(abs(q - (n - 2048) * math.tau / 4096) < 2e-3 for q, n in zip(positions, counts)), "positions")
    arm.write_goal_position(1, positions[0] - 0.2)
    time.sleep(1.0)
    moved = arm.read_present_position(1)
    moved = (moved if isinstance(moved, float) else moved[0]) - positions[0]
    check(abs(moved + 0.2) < 0.01, f"moved by {moved} rad instead of -0.2")
    arm.close()
    print("rustypot: pinged, read, moved by -0.2 rad")


def sdk(port):
    """The packets themselves, by Feetech's SDK."""
    import scservo_sdk as scs

    handler = scs.PortHandler(port)
    packets = scs.PacketHandler(0)
    check(handler.openPort() and handler.setBaudRate(1_000_000), "open")
    check(packets.ping(handler, 2) == (777, 0, 0), "ping")
    check(packets.write2ByteTxRx(handler, 2, 48, 600) == (0, 0), "write")
    check(packets.read2ByteTxRx(handler, 2, 48) == (600, 0, 0), "read")
    check(packets.write2ByteTxRx(handler, 2, 48, 1000) == (0, 0), "write")
    reader = scs.GroupSyncRead(handler, packets, 56, 15)
    for id in [6, 1, 3]:
        reader.addParam(id)
    check(reader.txRxPacket() == 0, "sync read")
    check(all(reader.getData(id, 62, 1) == 74 for id in [6, 1, 3]), "sync read data")
    writer = scs.GroupSyncWrite(handler, packets, 44, 2)
    writer.addParam(1, [5, 1])
    writer.addParam(6, [6, 1])
    check(writer.txPacket() == 0, "sync write")
    check([packets.read2ByteTxRx(handler, id, 44)[0] for id in [1, 6]] == [261, 262], "sync write data")
    check(packets.ping(handler, 9)[1] != 0, "a servo that does not exist answers")
    handler.closePort()
    print("feetech-servo-sdk: ping, read, write, sync read and sync write")


def driver(pace, port, calibration, folder):
    """The driver holds the arm that LeRobot has calibrated, by LeRobot's file."""
    file = folder / "calibration.json"
    file.write_text(json.dumps({motor: dataclasses.asdict(of_motor) for motor, of_motor in calibration.items()}, indent=4))
    joints = ",".join(MOTORS[:5])
    run = subprocess.run([pace, port, str(file), "3", "100", joints], capture_output=True, text=True)
    check(run.returncode == 0, run.stderr)
    print("driver: " + run.stdout.splitlines()[1])
    # The calibration of another arm is refused.
    calibration["elbow_flex"].homing_offset += 1
    file.write_text(json.dumps({motor: dataclasses.asdict(of_motor) for motor, of_motor in calibration.items()}))
    run = subprocess.run([pace, port, str(file), "1", "100", joints], capture_output=True, text=True)
    check(run.returncode != 0 and "belongs to another arm" in run.stderr, f"another calibration: {run.stderr}")
    print("driver: refuses the calibration of another arm")


def task(folder, name):
    """Returns the file of a task of examples/so101 in a folder with the simulated port."""
    source = Path(__file__).parents[2] / "examples" / "so101"
    for file in [*source.glob("*.toml"), source / "so101.urdf"]:
        text = file.read_text().replace("#:schema", "# schema").replace("/dev/ttyACM0", str(folder / "so101"))
        (folder / file.name).write_text(text)
    return folder / f"{name}.toml"


@contextlib.contextmanager
def simulated_arm(opspace, folder, name, *options):
    """Serves the simulated arm of a task."""
    command = [opspace, "driver", "simulate", str(task(folder, name)), "--link", str(folder / "so101"), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as served:
        check(served.stdout.readline().strip() == str(folder / "so101"), "the simulated arm is not served")
        try:
            yield served
        finally:
            served.send_signal(signal.SIGINT)
            check(served.wait(10) == 0, served.stderr.read())


def whole_program(opspace, folder):
    """opspace runs a task on the simulated arm, moves it to the start of another one, and repeats what it has computed."""
    run = lambda *arguments: subprocess.run([opspace, *map(str, arguments)], capture_output=True, text=True)
    with simulated_arm(opspace, folder, "compliant-x", "--option", "latency_ms=1"):
        found = run("driver", "scan", folder / "so101")
        check(found.stdout.count("STS3215") == 5, found.stdout + found.stderr)
        # A busy machine misses cycles; it is no fault as long as the bus is not silent for two seconds.
        patient = ["--set", "robot.driver.silence_s=2.0", "--set", "robot.safety.max_dropout_s=2.0"]
        ran = run("run", folder / "compliant-x.toml", "--out", folder / "run", *patient)
        check(ran.returncode == 0, ran.stdout + ran.stderr)
        summary = json.loads((folder / "run" / "summary.json").read_text())
        hand = summary["tasks"]["hand"]
        check(hand["compliant_motion_rms_m"] > 0.015, f"compliant along x: {hand}")
        check(hand["position_rms_m"] < 0.01, f"held along y and z: {hand}")
        replayed = run("replay", folder / "run")
        check(replayed.returncode == 0 and "bit for bit" in replayed.stdout, replayed.stdout + replayed.stderr)
        print("opspace: " + next(line for line in (ran.stdout + ran.stderr).splitlines() if line.startswith("completed")))
    # Nobody pushes this one.
    with simulated_arm(opspace, folder, "press"):
        away = ["--set", "start_rad.shoulder_pan=0.3", "--move-to-start", "--duration-s", "2"]
        moved = run("run", folder / "hold-and-yield.toml", "--out", folder / "moved", *away, *patient)
        check(moved.returncode == 0, moved.stdout + moved.stderr)
        print("opspace: moved to the start of another task, and ran it")
    # A cable that is pulled.
    with simulated_arm(opspace, folder, "hold-and-yield", "--duration-s", "4") as served:
        ran = run("run", folder / "hold-and-yield.toml", "--out", folder / "gone")
        served.wait(10)
    check(ran.returncode == 1 and "port" in ran.stderr, f"cable pulled: {ran.returncode} {ran.stderr}")
    check(run("replay", folder / "gone").returncode == 0, "the run that was cut off does not replay")
    print("opspace: " + next(line for line in ran.stderr.splitlines() if "port" in line))


def wheel(opspace, folder):
    """LeRobot's bus for input and output, opspace's wheel for control: the example of the documentation."""
    try:
        import opspace as package
    except ImportError:
        print("SKIPPED: LeRobot's bus with opspace's wheel, which is not installed")
        return
    example = Path(__file__).parents[2] / "examples" / "so101" / "lerobot_control.py"
    with simulated_arm(opspace, folder, "compliant-x", "--option", "latency_ms=1"):
        begun = sys.argv
        sys.argv = [str(example), str(folder / "compliant-x.toml"), str(folder / "so101"), str(folder / "so101.json")]
        try:
            names = runpy.run_path(str(example))
        finally:
            sys.argv = begun
    error = names["loop"].signals()["hand.error"]
    check(abs(error[1]) < 0.015 and abs(error[2]) < 0.015, f"held along y and z: {error}")
    check(names["loop"].fault is None, str(names["loop"].fault))
    print(f"lerobot and the wheel of opspace {package.__version__}: {names['late']} late cycles")


def with_patience(judge, port):
    """Repeats a judge that gives up after 50 ms: on a busy machine the thread of the simulated bus may wait for longer."""
    for _ in range(4):
        try:
            return judge(port)
        except ConnectionError as error:
            print(f"once more, since the machine is busy: {error}")
    raise SystemExit(f"failed: {judge.__name__} had no answer in four attempts")


def main():
    simulated_bus, pace, opspace = sys.argv[1:]
    lerobot_registers(simulated_bus)
    rustypot_registers(simulated_bus)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        link = str(folder / "arm")
        with subprocess.Popen([simulated_bus, "--link", link], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as bus:
            check(bus.stdout.readline().decode().strip() == link, "the simulated bus does not start")
            try:
                sdk(link)
                calibration = with_patience(lerobot, link)
                rustypot(link)
                driver(pace, link, calibration, folder)
            finally:
                bus.stdin.close()
                bus.wait(10)
        check(not Path(link).is_symlink(), "the link is not removed")
        whole_program(opspace, folder)
        wheel(opspace, folder)


main()
