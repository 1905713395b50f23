# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A nodelet with any ports, which signs its messages and reports wrong ones that it receives."""

from __future__ import annotations

import functools
import json
import os

import signatures
from std_msgs.msg import Header, String

import dyknow


class Signed(dyknow.Nodelet):
    """Publishes signed messages: one for each at its first in-port, or at a rate if it has none.

    The last messages at its in-ports name the variables in the signatures. While a variable has
    no name, or several, nothing is published.

    Parameters: ~ports (JSON, a list of name, direction and tag), ~kinds (JSON, the classes of each
    term), ~rate (Hz) and ~report, a file that gets a line for each message that meets no
    demand. A file beside it, with the ending ``mixed``, gets one for each message that is of
    another individual than the earlier ones since the last reconfiguration. With ~whole, one
    with the ending ``lost`` gets one for each gap between the numbers of a sender.
    """

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.kinds = json.loads(self.nh.get_param("~kinds"))
        self.report = self.nh.get_param("~report")
        self.rate = float(self.nh.get_param("~rate"))
        self.is_whole = self.nh.get_param("~whole", False)
        self.last = {}
        self.number = 0
        self.is_mute = False
        self.outputs = []
        self.names = {}
        self.remembered = [{}]
        self.nh.set_reconfigure_callback(self.forget)
        demands = []
        for name, direction, tag in json.loads(self.nh.get_param("~ports")):
            if direction == "out":
                self.outputs.append((self.nh.Publisher(name, Header, queue_size=1000), tag))
                continue
            receive = functools.partial(self.receive, name, tag, not demands)
            demands.append(tag)
            self.nh.Subscriber(name, Header, receive, queue_size=1000)
        if not demands:
            self.timer = self.nh.Timer(
                self.nh.Duration(1.0 / self.rate), lambda event: self.publish()
            )
        self.orders = self.node_handle.Subscriber("/orders", String, self.on_order, queue_size=100)

    def receive(self, port, tag, leads, message):
        found = signatures.signature(message)
        ways = signatures.ways(found["tags"], [tag], self.kinds)
        if not ways:
            with open(self.report, "a") as file:
                file.write(f"{self.name}.{port} demands {tag}, got {found}\n")
        self.count(found)
        self.remember(port, found, ways)
        self.names[port] = ways[0] if ways else {}
        if leads:
            self.publish()

    def count(self, found):
        before = self.last.get(found["by"], 0)
        self.last[found["by"]] = found["number"]
        is_successor = found["number"] in (1, before + 1)  # or it was loaded again
        if self.is_whole and before and not is_successor:
            with open(self.report + ".lost", "a") as file:
                file.write(f"{self.name} got {found} after number {before}\n")

    def forget(self, inputs, outputs):
        self.remembered = [{}]

    def remember(self, port, found, ways):
        together = [
            {**one, **way}
            for one in self.remembered
            for way in ways
            if all(one.get(variable, name) == name for variable, name in way.items())
        ]
        if ways and not together:
            with open(self.report + ".mixed", "a") as file:
                file.write(f"{self.name}.{port} remembers {self.remembered}, got {found}\n")
        self.remembered = [dict(pairs) for pairs in {tuple(sorted(w.items())) for w in together}]
        self.remembered = self.remembered or [{}]

    def publish(self):
        if self.is_mute:
            return
        self.number += 1
        said = {pair for names in self.names.values() for pair in names.items()}
        names = dict(said)
        for publisher, tag in self.outputs if len(names) == len(said) else ():
            tag = signatures.filled(tag, names)
            if "?" not in tag:
                publisher.publish(signatures.sign(Header(), self.name, self.number, [tag]))

    def on_order(self, message):
        name, order = message.data.split()
        if name in (self.name, "all"):
            if order == "exit":
                os._exit(3)
            self.is_mute = order == "silent"
