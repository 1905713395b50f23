# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow/Formula: the verdicts of a formula are a stream."""

from __future__ import annotations

from functools import partial
from typing import Any, Iterable

from dyknow_msgs.msg import Verdict as VerdictMessage
from genpy import Time

import dyknow
from dyknow.formulas import Verdict, parse
from dyknow.ros.client import ManagerClient
from dyknow.ros.formulas.individuals import IndividualStreams, tags_of_individuals, take_waiting
from dyknow.ros.formulas.message_types import check, usual_delay
from dyknow.ros.parameters import PrivateParameters, get_datatype


class FormulaNodelet(dyknow.Nodelet):
    """Publishes the verdict of a formula about each state of its in-ports.

    Ports:
        each port that the formula reads: any type.
        holds: dyknow_msgs/Verdict, latched.

    Parameters:
        ~formula (string): the formula.
        ~datatypes (yaml, {}): ROS types of the in-ports, by name; std_msgs/Bool by default.
        ~out (string, holds): name of the out-port.
        ~period, ~delay (double, 0.1): seconds between two states, and for which they stay open.
            With verdicts at an in-port ~delay is 0.5; they come after their states by the delay
            of their supplier. Of one that looks ahead it has to be longer than the bounds.
        ~hold (double, 0): seconds for which a message has a value; 0: until the next one comes.
        ~exact (bool, false), ~max_nodes (int, 1000): reason with all that is unknown.
        ~individuals (yaml, {}): tags of the ports below a quantifier, by name, as
            ``Image(?c: Camera)``. Their streams are acquired for each individual.
        ~manager (string, dyknow_manager): the manager that knows the individuals.
    """

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        given = PrivateParameters(self.nh.get_param("~", {}))
        seconds = partial(given.number, expected="seconds", fits=lambda value: True)
        formula = parse(given.string("formula"))
        types = {
            port: get_datatype(self.nh, f"~datatypes/{port}", "std_msgs/Bool")
            for port in formula.ports
        }
        datatypes = {port: kind._type for port, kind in types.items()}
        self.monitor = formula.monitor(
            seconds("period", 0.1),
            seconds("hold", 0.0) or None,
            seconds("delay", usual_delay(datatypes.values())),
            given.flag("exact"),
            given.integer("max_nodes", 1000),
        )
        check(formula, datatypes)
        tags = tags_of_individuals(formula, given.texts("individuals", "tags by port"))
        self.out = given.string("out", "holds")
        self.pub = self.publisher()
        self.nh.set_reconfigure_callback(self.on_reconfigure)
        #: The topics of the in-ports.
        self.inputs = {
            port: self.nh.Subscriber(
                port, types[port], partial(self.on_message, port, ""), queue_size=100
            ).name
            for port in formula.ports
            if port not in tags
        }
        self.individuals: IndividualStreams | None = None
        #: The last message of each port, of an individual, that the monitor has not received.
        self.waiting: dict[tuple[str, str], Any] = {}
        self.late = 0
        if tags:
            client = ManagerClient(given.string("manager", "dyknow_manager"), self.name)
            self.individuals = IndividualStreams(client, tags, types, self.subscribe, self.name)
        self.timer = self.nh.Timer(self.nh.Duration(self.wait()), self.on_timer, oneshot=True)

    def on_shutdown(self) -> None:
        """Give the streams of individuals up."""
        if self.individuals is not None:
            self.individuals.close()

    def subscribe(self, port: str, individual: str, topic: str, message_class: Any) -> Any:
        """Receive the stream of an individual."""
        self.waiting.pop((port, individual), None)  # of its last stream
        callback = partial(self.on_message, port, individual)
        return self.node_handle.Subscriber(topic, message_class, callback, queue_size=100)

    def publisher(self) -> Any:
        """Return a publisher of verdicts without a latched one."""
        return self.nh.Publisher(self.out, VerdictMessage, latch=True, queue_size=100)

    def on_reconfigure(self, inputs: dict[str, str], outputs: dict[str, str]) -> None:
        """Forget what came to ports that are disconnected.

        The manager disconnects a port before it connects the stream of another individual. It
        connects another supplier of the same one directly: then the history goes on.
        """
        left = [port for port, topic in self.inputs.items() if topic and not inputs[port]]
        self.inputs = inputs
        if left:
            for port in left:
                self.waiting.pop((port, ""), None)
            self.monitor.forget(left)
            self.pub.unregister()
            self.pub = self.publisher()

    def on_message(self, port: str, individual: str, message: Any) -> None:
        """Publish the verdicts that the message decides."""
        self.waiting[port, individual] = message
        self.take(self.nh.Time.now())
        if self.monitor.late > self.late:
            self.late = self.monitor.late
            self.nh.logwarn_throttle(
                60.0,
                "%s: a message of port %s came more than ~delay after its stamp, too late for its "
                "state; such messages are ignored, %d so far",
                self.name,
                port,
                self.late,
            )

    def on_timer(self, event: Any) -> None:
        """Close the states that are due."""
        try:
            now = self.nh.Time.now()
            if self.take(now):
                self.publish(self.monitor.advance(now))
        finally:
            wait = self.nh.Duration(self.wait())
            self.timer = self.nh.Timer(wait, self.on_timer, oneshot=True)

    def take(self, now: Any) -> bool:
        """Take present individuals, and messages; False while individuals or time are awaited."""
        present = {} if self.individuals is None else self.individuals.present()
        if present is None or not now:
            return False
        self.publish(take_waiting(self.monitor, self.waiting, present, now))
        return True

    def wait(self) -> float:
        """Return the seconds until a state closes that no message has closed."""
        due = self.monitor.due
        return max(0.02, 0.1 if due is None else due - self.nh.get_time())

    def publish(self, verdicts: Iterable[Verdict]) -> None:
        for verdict in verdicts:
            message = VerdictMessage(value=verdict.value, why=verdict.why)
            message.header.stamp = Time(0, verdict.stamp)
            message.since = Time(0, verdict.since)
            self.pub.publish(message)
