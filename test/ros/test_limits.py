#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Every text that a service takes has a limit, and refused texts are not logged in full."""

from __future__ import annotations

import rospy
import rostest
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import (
    AcquireStream,
    AddTransformation,
    Destroy,
    FindBindings,
    ReleaseStream,
    RemoveTransformation,
    RenewStream,
    ReplanStream,
    SetConfig,
    SetProtection,
    Spawn,
)
from manager_suite import CHILD, MANAGER, ManagerCase, eventually
from nodelet.srv import NodeletLoad, NodeletUnload

LONG = "x" * 2**20
SERVICES = {
    "add_transformation": AddTransformation,
    "remove_transformation": RemoveTransformation,
    "spawn": Spawn,
    "destroy": Destroy,
    "set_protection": SetProtection,
    "acquire_stream": AcquireStream,
    "release_stream": ReleaseStream,
    "renew_stream": RenewStream,
    "replan_stream": ReplanStream,
    "find_bindings": FindBindings,
}
#: Specifications may be long: they have their own limits.
UNLIMITED = ("specification",)


def too_long(service_class):
    """Requests, each with one text that is too long, or one array with too many entries."""
    request_class = service_class._request_class
    for field, kind in zip(request_class.__slots__, request_class._slot_types):
        if field in UNLIMITED:
            continue
        if kind == "string":
            yield field, request_class(**{field: LONG})
        elif kind == "string[]":
            yield field, request_class(**{field: [LONG]})
            yield f"{field}, many", request_class(**{field: ["x"] * 5000})
        elif kind == "dyknow_msgs/PortConfig[]":
            yield f"{field}, ports", request_class(**{field: [PortConfig(LONG, "")]})
            yield f"{field}, topics", request_class(**{field: [PortConfig("in", LONG)]})
            yield f"{field}, many", request_class(**{field: [PortConfig("in", "")] * 5000})


class LimitsTest(ManagerCase):
    def test_what_is_too_long_is_refused_and_not_logged(self):
        manager = self.started()
        manager.client.spawn("relay", "/relay")
        for name, service_class in SERVICES.items():
            call = rospy.ServiceProxy(f"{MANAGER}/{name}", service_class)
            self.check(call, service_class)
        call = rospy.ServiceProxy("/relay/set_config", SetConfig)
        self.check(call, SetConfig)
        for name, service_class in {
            "load_nodelet": NodeletLoad,
            "unload_nodelet": NodeletUnload,
        }.items():
            call = rospy.ServiceProxy(f"{CHILD}/{name}", service_class)
            for field, request in too_long(service_class):
                with self.subTest(name, field=field):
                    with self.assertRaises(rospy.ServiceException) as caught:
                        call(request)
                    self.assertIn("too many", str(caught.exception)[:200])
        answer = rospy.ServiceProxy(f"{MANAGER}/add_transformation", AddTransformation)(LONG)
        self.assertFalse(answer.success)
        self.assertLess(len(answer.message), 1000)

        # The log has the last refusals, by the manager and by its nodelet manager.
        self.assertIn("adding transformations for", manager.output)
        eventually(lambda: "Failed to unload nodelet" in manager.output, 10.0, "the child's log")
        self.assertLess(max(map(len, manager.output.splitlines())), 10_000)

    def check(self, call, service_class):
        for field, request in too_long(service_class):
            with self.subTest(call.resolved_name, field=field):
                answer = call(request)
                self.assertFalse(answer.success)
                self.assertIn("too many", answer.message[:200])


if __name__ == "__main__":
    rospy.init_node("limits_test")
    rostest.rosrun("dyknow", "limits", "__main__")
