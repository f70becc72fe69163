"""Every public method of ur_rtde's four interfaces, asked on the real client of a real controller process.

One row for each; a method without a row fails the suite. Kinematics and dynamics are judged by pinocchio on the robot's
data file, not by the simulator's own.
"""

import socket
import tomllib
from concurrent.futures import ThreadPoolExecutor

import pytest
from tests.ursim.cell import HOME, let_go, until, upload
from ursim.motion.arm import UR3E
from ursim.ports.launch import SimulatedController

np = pytest.importorskip("numpy")
pinocchio = pytest.importorskip("pinocchio")
rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")
rtde_io = pytest.importorskip("rtde_io", reason="ur_rtde is not installed")
dashboard_client = pytest.importorskip("dashboard_client", reason="ur_rtde is not installed")

pytestmark = [pytest.mark.e2e]

VERSION = "5.22"
STOPPED, PLAYING, PAUSED = 1, 2, 4
TURNED = [0.2, -1.4, 1.3, -1.2, -1.4, 0.3]
TOOL = [0.01, -0.02, 0.12, 0.1, 0.2, -0.3]
STILL = [0.0] * 6


# ------------------------------------------------------------------------------------------------------- second opinion


def model():
    told = tomllib.loads(UR3E.read_text())
    found, parent = pinocchio.Model(), 0
    for joint in told["joints"]:
        place = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(*joint["rpy_rad"]), np.array(joint["offset_m"]))
        parent = found.addJoint(parent, pinocchio.JointModelRZ(), place, joint["name"])
        body = pinocchio.Inertia(joint["mass_kg"], np.array(joint["com_m"]), np.diag(joint["inertia_kg_m2"]))
        found.appendBodyToJoint(parent, body, pinocchio.SE3.Identity())
    return found


MODEL = model()


def se3(pose):
    return pinocchio.SE3(pinocchio.exp3(np.array(pose[3:])), np.array(pose[:3]))


def tool_at(q, offset=STILL):
    memory = MODEL.createData()
    pinocchio.forwardKinematics(MODEL, memory, np.array(q))
    return memory.oMi[6] * se3(offset)


def same(pose, place, within=1e-6):
    return np.allclose(se3(pose).homogeneous, place.homogeneous, atol=within)


# ------------------------------------------------------------------------------------------------------------- the bench


class Clients:
    """All four interfaces on one controller; on another one after a row has failed."""

    def __init__(self, path):
        self.path, self.broken = path, False
        self.start()

    def start(self):
        self.cell = cell = SimulatedController.start(joints=HOME, version=VERSION)
        self.receive = rtde_receive.RTDEReceiveInterface(cell.host)
        self.control = rtde_control.RTDEControlInterface(cell.host)
        self.io = rtde_io.RTDEIOInterface(cell.host)
        self.dashboard = dashboard_client.DashboardClient(cell.host)
        self.dashboard.connect()

    def ready(self):
        """The arm upright and at rest, its script running, nothing set."""
        if self.broken:
            self.close()
            self.start()
        self.broken = True
        if not self.dashboard.isConnected():
            self.dashboard.connect()
        if not self.receive.isConnected():
            self.receive.reconnect()
        if not self.control.isConnected():
            self.control.reconnect()
        if self.receive.getRuntimeState() != PLAYING:
            self.dashboard.stop()
            self.control.kickWatchdog()  # clears the command register, which outlives the script
            self.control.reuploadScript()
            until(self.control.isProgramRunning)
        until(lambda: self.receive.getRuntimeState() == PLAYING)
        assert self.control.moveJ(list(HOME), 3.0, 10.0)
        until(self.still)

    def still(self):
        return self.receive.getActualQd() == STILL

    def at(self, q, within=1e-5):
        until(lambda: self.receive.getActualQ() == pytest.approx(list(q), abs=within))

    def close(self):
        let_go(self.io, self.control, self.receive)
        self.dashboard.disconnect()
        assert self.cell.stop() == 0


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    clients = Clients(tmp_path_factory.mktemp("methods"))
    yield clients
    clients.close()


ROWS = {}
CONTROL, RECEIVE, IO, DASHBOARD = "control", "receive", "io", "dashboard"
CLASSES = {
    CONTROL: rtde_control.RTDEControlInterface,
    RECEIVE: rtde_receive.RTDEReceiveInterface,
    IO: rtde_io.RTDEIOInterface,
    DASHBOARD: dashboard_client.DashboardClient,
}


def asks(interface, *methods):
    def keep(row):
        for method in methods:
            assert (interface, method) not in ROWS
            ROWS[interface, method] = row
        return row

    return keep


# ------------------------------------------------------------------------------------------------------ control: motion


