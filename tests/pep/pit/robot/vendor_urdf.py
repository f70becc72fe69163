"""URDF and outfit of a vendor's arm as its own macro would write them, out of the files in `shared/data`.

The macro is urdf/ur_macro.xacro of the same repository; its numbers are in the four files of each model.
"""

import sys
from importlib import resources

import yaml
from pep.pit.base.strict import read_table, read_toml
from pep.pit.robot.model import Model
from pep.pit.robot.outfit import Apart, Outfit
from pep.pit.robot.robot_fit import robot_fit, text_of
from tests.shared_data import SHARED

ROBOTS = resources.files("pep.pit") / "robots"
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
HALF = "1.5707963267948966"
PAYLOAD_KG = {"ur5e": 5.0, "ur10e": 12.5, "ur16e": 16.0}
"""As the vendor's data sheets state them (UR10e: 12.5 kg since 2021)."""
ACCELERATION_RAD_S2 = 40.0
"""The client's own cap (U12 in ur3e.toml); the vendor publishes none."""


class Loader(yaml.SafeLoader):
    """YAML with the vendor's tag for degrees."""


Loader.add_constructor("!degrees", lambda loader, node: float(loader.construct_scalar(node)) * 0.017453292519943295)


TURNING = tuple(
    Apart(inner, outer, "turns")
    for inner, outer in (("base", "upper_arm"), ("forearm", "wrist_2"), ("wrist_1", "wrist_3"))
)
"""Pairs with one link between them, both of whose joints turn by 360 degrees either way (joint_limits.yaml)."""


def read(model, name):
    """One of the vendor's files."""
    return yaml.load((SHARED / model / f"{name}.yaml").read_text(), Loader=Loader)  # noqa: S506 - a safe loader


def origin(xyz, rpy):
    """An origin of these numbers."""
    return f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'


def vendor_urdf(model):
    """Text of the URDF."""
    physical, meshes = read(model, "physical_parameters"), read(model, "visual_parameters")["mesh_files"]
    kinematics, limits = read(model, "default_kinematics")["kinematics"], read(model, "joint_limits")["joint_limits"]
    inertia, offsets = physical["inertia_parameters"], physical["offsets"]
    place = {
        "base": origin((0, 0, 0), (0, 0, "3.141592653589793")),
        "shoulder": origin((0, 0, 0), (0, 0, "3.141592653589793")),
        "upper_arm": origin((0, 0, offsets["shoulder_offset"]), (HALF, 0, f"-{HALF}")),
        "forearm": origin((0, 0, offsets["elbow_offset"]), (HALF, 0, f"-{HALF}")),
        "wrist_1": origin((0, 0, meshes["wrist_1"]["visual_offset"]), (HALF, 0, 0)),
        "wrist_2": origin((0, 0, meshes["wrist_2"]["visual_offset"]), (0, 0, 0)),
        "wrist_3": origin((0, 0, meshes["wrist_3"]["visual_offset"]), (HALF, 0, 0)),
    }
    parts = [f'<robot name="{model}">']
    for link in ("base", *LINKS):
        mesh = meshes[link]["collision"]["mesh"]
        shape = f'<geometry><mesh filename="package://{mesh["package"]}/{mesh["path"]}"/></geometry>'
        mass = ""
        if link != "base":
            center, turn, tensor = (inertia[k] for k in ("center_of_mass", "rotation", "tensor"))
            at, by = center[f"{link}_cog"], turn[link]
            moments = " ".join(f'{k}="{tensor[link][k]}"' for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
            mass = (
                f'<inertial><mass value="{inertia[f"{link}_mass"]}"/>'
                + origin((at["x"], at["y"], at["z"]), (by["roll"], by["pitch"], by["yaw"]))
                + f"<inertia {moments}/></inertial>"
            )
        parts.append(f'<link name="{link}"><collision>{place[link]}{shape}</collision>{mass}</link>')
    parts.append('<link name="tool0"/>')
    for joint, parent, child in zip(JOINTS, ("base", *LINKS), LINKS, strict=False):
        k, bound = kinematics[child], limits[f"{joint}_joint"]
        parts.append(
            f'<joint name="{joint}" type="revolute">'
            + origin((k["x"], k["y"], k["z"]), (k["roll"], k["pitch"], k["yaw"]))
            + f'<parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{bound["min_position"]}" upper="{bound["max_position"]}"'
            f' velocity="{bound["max_velocity"]}" effort="{bound["max_effort"]}"/></joint>'
        )
    parts.append('<joint name="flange" type="fixed"><parent link="wrist_3"/><child link="tool0"/></joint></robot>')
    return "\n".join(parts)


def shipped_tools():
    """The tools of the UR3e's file, which fit the same flange."""
    text = (ROBOTS / "ur3e.toml").read_text()
    return read_table(Model, read_toml(text)).tools


def vendor_outfit(model):
    """Outfit of it."""
    return Outfit(1, "tool0", PAYLOAD_KG[model], ACCELERATION_RAD_S2, shipped_tools(), apart=TURNING)


def refitted(model):
    """The model made again out of the vendor's files."""
    return robot_fit(vendor_urdf(model), vendor_outfit(model), SHARED)


HEADER = """\
The {title} as the physics room knows it. Every number stands beside its source.

Made by `python -m tests.pep.pit.robot.vendor_urdf {model}`: the vendor's own numbers, and capsules as `ztpm robot fit`
makes them. BSD-3-Clause, Copyright of the authors of U2.

Sources
  U2  UniversalRobots/Universal_Robots_ROS2_Description of 2024-10-14, config/{model} and urdf/ur_macro.xacro
  OUT payload limit: the vendor's data sheet; acceleration: the cap of the client (U12 in ur3e.toml); tools: those of
      ur3e.toml, whose sources stand there; they fit the same flange
  FIT capsules around the vendor's collision meshes, which are convex hulls: every point of a mesh is proven to lie in
      a capsule, and every corner 0.5 mm deep. The capsules' surface is nowhere farther from a mesh than:
{excess}
  SMP capsules of links that are no neighbours: left out are those that 20 000 random configurations found 3 mm and more
      apart, a test draws fresh ones; and those with one link between them whose joints both turn all the way round

No overhang is stated (PHY-40): between the housings of the long links a hull is more than there is.

Frames: the controller's base frame; joint k turns about the z axis of link frame k; the frame of joint 6 is the tool
flange. Units: metre, radian, second, kilogram, newton."""


def shipped_text(model):
    """Text of the model's file."""
    fit = refitted(model)
    excess = "\n".join(
        f"        {mesh.link}: {1000 * mesh.excess.most_m:.0f} mm ({mesh.file}, {len(mesh.triangles)} triangles)"
        for mesh in fit.meshes
    )
    title = model.upper().replace("E", "e")
    header = HEADER.format(title=title, model=model, excess=excess).splitlines()
    return text_of(fit, header=header, urdf="U2", outfit="OUT")


if __name__ == "__main__":
    for each in sys.argv[1:]:
        (ROBOTS / f"{each}.toml").write_text(shipped_text(each))
