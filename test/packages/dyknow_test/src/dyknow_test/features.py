# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that use what rospy offers a node, through a NodeHandle."""

from __future__ import annotations

import threading
import time

import rospy
from std_msgs.msg import Header

from dyknow_test.puppet import Echo, Gate, Puppet


class Introspector(Puppet):
    """Tells what it is called and where its names lead."""

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

    def params_by_keyword(self, name):
        """What a parameter is after each step, with all arguments named as in rospy."""
        seen = [self.nh.get_param(param_name=name, default="none")]
        self.nh.set_param(param_name=name, param_value=3)
        seen += [self.nh.get_param(param_name=name), self.nh.has_param(param_name=name)]
        seen.append(self.nh.search_param(param_name=name.strip("~")))
        self.nh.delete_param(param_name=name)
        return [*seen, self.nh.has_param(param_name=name)]

    def missing_param(self, name):
        """What asking for a parameter that is not there raises."""
        try:
            return self.nh.get_param(name)
        except KeyError as error:
            return f"KeyError: {error}"

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

    def missing_service(self, service):
        try:
            self.nh.wait_for_service(service, 0.1)
        except self.nh.ROSException as error:
            return str(error)
        return ""

    def wait_for_service(self, service):
        rospy.loginfo("%s waits for %s", self.name, service)
        try:
            self.nh.wait_for_service(service)
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

    def rate(self, hertz, turns):
        """Seconds that so many turns of a Rate take."""
        rate = self.nh.Rate(hertz)
        start = time.monotonic()
        for _ in range(turns):
            rate.sleep()
        return time.monotonic() - start

    def clock(self):
        return [self.nh.get_time(), self.nh.Time.now().to_sec(), self.nh.get_rostime().to_sec()]

    def sleep(self, seconds):
        """The time that passed for the nodelet while it slept."""
        start = self.nh.get_time()
        self.nh.sleep(self.nh.Duration(seconds))
        return self.nh.get_time() - start

    def log_at_the_end(self):
        self.nh.on_shutdown(lambda: rospy.loginfo("%s: the hook is called", self.name))

    def refused(self, name):
        try:
            getattr(self.nh, name)
        except AttributeError as error:
            return str(error)
        return ""


class Strand(Puppet):
    """Subscribers, timers, services and reconfigurations that note whether they ever overlap."""

    def set_up(self):
        concurrent = self.nh.get_param("~concurrent", False)
        handle = self.mt_node_handle if concurrent else self.node_handle
        self.gate = Gate()
        self.lock = threading.Lock()
        self.inside = self.most = 0
        self.calls = {"a": [], "b": [], "timer": [], "service": []}
        self.things = [
            handle.Subscriber("a", Header, lambda message: self.work("a", message.seq)),
            handle.Subscriber("b", Header, lambda message: self.work("b", message.seq)),
            handle.Service("~service", Echo, self.serve),
        ]
        self.handle = handle
        self.nh.Subscriber("in", Header, lambda message: None)
        self.nh.set_reconfigure_callback(lambda inputs, outputs: self.work("timer", 0))

    def start_timer(self, period):
        self.timer = self.handle.Timer(rospy.Duration(period), lambda event: self.work("timer", 0))

    def stop_timer(self):
        self.timer.shutdown()

    def serve(self, request):
        self.work("service", request.seq)
        return request

    def work(self, who, number):
        with self.lock:
            self.inside += 1
            self.most = max(self.most, self.inside)
        self.gate.pass_through()
        time.sleep(0)  # lets other threads in, so that an overlap would show
        self.calls[who].append(number)
        with self.lock:
            self.inside -= 1

    def hold(self):
        self.gate.close()

    def let_go(self):
        self.gate.open()

    def counts(self):
        return {who: len(numbers) for who, numbers in self.calls.items()}

    def numbers(self, who):
        return self.calls[who]

    def now_inside(self):
        return self.inside

    def most_inside(self):
        return self.most


class Metronome(Puppet):
    """Timers whose calls are noted, at the time of the nodelet."""

    def set_up(self):
        self.notes = []
        self.shots = 0

    def start(self, period):
        self.timer = self.nh.Timer(self.nh.Duration(period), self.note)

    def start_once(self, period):
        self.shot = self.nh.Timer(self.nh.Duration(period), self.shoot, oneshot=True)

    def stop(self):
        self.timer.shutdown()

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

    def events(self):
        """Due, real and last real time of each call and the duration of the one before."""
        return [
            [
                event.current_expected.to_sec(),
                event.current_real.to_sec(),
                event.last_real and event.last_real.to_sec(),
                event.last_duration,
            ]
            for event in self.notes
        ]
