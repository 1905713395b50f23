# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers, DyKnow's two and the stock C++ one, as processes of a measurement."""

from __future__ import annotations

import sys
from typing import Any, Dict, Mapping, Optional, Sequence

import rospy
from nodelet.srv import NodeletList, NodeletLoad, NodeletUnload

from dyknow_benchmark.session import START_PATIENCE, MeasurementFailed, Session, executable


class RunningManager:
    """A nodelet manager that runs; both kinds have the same services."""

    def __init__(self, session: Session, name: str, pid: int) -> None:
        """Wait for the services of a manager that was started."""
        self.name = name
        self.pid = pid
        self._load = rospy.ServiceProxy(f"{name}/load_nodelet", NodeletLoad, persistent=True)
        self._unload = rospy.ServiceProxy(f"{name}/unload_nodelet", NodeletUnload, persistent=True)
        self._list = rospy.ServiceProxy(f"{name}/list", NodeletList)
        for service in (self._load, self._unload, self._list):
            try:
                service.wait_for_service(START_PATIENCE)
            except rospy.ROSException as error:
                session.check()
                raise MeasurementFailed(f"{name} offers no services: {error}") from error

    @classmethod
    def python(cls, session: Session, name: str = "/dyknow_manager_process") -> RunningManager:
        """Start DyKnow's."""
        script = executable("dyknow", "nodelet_manager")
        process = session.start([sys.executable, script, f"__name:={name[1:]}"])
        return cls(session, name, process.pid)

    @classmethod
    def cpp(cls, session: Session, name: str = "/cpp_manager_process") -> RunningManager:
        """Start the stock one."""
        program = executable("nodelet", "nodelet")
        process = session.start([program, "manager", f"__name:={name[1:]}"])
        return cls(session, name, process.pid)

    @classmethod
    def cpp_live(cls, session: Session, name: str = "/cpp_live_manager_process") -> RunningManager:
        """Start DyKnow's in C++, whose nodelets have live ports."""
        program = executable("dyknow", "cpp_nodelet_manager")
        process = session.start([program, f"__name:={name[1:]}"])
        return cls(session, name, process.pid)

    def load(
        self,
        name: str,
        type_name: str,
        remappings: Optional[Mapping[str, str]] = None,
        parameters: Optional[Dict[str, Any]] = None,
        my_argv: Sequence[str] = (),
    ) -> None:
        """Set a nodelet's private parameters and load it; all names are global."""
        if parameters:
            rospy.set_param(name, parameters)
        pairs = dict(remappings or {})
        try:
            self._load(name, type_name, list(pairs), list(pairs.values()), list(my_argv), "")
        except rospy.ServiceException as error:
            raise MeasurementFailed(f"cannot load {name} of type {type_name}: {error}") from error

    def unload(self, name: str) -> None:
        """Unload a nodelet."""
        try:
            self._unload(name)
        except rospy.ServiceException as error:
            raise MeasurementFailed(f"cannot unload {name}: {error}") from error
