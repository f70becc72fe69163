"""Every method of the unmodified ur_rtde, through a relay that keeps what it says: exactly the command of its call."""

import contextlib
from concurrent.futures import ThreadPoolExecutor

import pytest
from pep.rtde.command.command_table import ROWS
from pep.rtde.command.image_changes import Cleared, Commanded, Drifted, Unchanged
from pep.rtde.command.io_commands import (
    Bank,
    Quantity,
    SetAnalogOutput,
    SetDigitalOutputs,
    SetInputDouble,
    SetInputInteger,
    SetSpeedSlider,
)
from pep.rtde.robot.dashboard import stop_program
from pep.rtde.wire.recipes import Ignored, WritableVariables, control_recipes, io_recipes
from tests.pep.rtde.command.heard import hear
from tests.pep.rtde.relay import relay
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController

from pep.rtde.command import command_values as v

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_io = pytest.importorskip("rtde_io", reason="ur_rtde is not installed")

pytestmark = [pytest.mark.e2e, pytest.mark.clause("RTDE-1", "RTDE-3", "RTDE-6")]

RTDE = 30004
Q = (0.1, -1.5, 1.4, -1.3, -1.2, 0.2)
POSE = (-0.3, -0.13, 0.3, 0.1, 3.1, 0.05)
X = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)
NEAR = (*POSE[:5], 0.06)
LIMITS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
AXES = (1, 0, 1, 0, 1, 0)
SENSOR = (0.1, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6))

