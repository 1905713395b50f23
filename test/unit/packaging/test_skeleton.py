# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The package to begin with, built in a workspace of its own; its tests pass there."""

from __future__ import annotations

from unit.packaging.workspaces import ROOT, Workspace


def test_the_skeleton_builds_passes_its_tests_and_installs(tmp_path):
    workspace = Workspace(tmp_path / "ws", upon=[ROOT / "build/ws/devel"])
    workspace.add_copy("my_nodelets", ROOT / "examples/skeleton")
    workspace.make("run_tests")
    assert "2 tests, 0 errors, 0 failures" in workspace.test_results()
    workspace.make("install")
    for space in ("devel", "install"):
        workspace.run_in(space, "dyknow check $(rospack find my_nodelets)/transformations/*.xml")
        declared = workspace.run_in(space, "rospack plugins --attrib=plugin dyknow")
        assert "my_nodelets" in declared
