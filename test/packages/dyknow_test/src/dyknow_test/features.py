# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that use rospy's features for nodes, through a NodeHandle."""

from __future__ import annotations

import rospy
from std_msgs.msg import Header

from dyknow_test.puppet import Echo, Puppet


class Introspector(Puppet):
    """Reports its own names, and how its handles resolve names."""

    def describe(self):
        handles = {
            "node_handle": self.node_handle,
            "private_node_handle": self.private_node_handle,
            "mt_node_handle": self.mt_node_handle,
            "mt_private_node_handle": self.mt_private_node_handle,
            "proxy": self.nh,
        }
        return {
            "name": self.name,
            "get_name": self.nh.get_name(),
            "namespace": self.nh.get_namespace(),
            "argv": self.my_argv,
            "myargv": self.nh.myargv()[1:],
            "names": {
                label: [handle.resolve_name(name) for name in ("topic", "/topic", "~topic")]
                for label, handle in handles.items()
            },
        }

    def resolve(self, name):
        return self.nh.resolve_name(name)

    def publish_plain(self, name):
        self.publisher = self.node_handle.Publisher(name, Header, queue_size=1)
        return self.publisher.name


class Features(Puppet):
    """One method for each thing."""

    def get_param(self, *args):
        return self.nh.get_param(*args)

    def set_param(self, name, value):
        self.nh.set_param(name, value)

    def has_param(self, name):
        return self.nh.has_param(name)

    def search_param(self, name):
        return self.nh.search_param(name)

    def delete_param(self, name):
        self.nh.delete_param(name)

    def wait_for_message(self, name, timeout):
        try:
            return self.nh.wait_for_message(name, Header, timeout).seq
        except self.nh.ROSException as error:
            return f"ROSException: {error}"

    def wait_for_message_on_topic(self, topic, timeout):
        return self.node_handle.wait_for_message(topic, Header, timeout).seq

    def echo_by_proxy(self, service, number):
        self.nh.wait_for_service(service=service, timeout=5.0)
        return self.nh.ServiceProxy(name=service, service_class=Echo)(Header(seq=number)).seq

    def wait_for_service(self, service):
        rospy.loginfo("%s waits for %s", self.name, service)
        return self.interrupted(self.nh.wait_for_service, service)

    def wait_by_proxy(self, service):
        proxy = self.nh.ServiceProxy(service, Echo)
        rospy.loginfo("%s waits for %s", self.name, service)
        return self.interrupted(proxy.wait_for_service)

    def interrupted(self, wait, *args):
        try:
            wait(*args)
        except rospy.ROSInterruptException as error:
            return str(error)
        return ""

    def log_often(self):
        """Log from a loop through each kind of throttle, from two call sites each."""
        for number in range(5):
            self.nh.logwarn_once("once here %d", number)
            self.nh.logwarn_once("once there %d", number)
            self.nh.logwarn_throttle(100.0, f"seldom here {number}")
            self.nh.logwarn_throttle(100.0, f"seldom there {number}")
            self.nh.logwarn_throttle_identical(100.0, "the same")
        self.nh.logerr("plainly %s", "logged")

    def clock(self):
        return [self.nh.get_time(), self.nh.Time.now().to_sec(), self.nh.get_rostime().to_sec()]

    def sleep(self, seconds):
        """The time that passed for the nodelet while it slept."""
        start = self.nh.get_time()
        rospy.loginfo("%s sleeps", self.name)
        self.nh.sleep(self.nh.Duration(seconds))
        return self.nh.get_time() - start


class Metronome(Puppet):
    """Timers whose calls are noted, at the time of the nodelet."""

    def set_up(self):
        self.notes = []
        self.shots = 0

    def start(self, period):
        self.timer = self.nh.Timer(self.nh.Duration(period), self.note)

    def start_once(self, period):
        self.shot = self.nh.Timer(self.nh.Duration(period), self.shoot, oneshot=True)

    def note(self, event):
        self.notes.append(event)

    def shoot(self, event):
        self.shots += 1

    def count(self):
        return len(self.notes)

    def count_shots(self):
        return self.shots

    def times(self):
        return [event.current_real.to_sec() for event in self.notes]
