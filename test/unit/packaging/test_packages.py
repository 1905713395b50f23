# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The packages that ``make deps`` and the container install are those of ``package.xml``."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[3]
LISTS = ROOT / "tools" / "packages"
DEBIAN, NOETIC = "debian-12", "ubuntu-20.04"
TOOLS = set("catkin-lint cmake g++ git make python3-catkin-pkg python3-venv xvfb".split())
#: Packages that `ros-noetic-ros-base` brings, by REP 150, as far as we use them.
ROS_BASE = set(
    """bond bondpy catkin diagnostic_msgs dynamic_reconfigure genpy geometry_msgs message_filters
    message_generation message_runtime nodelet nodelet_topic_tools pluginlib rosbag roscpp
    rosgraph rosgraph_msgs roslaunch roslib rosmaster rosmsg rosnode rospy rosservice rostest
    rostopic rosunit sensor_msgs std_msgs std_srvs topic_tools""".split()
)
#: Debian's package for a key of rosdep, where it is neither the key nor `python3-` and the key.
OF_DEBIAN = {
    "compressed_image_transport": "",  # Debian does not have these three
    "rqt_gui": "",
    "rqt_gui_py": "",
    "diagnostic_aggregator": "libdiagnostic-aggregator-tools",
    "image_proc": "libimage-proc-dev",
    "image_publisher": "libimage-publisher-dev",
    "image_transport": "libimage-transport-dev",
    "nodelet_topic_tools": "libnodelet-topic-tools-dev",
    "pluginlib": "libnodeletlib-dev",
    "roscpp": "libroscpp-dev",
    "tf2_msgs": "python3-tf2-ros",
    **dict.fromkeys(("message_generation", "message_runtime"), "ros-core-dev"),
    **dict.fromkeys(("genpy", "rosgraph", "rosgraph_msgs", "roslib"), "python3-rospy"),
    **dict.fromkeys(("rosunit",), "python3-rostest"),
}
#: Packages that a key of rosdep brings on Debian beside the one above, and those for the docs.
BESIDE_DEBIAN = set(
    """image-transport-tools libdiagnostic-aggregator-dev libmessage-filters-dev libnodelet-dev
    libnodeletlib-tools libtf-dev libtf2-ros-dev python3-myst-parser python3-pyqt5.qtsvg
    python3-pytestqt rosbash rospack-tools ros-core-python-dev tf-tools""".split()
)
BESIDE_NOETIC = {"python3-pyqt5.qtsvg", "python3-recommonmark", "ros-noetic-ros-base"}


def listed(name, robot=False):
    """Packages of a list, or those that a robot needs: all before the tests."""
    text = (LISTS / name).read_text()
    if robot:
        text = text.partition("# test")[0]
    return set(re.sub("#.*", "", text).split())


def depends(*kinds):
    root = ElementTree.parse(ROOT / "package.xml").getroot()
    return {each.text for each in root if each.tag in [f"{kind}_depend" for kind in kinds]}


def packages(name, keys):
    if name == NOETIC:
        return set(map(of_noetic, keys))
    there = listed(DEBIAN)
    found = set()
    for key in keys:
        dashed = key.replace("_", "-")
        known = [each for each in (dashed, f"python3-{dashed}") if each in there]
        found.add(OF_DEBIAN[key] if key in OF_DEBIAN else (known or [dashed])[0])
    return found - {""}


def of_noetic(key):
    if key.startswith("python3-") or key in ("graphviz", "iproute2"):
        return key
    return "ros-noetic-" + ("ros-base" if key in ROS_BASE else key.replace("_", "-"))


@pytest.mark.parametrize("name", [DEBIAN, NOETIC])
class TestLists:
    def test_a_robot_has_all_that_it_runs(self, name):
        keys = depends("exec", "build", "buildtool", "build_export")
        assert packages(name, keys) - listed(name, robot=True) == set()

    def test_make_deps_installs_what_package_xml_names_and_nothing_else(self, name):
        keys = depends("exec", "build", "buildtool", "build_export", "test", "doc")
        beside = BESIDE_NOETIC if name == NOETIC else BESIDE_DEBIAN
        assert packages(name, keys) | beside | TOOLS == listed(name)


def test_the_workflow_builds_the_container_with_the_packages_of_its_base():
    jobs = yaml.safe_load((ROOT / ".github/workflows/noetic.yml").read_text())["jobs"]
    base = jobs["test"]["container"]
    (build,) = [each["run"] for each in jobs["container"]["steps"] if "-f " in each.get("run", "")]
    recipe = (ROOT / "examples/boot/Containerfile").read_text()
    given = dict(re.findall(r"--build-arg (\w+)=(\S+)", build))
    assert given == {"BASE": base, "PACKAGES": NOETIC}
    assert given == dict(re.findall(r"--build-arg (\w+)=(\S+)", recipe))
    assert set(given) == set(re.findall(r"^ARG (\w+)=", recipe, re.MULTILINE))
    assert all((ROOT / path).exists() for path in re.findall(r"-f (\S+)", build))
