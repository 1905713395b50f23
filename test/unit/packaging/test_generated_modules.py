# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A package uses its own messages, services, actions and parameters, however it is built and run.

Each kind is used by a nodelet and by a script; each of those runs in a shared nodelet manager and
in a process of its own; the workspace is a devel space, an install space, or one of links.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from unit.packaging.workspaces import ROOT, Workspace

#: Additions to the package by kind: its file, and code that uses it by `ros`, rospy or a handle.
KINDS = {
    "msg": (
        "msg/Own.msg",
        "int32 number\n",
        "from my_nodelets.msg import Own\n"
        "def use(ros, name):\n"
        "    publisher = ros.Publisher(name + '/own', Own, queue_size=1)\n"
        "    publisher.publish(Own(1))\n"
        "    return publisher\n",
    ),
    "srv": (
        "srv/Ask.srv",
        "my_nodelets/Own own\n---\nint32 number\n",
        "from my_nodelets.srv import Ask, AskResponse\n"
        "def use(ros, name):\n"
        "    return ros.Service(name + '/ask', Ask, lambda request: AskResponse(1))\n",
    ),
    "action": (
        "action/OwnDo.action",
        "int32 goal\n---\nint32 result\n---\nint32 feedback\n",
        "import actionlib\n"
        "from my_nodelets.msg import OwnDoAction\n"
        "def use(ros, name):\n"
        "    return actionlib.SimpleActionServer(name + '/do', OwnDoAction, print, False)\n",
    ),
    "cfg": (
        "cfg/Own.cfg",
        "#!/usr/bin/env python3\n"
        "from dynamic_reconfigure.parameter_generator_catkin import ParameterGenerator, int_t\n"
        "generator = ParameterGenerator()\n"
        "generator.add('size', int_t, 0, 'how large', 1, 0, 9)\n"
        "exit(generator.generate('my_nodelets', 'my_nodelets', 'Own'))\n",
        "from dynamic_reconfigure.server import Server\n"
        "from my_nodelets.cfg import OwnConfig\n"
        "def use(ros, name):\n"
        "    return Server(OwnConfig, lambda config, level: config, namespace=name)\n",
    ),
}
NODELET = """
import dyknow

class Uses(dyknow.Nodelet):
    def on_init(self):
        self.used = use(dyknow.NodeHandle(self.node_handle), self.name)
"""
SCRIPT = """#!/usr/bin/env python3
import importlib, sys
import rospy
rospy.init_node('uses')
kind = rospy.myargv(sys.argv)[1]
used = importlib.import_module(f'my_nodelets.uses_{kind}').use(rospy, rospy.get_name())
rospy.spin()
"""
CMAKE = """
find_package(catkin REQUIRED COMPONENTS
  message_generation actionlib_msgs dynamic_reconfigure dyknow_msgs)
add_message_files(FILES Own.msg)
add_service_files(FILES Ask.srv)
add_action_files(FILES OwnDo.action)
generate_messages(DEPENDENCIES actionlib_msgs std_msgs)
generate_dynamic_reconfigure_options(cfg/Own.cfg)
catkin_install_python(PROGRAMS scripts/uses DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
catkin_package()
"""
DEPENDS = "message_generation actionlib_msgs dynamic_reconfigure".split()
#: Runs in a space of the workspace: spawns everything, and writes the outcome of each spawn.
DRIVER = Path(__file__).with_name("spawn_each.py")


def add_package(workspace: Workspace) -> None:
    """The skeleton with one of each kind, and a nodelet and a script that use it."""
    workspace.add_copy("my_nodelets", ROOT / "examples/skeleton")
    package = workspace.folder / "src/my_nodelets"
    classes = ""
    for kind, (name, text, use) in KINDS.items():
        file = package / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
        file.chmod(0o755)
        (package / f"src/my_nodelets/uses_{kind}.py").write_text(use + NODELET)
        classes += (
            f'<class name="my_nodelets/{kind}" type="my_nodelets.uses_{kind}.Uses"'
            ' base_class_type="dyknow.Nodelet"/>'
        )
        for label, tag, source in (
            (f"{kind}_nodelet", "<transformation>", f"my_nodelets/{kind}"),
            (f"{kind}_script", '<transformation type="node">', f"my_nodelets/uses {kind}"),
        ):
            (package / f"transformations/{label}.xml").write_text(
                f"{tag}<label>{label}</label><source>{source}</source></transformation>"
            )
    replace(package / "nodelets.xml", "</library>", f"{classes}</library>")
    script = package / "scripts/uses"
    script.parent.mkdir()
    script.write_text(SCRIPT)
    script.chmod(0o755)
    tags = "".join(f"<build_depend>{each}</build_depend>" for each in DEPENDS)
    replace(package / "package.xml", "<exec_depend>dyknow<", f"{tags}\n<exec_depend>dyknow<")
    replace(package / "CMakeLists.txt", "catkin_package()", CMAKE)


def replace(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.long
def test_what_a_package_generates_is_found_however_it_runs(tmp_path):
    workspace = Workspace(tmp_path / "ws", upon=[ROOT / "build/ws/devel"])
    add_package(workspace)
    workspace.make()
    workspace.make("install")
    linked = tmp_path / "linked"
    options = (f"-DCMAKE_INSTALL_PREFIX={linked}", "-DCATKIN_SYMLINK_INSTALL=ON")
    workspace.make("install", "--build", str(tmp_path / "build_linked"), *options)
    outcomes = {}
    for space in ("devel", "install", str(linked)):
        workspace.run_in(space, f"/usr/bin/python3 {DRIVER} {tmp_path}/home")
        outcomes[space] = json.loads((tmp_path / "home/outcomes.json").read_text())
    wanted = {
        f"{kind}_{what}{how}": "runs"
        for kind in KINDS
        for what in ("nodelet", "script")
        for how in ("", " isolated")
    }
    assert outcomes == {space: wanted for space in outcomes}