@asks(CONTROL, "moveJ")
def move_in_joint_space(b):
    assert b.control.moveJ(TURNED, 2.0, 4.0)
    b.at(TURNED)
    assert b.control.moveJ([[*HOME, 2.0, 4.0, 0.0], [*TURNED, 2.0, 4.0, 0.0]])
    b.at(TURNED)


@asks(CONTROL, "moveJ_IK")
def move_in_joint_space_to_a_pose(b):
    goal = tool_at(TURNED)
    assert b.control.moveJ_IK([*goal.translation, *pinocchio.log3(goal.rotation)], 2.0, 4.0)
    until(lambda: same(b.receive.getActualTCPPose(), goal))


@asks(CONTROL, "moveL")
def move_on_a_line(b):
    pose = b.receive.getActualTCPPose()
    up = [*pose[:2], pose[2] + 0.03, *pose[3:]]
    assert b.control.moveL(up, 0.25, 1.2)
    until(lambda: b.receive.getActualTCPPose()[2] == pytest.approx(up[2], abs=1e-6))
    assert b.control.moveL([[*pose, 0.25, 1.2, 0.0]])
    until(lambda: b.receive.getActualTCPPose()[2] == pytest.approx(pose[2], abs=1e-6))


@asks(CONTROL, "moveL_FK")
def move_on_a_line_to_joint_angles(b):
    near = [q + 0.05 for q in HOME]
    assert b.control.moveL_FK(near, 0.25, 1.2)
    until(lambda: same(b.receive.getActualTCPPose(), tool_at(near)))


@asks(CONTROL, "movePath")
def move_along_a_path(b):
    path = rtde_control.Path()
    entry = rtde_control.PathEntry
    path.addEntry(entry(entry.MoveJ, entry.PositionJoints, [*TURNED, 2.0, 4.0, 0.0]))
    assert b.control.movePath(path)
    b.at(TURNED)


@asks(CONTROL, "getAsyncOperationProgress", "getAsyncOperationProgressEx", "isSteady", "getTargetWaypoint")
def a_move_under_way(b):
    goal = [0.4, *HOME[1:]]
    assert b.control.isSteady()
    before = b.control.getAsyncOperationProgressEx()
    assert not before.isAsyncOperationRunning()
    assert b.control.moveJ(goal, 0.5, 4.0, True)
    until(lambda: b.control.getAsyncOperationProgress() >= 0)
    now = b.control.getAsyncOperationProgressEx()
    assert now.isAsyncOperationRunning()
    assert now.operationId() != before.operationId()
    assert not b.control.isSteady()
    assert same(b.control.getTargetWaypoint(), tool_at(goal))
    until(lambda: b.control.getAsyncOperationProgress() < 0)
    assert b.control.isSteady()
    assert same(b.control.getTargetWaypoint(), tool_at(goal))


@asks(CONTROL, "servoJ", "servoStop")
def servo_joints(b):
    goal = [0.02, *HOME[1:]]
    assert b.control.servoJ(goal, 0.0, 0.0, 0.002, 0.05, 300)
    b.at(goal, within=1e-4)
    b.control.servoStop(8.0)
    until(b.still)


@asks(CONTROL, "servoL")
def servo_a_pose(b):
    pose = b.receive.getActualTCPPose()
    pose[2] += 0.01
    assert b.control.servoL(pose, 0.0, 0.0, 0.002, 0.05, 300)
    until(lambda: b.receive.getActualTCPPose()[2] == pytest.approx(pose[2], abs=1e-4))
    b.control.servoStop(8.0)
    until(b.still)


@asks(CONTROL, "servoC")
def servo_on_a_circle(b):
    """It arrives; what the client believes of it afterwards is a defect with a test of its own."""
    pose = b.receive.getActualTCPPose()
    goal = [pose[0] + 0.02, pose[1] - 0.01, pose[2] + 0.02, *pose[3:]]
    assert b.control.servoC(goal, 0.1, 1.0, 0.0)
    until(lambda: b.receive.getActualTCPPose()[:3] == pytest.approx(goal[:3], abs=1e-5))
    until(lambda: max(map(abs, b.receive.getActualQd())) < 1e-3)
    b.dashboard.stop()
    until(lambda: b.receive.getRuntimeState() == STOPPED)


@asks(CONTROL, "speedJ", "speedStop")
def speed_of_joints(b):
    assert b.control.speedJ([0.2, 0.0, 0.0, 0.0, 0.0, 0.0], 4.0, 0.0)
    until(lambda: b.receive.getActualQd()[0] == pytest.approx(0.2))
    b.control.speedStop(8.0)
    until(b.still)


@asks(CONTROL, "speedL")
def speed_of_the_tool(b):
    assert b.control.speedL([0.0, 0.0, 0.03, 0.0, 0.0, 0.0], 0.5, 0.0)
    until(lambda: b.receive.getActualTCPSpeed() == pytest.approx([0.0, 0.0, 0.03, 0.0, 0.0, 0.0], abs=1e-3))
    b.control.speedStop(8.0)
    until(b.still)


