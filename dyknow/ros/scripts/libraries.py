# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Libraries of rospy in a nodelet that is written for DyKnow: in its name, and gone with it."""

from __future__ import annotations

from typing import Optional

from dyknow import names
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.importer import Importer
from dyknow.nodelet.module_files import reached_from
from dyknow.nodelet.plugins import Package
from dyknow.ros.scripts.guest import Guest
from dyknow.ros.scripts.guest_modules import DEPENDENTS, library_importer


def importer_with_libraries(context: Context, module: str, package: Package) -> Optional[Importer]:
    """Return modules of a nodelet's own if they use libraries of rospy, else None.

    The nodelet's own modules see rospy as it is. What it imports of actionlib, tf2,
    message_filters and the like acts in its name, on topics that are no ports.

    Args:
        context: the nodelet.
        module: the module of its class.
        package: what that comes with.
    """
    used = reached_from(module, package.files)
    if not DEPENDENTS.imported_by(used) - package.tops:
        return None
    guest = Guest(context.name)
    importer = library_importer(guest, package.tops, package.folders)
    guest.begin(PlainNodeHandle(context, names.parent(context.name), concurrent=True))

    def end() -> None:
        guest.shut_down("unloaded")
        guest.end_threads(frozenset(importer.files()))
        guest.run_exits()

    context.shutdown_hooks.append(end)
    context.last_hooks.append(guest.let_go)
    return importer
