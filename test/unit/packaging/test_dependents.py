# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Packages that depend on DyKnow find its messages: C++, Python, and messages of their own.

So does the package to begin with, whose tests pass.
"""

from __future__ import annotations

import pytest
from unit.packaging.workspaces import ROOT, Workspace


def test_a_package_that_depends_on_dyknow_alone_and_the_skeleton(tmp_path):
    """In a workspace of their own, on top of the one that DyKnow was built in."""
    workspace = Workspace(tmp_path / "ws", upon=[ROOT / "build/ws/devel"])
    workspace.add_copy("my_nodelets", ROOT / "examples/skeleton")
    workspace.add_user("user", "dyknow")
    workspace.make("run_tests")
    workspace.make("install")
    assert "2 tests, 0 errors, 0 failures" in workspace.test_results()
    for space in ("devel", "install"):
        workspace.check_user("user", space)
        workspace.run_in(space, "dyknow check $(rospack find my_nodelets)/transformations/*.xml")
        declared = workspace.run_in(space, "rospack plugins --attrib=plugin dyknow")
        assert "my_nodelets" in declared


@pytest.mark.long
def test_in_one_workspace_and_from_an_install_space(tmp_path):
    one = Workspace(tmp_path / "one")
    one.add_dyknow()
    one.add_user("a_user", "dyknow")  # by name before it, so the order is that of dependencies
    one.add_user("z_user", "dyknow", "dyknow_msgs")
    one.make_and_check("a_user", "z_user")

    upon = Workspace(tmp_path / "upon", upon=[tmp_path / "one" / "install"])
    upon.add_user("by_dyknow", "dyknow")
    upon.add_user("by_messages", "dyknow_msgs")
    upon.add_copy("dyknow_cpp_example", ROOT / "examples" / "dyknow_cpp_example")
    upon.make()
    for name in ("by_dyknow", "by_messages"):
        upon.check_user(name, "devel")
    plugins = upon.run_in("devel", "rospack plugins --attrib=plugin nodelet")
    assert "dyknow_cpp_example" in plugins
    load = "import ctypes; ctypes.CDLL('devel/lib/libdyknow_cpp_example.so')"
    upon.run_in("devel", f'/usr/bin/python3 -c "{load}"')


@pytest.mark.long
def test_a_package_that_names_the_messages_alone(tmp_path):
    """The nested package has to be linked beside dyknow, or no crawl finds it."""
    workspace = Workspace(tmp_path / "ws")
    workspace.add_dyknow()
    workspace.link_messages()
    workspace.add_user("a_user", "dyknow_msgs")
    workspace.add_user("z_user", "dyknow")
    workspace.make_and_check("a_user", "z_user")