CALLS = [
    ("moveJ", (Q, 1.01, 1.4), v.MoveJ(Q, 1.01, 1.4, asynchronous=False)),
    ("moveJ", (HOME, 1.02, 1.3, True), v.MoveJ(HOME, 1.02, 1.3, asynchronous=True)),
    ("moveJ_IK", (POSE, 0.9, 1.3, True), v.MoveJIk(POSE, 0.9, 1.3, asynchronous=True)),
    ("moveL", (POSE, 0.2, 1.1), v.MoveL(POSE, 0.2, 1.1, asynchronous=False)),
    ("moveL_FK", (Q, 0.21, 1.2, True), v.MoveLFk(Q, 0.21, 1.2, asynchronous=True)),
    ("stopL", (9.5,), v.StopL(9.5, asynchronous=False)),
    ("stopJ", (1.9, True), v.StopJ(1.9, asynchronous=True)),
    (
        *("forceMode", (POSE, AXES, X, 2, LIMITS)),
        v.ForceMode(POSE, tuple(map(bool, AXES)), X, 2, LIMITS),
    ),
    ("forceModeStop", (), v.End(v.StopKind.FORCE_MODE)),
    ("zeroFtSensor", (), v.ZeroForceSensor()),
    ("speedJ", (X, 0.4, 0.02), v.SpeedJ(X, 0.4, 0.02)),
    ("speedStop", (9.0,), v.SpeedStop(9.0)),
    ("speedL", (X, 0.3), v.SpeedL(X, 0.3, 0.0)),
    ("speedStop", (), v.SpeedStop(10.0)),
    ("servoJ", (Q, 0.5, 0.6, 0.002, 0.1, 300.0), v.ServoJ(Q, 0.002, 0.1, 300.0)),
    ("servoStop", (8.0,), v.ServoStop(8.0)),
    ("servoL", (POSE, 0.5, 0.6, 0.004, 0.05, 400.0), v.ServoL(POSE, 0.004, 0.05, 400.0)),
    ("servoStop", (), v.ServoStop(10.0)),
    ("servoC", (POSE, 0.2, 1.0, 0.01), v.ServoC(POSE, 0.2, 1.0, 0.01)),
    ("setPayload", (0.5, (0.01, 0.02, 0.03)), v.SetPayload(0.5, (0.01, 0.02, 0.03))),
    ("teachMode", (), v.TeachMode()),
    ("endTeachMode", (), v.End(v.StopKind.TEACH_MODE)),
    ("forceModeSetDamping", (0.5,), v.SetForceDamping(0.5)),
    ("forceModeSetGainScaling", (1.5,), v.SetForceGain(1.5)),
    ("toolContact", (X,), v.ToolContact(X)),
    ("getStepTime", (), v.Read(v.Reading.STEP_TIME)),
    ("getActualJointPositionsHistory", (3,), v.JointHistory(3)),
    ("getTargetWaypoint", (), v.Read(v.Reading.TARGET_WAYPOINT)),
    ("setTcp", (X,), v.SetTcp(X)),
    ("getInverseKinematics", (POSE, Q, 1e-9, 1e-8), v.InverseKinematics(POSE, Q, 1e-9, 1e-8)),
    ("getInverseKinematics", (POSE,), v.InverseKinematicsNearest(POSE)),
    ("getInverseKinematicsHasSolution", (POSE, Q, 1e-9, 1e-8), v.Reachable(POSE, Q, 1e-9, 1e-8)),
    ("getInverseKinematicsHasSolution", (NEAR,), v.ReachableNearest(NEAR)),
    ("setWatchdog", (5.0,), v.SetWatchdog(5.0)),
    ("isPoseWithinSafetyLimits", (POSE,), v.PoseWithinLimits(POSE)),
    ("isJointsWithinSafetyLimits", (Q,), v.JointsWithinLimits(Q)),
    ("getJointTorques", (), v.Read(v.Reading.JOINT_TORQUES)),
    ("poseTrans", (POSE, X), v.PoseTrans(POSE, X)),
    ("getTCPOffset", (), v.Read(v.Reading.TCP_OFFSET)),
    ("jogStart", (X, 1, 0.6, POSE), v.JogStart(X, v.JogFrame.TOOL, 0.6, POSE)),
    ("jogStop", (), v.End(v.StopKind.JOG)),
    ("getForwardKinematics", (), v.Read(v.Reading.FORWARD_KINEMATICS)),
    ("getForwardKinematics", (Q, X), v.ForwardKinematics(Q, X)),
    ("getForwardKinematics", (Q, (0.0,) * 6), Ignored(6, 100, 52)),  # a defect of the client
    ("isSteady", (), v.Read(v.Reading.STEADY)),
    ("freedriveMode", (AXES, X), v.FreedriveMode(tuple(map(bool, AXES)), X)),
    ("endFreedriveMode", (), v.End(v.StopKind.FREEDRIVE_MODE)),
    ("getFreedriveStatus", (), v.Read(v.Reading.FREEDRIVE_STATUS)),
    ("setExternalForceTorque", (X,), Ignored(21, 52, 56)),  # a defect of the client
    ("ftRtdeInputEnable", (True, *SENSOR), v.ForceInput(True, *SENSOR)),
    ("enableExternalFtSensor", (False, *SENSOR), v.ExternalForceSensor(False, *SENSOR)),
    ("getActualToolFlangePose", (), v.Read(v.Reading.FLANGE_POSE)),
    ("setGravity", ((0.0, 1.0, 9.0),), v.SetGravity((0.0, 1.0, 9.0))),
    ("startContactDetection", (X,), v.StartContactDetection(X)),
    ("readContactDetection", (), v.Read(v.Reading.CONTACT)),
    ("stopContactDetection", (), v.StopContactDetection()),
    ("setTargetPayload", (0.5, (0.01, 0.02, 0.03), X), v.SetTargetPayload(0.5, (0.01, 0.02, 0.03), X)),
    ("directTorque", (X,), v.DirectTorque(X)),
    ("getMassMatrix", (), v.Read(v.Reading.MASS_MATRIX)),
    ("getCoriolisAndCentrifugalTorques", (), v.Read(v.Reading.CORIOLIS_TORQUES)),
    ("getTargetJointAccelerations", (), v.Read(v.Reading.TARGET_JOINT_ACCELERATIONS)),
    ("getJacobian", (), v.Read(v.Reading.JACOBIAN)),
    ("getJacobianTimeDerivative", (), v.Read(v.Reading.JACOBIAN_TIME_DERIVATIVE)),
    ("moveUntilContact", (X, Q, 1.2), v.MoveUntilContact(X, Q, 1.2)),
    ("moveJ", ([[*Q, 0.5, 0.5, 0.0]],), v.MovePath(asynchronous=False)),
    ("moveL", ([[*POSE, 0.5, 0.5, 0.0]], True), v.MovePath(asynchronous=True)),
    ("stopScript", (), v.End(v.StopKind.PROGRAM)),
    ("triggerProtectiveStop", (), v.End(v.StopKind.PROTECTIVE_STOP)),
]
BY_THEMSELVES = {"isProgramRunning", "isConnected", "reuploadScript", "reconnect", "disconnect", "kickWatchdog"}
BY_THEMSELVES |= {"initPeriod", "waitPeriod", "getAsyncOperationProgress", "getAsyncOperationProgressEx"}
BY_THEMSELVES |= {"getRobotStatus", "setCustomScriptFile", "sendCustomScript", "sendCustomScriptFile", "movePath"}
BY_THEMSELVES |= {"sendCustomScriptFunction"}


