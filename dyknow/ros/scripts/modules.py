# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The modules of scripts, and of nodelets that use libraries of rospy: copies and views."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Callable

from dyknow import names
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.loading.importer import Importer
from dyknow.nodelet.loading.module_files import Dependents, reached_from
from dyknow.ros.scripts import process_view, rospy_view
from dyknow.ros.scripts.sandbox import Sandbox, SandboxEnd

if TYPE_CHECKING:  # a script of its own does not wait for its parser
    from dyknow.nodelet.loading.plugins import Package

#: Modules of ROS that look at files and at the master alone, and DyKnow itself: the process's.
_APART = "catkin dyknow dyknow_msgs genmsg genpy numpy rosgraph roslib rospkg yaml".split()
#: The modules that need rospy.
DEPENDENTS = Dependents("rospy", _APART)
_COPIED = process_view.COPIED | {rospy_view.COPIED}


def script_importer(
    sandbox: Sandbox, script: str, given: str, init_node: Callable[..., None], package: str = ""
) -> Importer:
    """Make the importer of a script, whose siblings can be imported.

    ``given`` is the path that it was called by, in a devel space that of a relay. Modules of its
    ``package`` are copied.
    """
    own = _COPIED | ({package} - {*_APART})
    folders = [os.path.dirname(script), os.path.dirname(os.path.abspath(given))]

    importer = Importer(
        lambda name: name in own or DEPENDENTS.has(name),
        list(dict.fromkeys(folders)),
        {
            **rospy_view.rospy_views(sandbox, init_node, lambda: importer),
            **process_view.process_views(sandbox),
            **process_view.script_views(sandbox, lambda: importer),
        },
        functions=process_view.functions(sandbox, lambda: importer),
        is_alone=sandbox.is_alone,
    )
    return importer


def importer_with_libraries(context: Context, module: str, package: Package) -> Importer | None:
    """Return modules of a nodelet's own if they use libraries of rospy, else None.

    Its package and the module of its class see rospy as it is. The libraries that they import
    (actionlib, tf2, message_filters and the like) act in its name, on topics that are not ports.
    """
    used = reached_from(module, package.files)
    if not DEPENDENTS.imported_by(used) - package.tops:
        return None
    sandbox = Sandbox(context.name)

    def no_node(*args: Any, **kwds: Any) -> None:
        """Do nothing: the nodelet manager is a node already."""

    importer = Importer(
        lambda name: name in package.tops or name in _COPIED or DEPENDENTS.has(name),
        views={
            **rospy_view.rospy_views(sandbox, no_node, lambda: importer),
            **process_view.process_views(sandbox),
        },
        blind=package.tops,
        search=package.folders,
    )
    sandbox.begin(PlainNodeHandle(context, names.parent(context.name), concurrent=True))
    end = SandboxEnd(sandbox, importer.files)
    context.close_with(end)  # hooks are called for a nodelet that runs
    context.shutdown_hooks.append(end.in_order)
    context.last_hooks.append(sandbox.let_go)
    return importer
