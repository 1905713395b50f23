# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Configuration of the documentation; `make docs` builds it."""

import importlib.util
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import sphinx

_root = Path(__file__).resolve().parent.parent
_package = ElementTree.parse(_root / "package.xml").getroot()
sys.path[:0] = [str(_root), str(_root / "doc")]

project = "DyKnow"
author = "the DyKnow developers"
copyright = f"2026, {author}"
release = version = _package.findtext("version")

# The pages in Markdown; Ubuntu 20.04 has the older of the two.
extensions = [
    "myst_parser" if importlib.util.find_spec("myst_parser") else "recommonmark",
    "generated",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
]
exclude_patterns = ["_build"]
smartquotes_action = "q"  # in the help of a command -- is not a dash
# The types of signatures are not all described here; Ubuntu 20.04 cannot leave them out.
nitpicky = sphinx.version_info >= (4, 1)
nitpick_ignore_regex = [("py:.*", ".*")]

# The API is described without a built workspace, and without ROS on the path.
autodoc_mock_imports = [
    *("bondpy", "dyknow_msgs", "genpy", "geometry_msgs", "nodelet", "rosgraph", "roslib"),
    *("rosmaster", "rospy", "sensor_msgs", "std_msgs"),
]
autodoc_member_order = "bysource"
napoleon_use_ivar = True

html_theme = "alabaster"
html_theme_options = {
    "description": "Streams in ROS 1 that can be re-wired while everything runs",
    "page_width": "1040px",
}