def test_every_method_and_every_id_is_tried():
    methods = {name for name in dir(rtde_control.RTDEControlInterface) if name[0].islower()}
    assert methods == {name for name, _, _ in CALLS} | BY_THEMSELVES
    tried = {type(command) for _, _, command in CALLS} | {v.Clear, v.SetExternalWrench}
    assert {row.make for row in ROWS.values()} <= tried
    for kind in (v.Reading, v.StopKind):
        assert {c.what for _, _, c in CALLS if isinstance(c, v.Read | v.End) and isinstance(c.what, kind)} == set(kind)


class Session:
    """A control interface behind a relay, and what it has said."""

    def __init__(self, robot, between, *, upper=False):
        self.robot = robot
        self.between = between
        flags = rtde_control.RTDEControlInterface.FLAG_UPLOAD_SCRIPT
        if upper:
            flags |= rtde_control.RTDEControlInterface.FLAG_UPPER_RANGE_REGISTERS
        self.control = rtde_control.RTDEControlInterface(between.host, flags=int(flags))
        self.profile = WritableVariables.of(24 if upper else 0, control=True, io=False)

    def said(self):
        return [found for said in self.between.said(RTDE) for found in hear(said, self.profile).changes]

    def call(self, name, arguments, command):
        """Bytes of a call; it is made again when the client thought that no script runs, and said nothing."""
        # There is nothing to touch, and what the robot ignores is never done: the client waits for five minutes.
        endless = isinstance(command, v.MoveUntilContact | Ignored)
        for _ in range(5):
            if not self.control.isProgramRunning():
                self.control.reuploadScript()  # in vain while a command stands that the script cannot carry out
            begun = len(self.said())
            with ThreadPoolExecutor(1) as pool:
                asked = pool.submit(self.ask, name, arguments)
                if endless:
                    until(lambda begun=begun, asked=asked: self.commanded(begun) or asked.done())
                    stop_program(self.robot)
                asked.result(60)
            # What is not waited for may still be on its way.
            with contextlib.suppress(AssertionError):
                return until(lambda begun=begun: self.commanded(begun), deadline_s=0.2)
        raise AssertionError(f"{name} is never sent")

    def ask(self, name, arguments):
        with contextlib.suppress(RuntimeError):  # some getters raise when the script has ended meanwhile
            getattr(self.control, name)(*arguments)

    def commanded(self, begun):
        found = [x for x in self.said()[begun:] if not isinstance(x, Cleared | Unchanged)]
        return [x.command if isinstance(x, Commanded | Drifted) else x for x in found]


@pytest.fixture(scope="module")
def robot():
    with SimulatedController.start(joints=HOME) as controller:
        yield controller.host


@pytest.fixture(scope="module")
def session(robot, tmp_path_factory):
    with relay(robot, tmp_path_factory.mktemp("control") / "said") as between:
        found = Session(robot, between)
        yield found
        found.control.disconnect()