@asks(CONTROL, "jogStart", "jogStop")
def jog(b):
    assert b.control.jogStart([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    until(lambda: b.receive.getActualTCPSpeed()[1] == pytest.approx(0.02, abs=1e-3))
    assert b.control.jogStop()
    until(b.still)


@asks(CONTROL, "stopJ", "stopL")
def stops(b):
    for stop in (lambda: b.control.stopJ(8.0), lambda: b.control.stopL(5.0), lambda: b.control.stopJ(8.0, True)):
        assert b.control.moveJ([b.receive.getActualQ()[0] + 1.0, *HOME[1:]], 0.5, 8.0, True)
        until(lambda: b.receive.getActualQd()[0] == pytest.approx(0.5))
        stop()
        until(b.still)
    assert b.receive.getActualQ()[0] < 2.0


@asks(
    CONTROL, "moveUntilContact", "toolContact", "startContactDetection", "readContactDetection", "stopContactDetection"
)
def contact(b):
    assert b.control.startContactDetection([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert not b.control.readContactDetection()
    assert not b.control.stopContactDetection()
    with ThreadPoolExecutor() as pool:
        moving = pool.submit(b.control.moveUntilContact, [0.0, 0.0, -0.03, 0.0, 0.0, 0.0])
        until(lambda: b.receive.getActualTCPSpeed()[2] < -0.029)
        b.cell.fault("touch")
        assert moving.result(timeout=20)
    until(b.still)
    until(lambda: b.control.toolContact(STILL) > 0)
    b.cell.fault("release_touch")
    until(lambda: b.control.toolContact(STILL) == 0)
    assert b.control.startContactDetection([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    b.cell.fault("touch")
    until(b.control.readContactDetection)
    assert b.control.stopContactDetection()
    b.cell.fault("release_touch")


# ------------------------------------------------------------------------------------------- control: force and guiding


@asks(CONTROL, "forceMode", "forceModeStop", "forceModeSetDamping", "forceModeSetGainScaling", "zeroFtSensor")
def force_mode(b):
    at, z = b.receive.getActualQ(), b.receive.getActualTCPPose()[2]
    assert b.control.zeroFtSensor()
    assert b.control.forceModeSetDamping(0.1)
    assert b.control.forceModeSetGainScaling(0.5)
    assert b.control.forceMode(STILL, [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, [2.0, 2.0, 1.5, 1.0, 1.0, 1.0])
    until(lambda: b.receive.getActualTCPPose()[2] < z - 0.002)
    assert b.control.forceModeStop()
    until(b.control.isSteady)
    b.cell.fault("placed", joints_rad=at)
    assert b.receive.getActualTCPForce() == STILL


@asks(CONTROL, "freedriveMode", "endFreedriveMode", "getFreedriveStatus", "teachMode", "endTeachMode")
def guided_by_hand(b):
    at = b.receive.getActualQ()
    assert b.control.freedriveMode([1, 0, 1, 0, 0, 0])
    assert b.control.getFreedriveStatus() == 0
    assert b.control.endFreedriveMode()
    assert b.control.teachMode()
    assert b.control.endTeachMode()
    assert b.receive.getActualQ() == at


@asks(CONTROL, "enableExternalFtSensor", "ftRtdeInputEnable", "setExternalForceTorque")
def a_wrench_from_the_client(b):
    """ur_rtde sends the wrench in a package of the wrong length: it never comes, and the vendor's watchdog pauses."""
    assert b.control.ftRtdeInputEnable(False)
    assert b.control.setExternalForceTorque([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    b.control.stopJ()  # the client believes that a command is under way
    assert b.receive.getActualTCPForce() == STILL
    assert b.control.enableExternalFtSensor(True, 0.5, [0.0, 0.0, 0.0], [0.0, 0.0, 0.02])
    until(lambda: b.receive.getRuntimeState() == PAUSED)


@asks(CONTROL, "directTorque")
def direct_torque(b):
    """The script does nothing for it and waits no tick: an infinite loop ends the program."""
    assert b.control.directTorque(STILL)
    until(lambda: b.receive.getRuntimeState() == STOPPED)


# ----------------------------------------------------------------------------------------------- control: what the arm is


@asks(CONTROL, "getForwardKinematics")
def forward(b):
    assert b.control.setTcp(TOOL)
    assert same(b.control.getForwardKinematics(), tool_at(HOME, TOOL))
    assert same(
        b.control.getForwardKinematics(TURNED, TOOL[:3] + [0.0, 0.1, 0.0]), tool_at(TURNED, TOOL[:3] + [0, 0.1, 0])
    )
    assert b.control.setTcp(STILL)


@asks(CONTROL, "getInverseKinematics", "getInverseKinematicsHasSolution")
def inverse(b):
    goal = tool_at(TURNED)
    pose = [*goal.translation, *pinocchio.log3(goal.rotation)]
    assert b.control.getInverseKinematics(pose, [q + 0.1 for q in TURNED]) == pytest.approx(TURNED, abs=1e-6)
    assert same(pose, tool_at(b.control.getInverseKinematics(pose)))
    assert b.control.getInverseKinematicsHasSolution(pose)
    assert b.control.getInverseKinematicsHasSolution(pose, TURNED)
    assert not b.control.getInverseKinematicsHasSolution([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@asks(CONTROL, "getJacobian", "getJacobianTimeDerivative", "getMassMatrix")
def matrices(b):
    """They came with PolyScope 5.23; before it the client has no registers for them, and says so."""
    for ask in (b.control.getJacobian, b.control.getJacobianTimeDerivative, b.control.getMassMatrix):
        with pytest.raises(RuntimeError):
            ask()
    assert b.receive.getRuntimeState() == PLAYING


@asks(CONTROL, "getCoriolisAndCentrifugalTorques", "getTargetJointAccelerations")
def vectors(b):
    """Vectors that the script answers with the registers' old content: here that of asking for the TCP."""
    assert b.control.setTcp(TOOL)
    assert b.control.getTCPOffset() == pytest.approx(TOOL)
    assert b.control.getCoriolisAndCentrifugalTorques() == pytest.approx(TOOL)
    assert b.control.getTargetJointAccelerations() == pytest.approx(TOOL)
    assert b.control.setTcp(STILL)


@asks(CONTROL, "getActualJointPositionsHistory", "getActualToolFlangePose", "getJointTorques", "getStepTime")
def getters_without_a_wait(b):
    """The client reads before the answer is there: the first call gives what an earlier one asked for."""
    assert b.control.setTcp(TOOL)
    until(lambda: same(b.control.getActualToolFlangePose(), tool_at(HOME)))
    assert b.control.setTcp(STILL)
    until(lambda: b.control.getActualJointPositionsHistory(5) == pytest.approx(HOME))
    assert b.control.getStepTime() != 0.002
    until(lambda: b.control.getStepTime() == pytest.approx(0.002))
    # The vendor corrects these torques by what the robot itself takes, and nothing else is there.
    until(lambda: b.control.getJointTorques() == STILL)


@asks(CONTROL, "setTcp", "getTCPOffset")
def tool_centre_point(b):
    assert b.control.setTcp(TOOL)
    assert b.control.getTCPOffset() == pytest.approx(TOOL)
    until(lambda: same(b.receive.getActualTCPPose(), tool_at(HOME, TOOL)))
    assert b.control.setTcp(STILL)


@asks(CONTROL, "setPayload", "setTargetPayload")
def payload(b):
    assert b.control.setPayload(1.5, [0.0, 0.01, 0.05])
    until(lambda: b.receive.getPayload() == 1.5)
    assert b.receive.getPayloadCog() == pytest.approx([0.0, 0.01, 0.05])
    assert b.control.setTargetPayload(2.0, [0.0, 0.0, 0.08], [0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
    until(lambda: b.receive.getPayload() == 2.0)
    until(lambda: b.receive.getPayloadInertia() == pytest.approx([0.01, 0.02, 0.03, 0.001, 0.002, 0.003]))
    assert b.control.setPayload(0.0, [0.0, 0.0, 0.001])
    until(lambda: b.receive.getPayload() == 0.0)


@asks(CONTROL, "setGravity")
def gravity(b):
    upright = b.receive.getTargetMoment()
    assert b.control.setGravity([0.0, 0.0, -9.80665])
    until(lambda: b.receive.getTargetMoment()[1] == pytest.approx(-upright[1]))
    assert b.control.setGravity([0.0, 0.0, 9.80665])
    until(lambda: b.receive.getTargetMoment() == pytest.approx(upright))


@asks(CONTROL, "isPoseWithinSafetyLimits", "isJointsWithinSafetyLimits")
def safety_limits(b):
    assert b.control.isPoseWithinSafetyLimits(b.receive.getActualTCPPose())
    assert not b.control.isPoseWithinSafetyLimits([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert b.control.isJointsWithinSafetyLimits(TURNED)
    assert not b.control.isJointsWithinSafetyLimits([0.0, 0.0, 3.2, 0.0, 0.0, 0.0])


@asks(CONTROL, "poseTrans")
def poses_are_chained(b):
    assert same(
        b.control.poseTrans(TOOL, [0.1, 0.2, 0.3, 0.3, 0.2, 0.1]), se3(TOOL) * se3([0.1, 0.2, 0.3, 0.3, 0.2, 0.1])
    )


@asks(CONTROL, "getRobotStatus", "isProgramRunning", "isConnected")
def status(b):
    assert b.control.isConnected()
    until(b.control.isProgramRunning)
    assert b.control.getRobotStatus() == 0b11  # power on, program running


@asks(CONTROL, "initPeriod", "waitPeriod")
def periods(b):
    begun = b.receive.getTimestamp()
    for _ in range(100):
        b.control.waitPeriod(b.control.initPeriod())
    until(lambda: b.receive.getTimestamp() - begun >= 0.19)


# ----------------------------------------------------------------------------------------------- control: the program


@asks(CONTROL, "setWatchdog", "kickWatchdog")
def watchdog(b):
    assert b.control.setWatchdog(2.0)
    begun = b.receive.getTimestamp()

    def kept():
        b.control.kickWatchdog()
        return b.receive.getTimestamp() - begun > 1.2

    until(kept, pause_s=0.05)
    assert b.receive.getRuntimeState() == PLAYING
    until(lambda: b.receive.getRuntimeState() == STOPPED)


@asks(CONTROL, "triggerProtectiveStop")
def protective_stop(b):
    b.control.triggerProtectiveStop()
    until(b.receive.isProtectiveStopped)
    until(lambda: b.receive.getRuntimeState() == PAUSED)
    assert not b.control.moveJ(list(HOME), 1.0, 1.0)
    b.cell.fault("protective_stop_ages")
    unlock(b)


def unlock(b):
    def unlocked():
        try:
            b.dashboard.unlockProtectiveStop()
        except RuntimeError:
            return False
        return True

    until(unlocked, pause_s=0.1)
    until(lambda: not b.receive.isProtectiveStopped())


@asks(CONTROL, "stopScript", "reuploadScript")
def the_script_ends_and_comes_back(b):
    b.control.stopScript()
    until(lambda: b.receive.getRuntimeState() == STOPPED)
    assert not b.control.moveJ(TURNED, 1.0, 1.0)
    assert b.control.reuploadScript()
    until(b.control.isProgramRunning)


@asks(CONTROL, "disconnect", "reconnect")
def leave_and_come_back(b):
    b.control.disconnect()
    assert not b.control.isConnected()
    assert b.control.reconnect()
    until(b.control.isProgramRunning)


@asks(CONTROL, "sendCustomScript", "sendCustomScriptFunction", "sendCustomScriptFile")
def custom_scripts(b):
    move = "movej([{},-1.5708,1.5708,-1.5708,-1.5708,0],a=8,v=2)"
    done = "write_output_integer_register(0, 2)"
    assert b.control.sendCustomScriptFunction("there", "\t" + move.format(0.1) + "\n")
    b.at([0.1, *HOME[1:]])
    assert b.control.sendCustomScript(f"def again():\n\t{move.format(0.2)}\n\t{done}\nend\n")
    b.at([0.2, *HOME[1:]])
    file = b.path / "third.script"
    file.write_text(f"def third():\n\t{move.format(0.3)}\n\t{done}\nend\n")
    assert b.control.sendCustomScriptFile(str(file))
    b.at([0.3, *HOME[1:]])


@asks(CONTROL, "setCustomScriptFile")
def another_control_script(b):
    """The file is sent as it is, so it holds the whole program.

    It goes to a client of its own, which keeps it for good.
    """
    b.control.disconnect()
    own = rtde_control.RTDEControlInterface(b.cell.host)
    file = b.path / "own.script"
    mark = "# HEADER_END"
    file.write_text(upload(5, 22).replace(mark, f"{mark}\n\twrite_output_integer_register(12, 4711)", 1))
    own.setCustomScriptFile(str(file))
    registers = rtde_receive.RTDEReceiveInterface(b.cell.host, 125.0, ["output_int_register_12"])
    assert own.reuploadScript()
    until(lambda: registers.getOutputIntRegister(12) == 4711)
    begun = b.receive.getTimestamp()
    until(lambda: b.receive.getTimestamp() > begun + 0.2)  # what runs is the new one, and its client has heard of it
    until(own.isProgramRunning)
    assert own.moveJ(TURNED, 2.0, 4.0)
    own.disconnect()
    registers.disconnect()


# --------------------------------------------------------------------------------------------------------------- receive


@asks(RECEIVE, "getActualQ", "getTargetQ", "getActualQd", "getTargetQd", "getTargetQdd", "getActualTCPPose",
      "getTargetTCPPose", "getActualTCPSpeed", "getTargetTCPSpeed", "getTargetMoment", "getActualMomentum",
      "getTimestamp")  # fmt: skip
def a_motion_as_it_is_told(b):
    """All of one package: speeds, torques and momentum are those of pinocchio for these angles."""
    assert b.control.speedJ([0.3, -0.2, 0.25, 0.1, -0.3, 0.4], 4.0, 0.0)
    until(lambda: b.receive.getActualQd()[0] == pytest.approx(0.3))
    r = b.receive

    def package():
        found = (
            r.getTimestamp(), r.getActualQ(), r.getActualQd(), r.getTargetQdd(), r.getActualTCPPose(), r.getActualTCPSpeed(),
            r.getTargetMoment(), r.getActualMomentum(), r.getTargetQ(), r.getTargetQd(), r.getTargetTCPPose(),
            r.getTargetTCPSpeed(),
        )  # fmt: skip
        return found if r.getTimestamp() == found[0] else None

    _, q, qd, qdd, pose, speed, moment, momentum, target_q, target_qd, target_pose, target_speed = until(package)
    b.control.speedStop(8.0)
    assert (q, qd, pose, speed) == (target_q, target_qd, target_pose, target_speed)
    assert same(pose, tool_at(q))
    memory = MODEL.createData()
    jacobian = pinocchio.computeJointJacobians(MODEL, memory, np.array(q))
    del jacobian
    at_tool = pinocchio.getJointJacobian(MODEL, memory, 6, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    assert speed == pytest.approx(list(at_tool @ np.array(qd)), abs=1e-9)
    MODEL.gravity.linear = np.array([0.0, 0.0, -9.80665])
    assert moment == pytest.approx(
        list(pinocchio.rnea(MODEL, memory, np.array(q), np.array(qd), np.array(qdd))), abs=1e-9
    )
    pinocchio.computeCentroidalMomentum(MODEL, memory, np.array(q), np.array(qd))
    assert momentum == pytest.approx(np.linalg.norm(memory.hg.linear), abs=1e-9)


@asks(RECEIVE, "getActualTCPForce", "getFtRawWrench", "getActualToolAccelerometer")
def nothing_is_touched(b):
    assert b.receive.getActualTCPForce() == STILL
    assert b.receive.getFtRawWrench() == STILL
    down = tool_at(HOME).rotation.T @ np.array([0.0, 0.0, 9.80665])
    assert b.receive.getActualToolAccelerometer() == pytest.approx(list(down), abs=1e-6)


@asks(RECEIVE, "getActualCurrent", "getTargetCurrent", "getJointControlOutput", "getActualRobotCurrent",
      "getActualJointVoltage", "getActualMainVoltage", "getActualRobotVoltage", "getJointTemperatures", "getJointMode",
      "getActualExecutionTime")  # fmt: skip
def electricity(b):
    """Voltages, temperatures and modes as on an idle robot; no motor model, so no currents."""
    r = b.receive
    assert r.getActualCurrent() == r.getTargetCurrent() == r.getJointControlOutput() == STILL
    assert r.getActualJointVoltage() == [48.0] * 6
    assert (r.getActualMainVoltage(), r.getActualRobotVoltage(), r.getActualRobotCurrent()) == (48.0, 48.0, 0.0)
    assert all(20.0 < each < 60.0 for each in r.getJointTemperatures())
    assert r.getJointMode() == [253] * 6
    assert 0.0 <= r.getActualExecutionTime() < 2.0


@asks(RECEIVE, "getRobotMode", "getRobotStatus", "getRuntimeState", "getSafetyMode", "getSafetyStatusBits",
      "isProtectiveStopped", "isEmergencyStopped", "isConnected")  # fmt: skip
def modes(b):
    r = b.receive
    assert (r.getRobotMode(), r.getRobotStatus(), r.getRuntimeState()) == (7, 0b11, PLAYING)
    assert (r.getSafetyMode(), r.getSafetyStatusBits()) == (1, 1)
    assert not r.isProtectiveStopped()
    assert not r.isEmergencyStopped()
    assert r.isConnected()


@asks(RECEIVE, "getPayload", "getPayloadCog", "getPayloadInertia")
def no_payload(b):
    assert b.receive.getPayload() == 0.0
    assert len(b.receive.getPayloadCog()) == 3
    assert b.receive.getPayloadInertia() == STILL


@asks(RECEIVE, "getSpeedScaling", "getSpeedScalingCombined", "getTargetSpeedFraction")
@asks(IO, "setSpeedSlider")
def slider(b):
    r = b.receive
    assert (r.getSpeedScaling(), r.getTargetSpeedFraction()) == (1.0, 1.0)
    assert b.io.setSpeedSlider(0.5)
    until(lambda: r.getSpeedScaling() == pytest.approx(0.5))
    assert r.getTargetSpeedFraction() == pytest.approx(0.5)
    assert r.getSpeedScalingCombined() == pytest.approx(0.25)
    assert b.io.setSpeedSlider(1.0)
    until(lambda: r.getSpeedScaling() == pytest.approx(1.0))


@asks(RECEIVE, "getOutputIntRegister", "getOutputDoubleRegister")
@asks(IO, "setInputIntRegister", "setInputDoubleRegister")
def registers(b):
    """A secondary program copies what the client wrote, beside the one that runs."""
    assert b.io.setInputIntRegister(19, -7)
    assert b.io.setInputDoubleRegister(18, 2.5)
    copy = "sec copy():\n write_output_integer_register({0}, read_input_integer_register(19))\n"
    copy += " write_output_float_register({0}, read_input_float_register(18))\nend\n"
    with socket.create_connection((b.cell.host, 30003)) as script:

        def copied(register=13):
            script.sendall(copy.format(register).encode())
            told = (b.receive.getOutputIntRegister(register), b.receive.getOutputDoubleRegister(register))
            return told == (-7, 2.5)

        until(copied, pause_s=0.02)
    assert b.receive.getRuntimeState() == PLAYING


@asks(RECEIVE, "initPeriod", "waitPeriod")
def periods_of_the_receiver(b):
    begun = b.receive.getTimestamp()
    for _ in range(50):
        b.receive.waitPeriod(b.receive.initPeriod())
    until(lambda: b.receive.getTimestamp() - begun >= 0.09)


@asks(RECEIVE, "startFileRecording", "stopFileRecording")
def recording(b):
    file = b.path / "recorded.csv"
    assert b.receive.startFileRecording(str(file), ["timestamp", "actual_q"])
    begun = b.receive.getTimestamp()
    until(lambda: b.receive.getTimestamp() - begun > 0.2)
    assert b.receive.stopFileRecording()
    lines = file.read_text().splitlines()
    assert lines[0].startswith("timestamp")
    assert len(lines) > 50
    assert float(lines[5].split(",")[2]) == pytest.approx(HOME[1], abs=1e-4)


@asks(RECEIVE, "disconnect", "reconnect")
def the_receiver_leaves_and_comes_back(b):
    b.receive.disconnect()
    assert not b.receive.isConnected()
    assert b.receive.reconnect()
    assert b.receive.getActualQ() == pytest.approx(HOME)


# ----------------------------------------------------------------------------------------------------- inputs and outputs


@asks(RECEIVE, "getActualDigitalOutputBits", "getActualDigitalInputBits", "getDigitalInState", "getDigitalOutState")
@asks(IO, "setStandardDigitalOut", "setConfigurableDigitalOut", "setToolDigitalOut")
def digital(b):
    r = b.receive
    assert r.getActualDigitalInputBits() == 0
    assert not r.getDigitalInState(0)
    for ask, pin, bit in (
        (b.io.setStandardDigitalOut, 3, 3),
        (b.io.setConfigurableDigitalOut, 5, 13),
        (b.io.setToolDigitalOut, 1, 17),
    ):
        assert ask(pin, True)
        until(lambda bit=bit: r.getDigitalOutState(bit))
        assert r.getActualDigitalOutputBits() == 1 << bit
        assert ask(pin, False)
        until(lambda: r.getActualDigitalOutputBits() == 0)


@asks(
    RECEIVE,
    "getStandardAnalogInput0",
    "getStandardAnalogInput1",
    "getStandardAnalogOutput0",
    "getStandardAnalogOutput1",
)
@asks(IO, "setAnalogOutputVoltage", "setAnalogOutputCurrent")
def analog(b):
    """Volts and amperes, as the channel is told; the channel not named stays, with any sent value."""
    assert (b.receive.getStandardAnalogInput0(), b.receive.getStandardAnalogInput1()) == (0.0, 0.0)
    assert b.io.setAnalogOutputVoltage(0, 0.25)
    until(lambda: b.receive.getStandardAnalogOutput0() == pytest.approx(2.5))
    assert b.io.setAnalogOutputCurrent(1, 0.5)
    until(lambda: b.receive.getStandardAnalogOutput1() == pytest.approx(0.010))
    assert b.receive.getStandardAnalogOutput0() == pytest.approx(2.5)


@asks(IO, "isConnected", "disconnect", "reconnect")
def the_outputs_leave_and_come_back(b):
    assert b.io.isConnected()
    b.io.disconnect()
    assert not b.io.isConnected()
    assert b.io.reconnect()
    assert b.io.isConnected()


# ------------------------------------------------------------------------------------------------------------- dashboard


@asks(DASHBOARD, "connect", "disconnect", "isConnected", "quit", "send", "receive")
def the_line_itself(b):
    d = b.dashboard
    assert d.isConnected()
    d.send("robotmode\n")
    assert d.receive() == "Robotmode: RUNNING"
    d.quit()
    d.disconnect()
    assert not d.isConnected()
    d.connect()
    assert d.robotmode() == "Robotmode: RUNNING"


@asks(DASHBOARD, "getRobotModel", "getSerialNumber", "polyscopeVersion", "isInRemoteControl", "safetymode", "safetystatus",
      "getLoadedProgram", "isProgramSaved", "programState", "running")  # fmt: skip
def what_the_panel_says(b):
    d = b.dashboard
    assert d.getRobotModel() == "UR3"
    assert d.getSerialNumber().isdigit()
    assert d.polyscopeVersion().startswith("5.22.")
    assert d.isInRemoteControl()
    assert (d.safetymode(), d.safetystatus()) == ("Safetymode: NORMAL", "Safetystatus: NORMAL")
    assert d.getLoadedProgram() == "No program loaded"
    assert d.isProgramSaved() in (True, False)  # a sent program has no file; the client reads the word alone
    assert d.programState() == "PLAYING rtde_control"
    assert d.running()


@asks(DASHBOARD, "stop", "play", "pause", "loadURP")
def programs_from_the_panel(b):
    d = b.dashboard
    d.pause()
    until(lambda: b.receive.getRuntimeState() == PAUSED)
    d.play()
    until(lambda: b.receive.getRuntimeState() == PLAYING)
    d.stop()
    until(lambda: b.receive.getRuntimeState() == STOPPED)
    with pytest.raises(RuntimeError):
        d.play()
    with pytest.raises(RuntimeError):
        d.pause()
    with pytest.raises(RuntimeError):
        d.loadURP("absent.urp")


@asks(DASHBOARD, "popup", "closePopup", "closeSafetyPopup", "addToLog", "setUserRole")
def words_for_people(b):
    d = b.dashboard
    d.popup("hello")
    d.closePopup()
    d.closeSafetyPopup()
    d.addToLog("a line")
    with pytest.raises(TypeError):
        d.setUserRole(1)  # its type of argument is not bound: no Python program can call it


@asks(DASHBOARD, "powerOff", "powerOn", "brakeRelease", "robotmode")
def power(b):
    d, seen = b.dashboard, []

    def mode():
        seen.append(d.robotmode().removeprefix("Robotmode: "))
        return seen[-1]

    d.powerOff()
    until(lambda: mode() == "POWER_OFF")
    assert b.receive.getRobotStatus() & 1 == 0 or until(lambda: b.receive.getRobotStatus() & 1 == 0)
    d.powerOn()
    until(lambda: mode() == "IDLE")
    d.brakeRelease()
    until(lambda: mode() == "RUNNING")
    ladder = ["POWER_OFF", "BOOTING", "POWER_ON", "IDLE", "RUNNING"]
    assert [each for each in dict.fromkeys(seen) if each in ladder][-5:] == ladder or seen[0] == "RUNNING"


@asks(DASHBOARD, "unlockProtectiveStop")
def unlock_from_the_panel(b):
    b.dashboard.unlockProtectiveStop()  # there is none: nothing happens
    b.cell.fault("protective_stop")
    until(b.receive.isProtectiveStopped)
    with pytest.raises(RuntimeError):
        b.dashboard.unlockProtectiveStop()
    begun = b.receive.getTimestamp()
    unlock(b)
    assert b.receive.getTimestamp() - begun > 4.5  # 5 s since the stop, which was a moment earlier


@asks(DASHBOARD, "restartSafety")
def restart_safety(b):
    b.cell.fault("violation")
    until(lambda: b.receive.getSafetyMode() == 8)
    assert b.dashboard.safetystatus() == "Safetystatus: VIOLATION"
    b.dashboard.restartSafety()
    until(lambda: b.receive.getSafetyMode() == 1)
    until(lambda: b.receive.getRobotMode() == 3)
    b.dashboard.brakeRelease()
    until(lambda: b.receive.getRobotMode() == 7)


# --------------------------------------------------------------------------------------------------------------- the table


def test_a_shutdown_answers_and_ends():
    """The one method without a row: nothing is left of the controller after it."""
    with SimulatedController.start(joints=HOME) as cell:
        client = dashboard_client.DashboardClient(cell.host)
        client.connect()
        client.shutdown()
        assert cell.process.wait(10) == 0


def test_every_public_method_has_a_row():
    public = {
        (interface, name)
        for interface, cls in CLASSES.items()
        for name in dir(cls)
        if not name.startswith("_") and callable(getattr(cls, name)) and not isinstance(getattr(cls, name), type)
    }
    assert public - {(DASHBOARD, "shutdown")} == ROWS.keys()


def rows():
    return sorted({row.__name__: row for row in ROWS.values()}.items())


@pytest.mark.parametrize("row", [row for _, row in rows()], ids=[name for name, _ in rows()])
def test_it_answers_as_a_robot_would(bench, row):
    bench.ready()
    row(bench)
    bench.broken = False
