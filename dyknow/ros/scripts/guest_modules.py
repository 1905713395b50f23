# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The modules of guests: which are copied, and which views take the place of others."""

from __future__ import annotations

import os
from typing import Callable, Collection, List

from dyknow.nodelet.importer import Importer, Module
from dyknow.nodelet.module_files import Dependents
from dyknow.ros.scripts import process_view, rospy_view
from dyknow.ros.scripts.guest import Guest

#: The modules that need rospy. Those beside it look at files and at the master alone, and DyKnow
#: itself is the process's.
DEPENDENTS = Dependents(
    "rospy",
    "catkin dyknow dyknow_msgs genmsg genpy numpy rosgraph roslib rospkg yaml".split(),
)
_COPIED = process_view.COPIED | {rospy_view.COPIED}


def script_importer(guest: Guest, folders: List[str], init_node: Callable[..., None]) -> Importer:
    """Make the importer of a script.

    Args:
        guest: the script.
        folders: where its siblings are.
        init_node: is called as ``rospy.init_node``.
    """

    def itself() -> Importer:
        return importer

    def timer() -> Module:
        return importer.import_module(rospy_view.COPIED)

    importer = Importer(
        lambda name: name in _COPIED or DEPENDENTS.has(name),
        folders,
        {
            **rospy_view.rospy_views(guest, init_node, timer),
            **process_view.process_views(guest),
            **process_view.script_views(guest, itself),
        },
        functions=process_view.functions(guest),
        is_alone=guest.is_alone,
    )
    return importer


def library_importer(guest: Guest, package: Collection[str], folders: List[str]) -> Importer:
    """Make the importer of a nodelet that uses libraries of rospy.

    Args:
        guest: the libraries.
        package: top-level names of the nodelet's own modules, which see rospy as it is.
        folders: where they are, if that is not on ``sys.path``.
    """

    def no_node(*args: object, **kwds: object) -> None:
        """Do nothing: the nodelet manager is a node already."""

    def timer() -> Module:
        return importer.import_module(rospy_view.COPIED)

    importer = Importer(
        lambda name: name in package or name in _COPIED or DEPENDENTS.has(name),
        views={
            **rospy_view.rospy_views(guest, no_node, timer),
            **process_view.process_views(guest),
        },
        blind=package,
        search=folders,
    )
    return importer


def folders_of(script: str, given: str) -> List[str]:
    """Return where the siblings of a script are searched.

    Args:
        script: its file.
        given: the path that it was called by, in a devel space that of a relay.
    """
    folders = [os.path.dirname(script), os.path.dirname(os.path.abspath(given))]
    return list(dict.fromkeys(folders))