@pytest.mark.parametrize(("name", "arguments", "command"), CALLS, ids=[f"{i}-{row[0]}" for i, row in enumerate(CALLS)])
def test_a_call_says_exactly_its_command(session, name, arguments, command):
    found = session.call(name, arguments, command)
    if isinstance(command, v.MovePath):
        # For a path the script is ended and sent again with the path in it.
        assert found[0] == v.End(v.StopKind.PROGRAM)
        found = found[1:]
    assert found == [command]


def test_the_client_sets_up_its_recipes_and_clears_before_anything(session):
    (said,) = session.between.said(RTDE)
    heard = hear(said, session.profile)
    assert tuple(heard.recipes) == control_recipes(0)
    assert isinstance(heard.changes[0], Unchanged)
    assert heard.outputs == []


def test_the_upper_range_says_the_same(tmp_path):
    with SimulatedController.start(joints=HOME) as controller, relay(controller.host, tmp_path / "said") as between:
        upper = Session(controller.host, between, upper=True)
        try:
            assert tuple(hear(between.said(RTDE)[0], upper.profile).recipes) == control_recipes(24)
            for name, arguments, command in CALLS:
                if (
                    name in ("moveJ", "speedJ", "speedStop", "poseTrans", "setExternalForceTorque")
                    and len(arguments) > 1
                ):
                    assert upper.call(name, arguments, command) == [command]
        finally:
            upper.control.disconnect()


IO_CALLS = [
    ("setStandardDigitalOut", (3, True), SetDigitalOutputs(Bank.STANDARD, 8, 8)),
    ("setStandardDigitalOut", (3, True), SetDigitalOutputs(Bank.STANDARD, 8, 8)),
    ("setStandardDigitalOut", (7, False), SetDigitalOutputs(Bank.STANDARD, 128, 0)),
    ("setConfigurableDigitalOut", (2, True), SetDigitalOutputs(Bank.CONFIGURABLE, 4, 4)),
    ("setToolDigitalOut", (1, True), SetDigitalOutputs(Bank.TOOL, 2, 2)),
    ("setSpeedSlider", (0.75,), SetSpeedSlider(0.75)),
    ("setAnalogOutputVoltage", (0, 0.25), SetAnalogOutput(0, Quantity.VOLTAGE, 0.25)),
    ("setAnalogOutputVoltage", (1, 0.5), SetAnalogOutput(1, Quantity.VOLTAGE, 0.5)),
    ("setAnalogOutputCurrent", (1, 0.125), SetAnalogOutput(1, Quantity.CURRENT, 0.125)),
]


@pytest.mark.parametrize("upper", [False, True])
def test_each_output_call_says_exactly_its_output(robot, tmp_path, upper):
    offset = 24 if upper else 0
    first = offset + 18
    calls = [*IO_CALLS]
    for register in range(first, first + 5):
        calls.append(("setInputIntRegister", (register, -register), SetInputInteger(register, -register)))
        calls.append(("setInputDoubleRegister", (register, 0.5), SetInputDouble(register, 0.5)))
    methods = {name for name in dir(rtde_io.RTDEIOInterface) if name[0].islower()}
    assert methods == {name for name, _, _ in calls} | {"isConnected", "reconnect", "disconnect"}
    profile = WritableVariables.of(offset, control=False, io=True)
    with relay(robot, tmp_path / "said") as between:
        client = rtde_io.RTDEIOInterface(between.host, False, upper)
        try:
            for name, arguments, _ in calls:
                assert getattr(client, name)(*arguments)
            wanted = [output for _, _, output in calls]
            until(lambda: len(hear(between.said(RTDE)[0], profile).outputs) >= len(wanted), deadline_s=2.0)
        finally:
            client.disconnect()
        heard = hear(between.said(RTDE)[0], profile)
        assert heard.outputs == wanted
        assert tuple(heard.recipes) == io_recipes(offset)
