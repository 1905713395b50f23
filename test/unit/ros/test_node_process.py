# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes that are killed, or lose their ROS master, while they start."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: A master that agrees to everything.
MASTER = """
import functools, os, sys, threading, time
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCServer

master = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
master.register_function(lambda *words: (1, "", []), "any")
dispatch = master._dispatch
master._dispatch = lambda method, words: dispatch(method if method in own else "any", words)
own = set()
threading.Thread(target=master.serve_forever, daemon=True).start()
os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{master.server_address[1]}"

import rospy
"""
#: A `rosnode kill` that has begun when the node is initialised.
KILL = (
    MASTER
    + """
def kill():
    node = ServerProxy(rospy.get_node_uri())
    threading.Thread(target=node.shutdown, args=("/rosnode", "by a user"), daemon=True).start()
    while not rospy.core.is_shutdown_requested():
        time.sleep(0.01)

rospy.on_shutdown(lambda: time.sleep(0.5))  # the start goes on meanwhile
original = rospy.init_node

@functools.wraps(original)
def init_node(*words, **options):
    original(*words, **options)
    kill()

rospy.init_node = init_node
"""
)
NODE = """
from dyknow.ros.process.node_process import NodeProcess

class Runs:
    def close(self):
        print("closed while rospy works:", not rospy.is_shutdown())

sys.exit(NodeProcess("node", ["node"], Runs).run())
"""
LOAD = """
from dyknow.ros.nodelets.nodelet_client import run_load

sys.exit(run_load("nodelet", "any/Type", "manager", [], True, ["nodelet"]))
"""
SCRIPT = """
from dyknow.ros.nodelets.script_process import main

with open("script.py", "w") as file:
    file.write("import rospy\\nrospy.init_node('script')\\nrospy.spin()\\nprint('over')")
sys.exit(main(["script.py"]))
"""
SHUT_DOWN = """
from dyknow.ros.nodelets.script_process import main

text = "rospy.init_node('script')\\nrospy.signal_shutdown('enough')\\nprint('over')"
with open("script.py", "w") as file:
    file.write("import rospy\\n" + text)
sys.exit(main(["script.py"]))
"""
WOKEN = """
from rospy.impl.registration import RegManager
from dyknow.ros.process.node_process import NodeProcess

class Told(threading.Condition):
    def notify_all(self):
        print("woken at the end:", rospy.is_shutdown())
        super().notify_all()

    notifyAll = notify_all

def begin(manager, handler, begin=RegManager.__init__):
    begin(manager, handler)
    manager.cond = Told()

class Runs:
    def close(self):
        pass

RegManager.__init__ = begin
sys.exit(NodeProcess("node", ["node"], Runs).run())
"""


#: The process ends while another thread is just about to tell the master.
WITHDRAWN = """
from rospy.impl.registration import RegistrationListeners
from std_msgs.msg import Empty
from dyknow.ros.process.node_process import NodeProcess

begun = threading.Event()

def withdraw(*words):
    print("withdrawn", flush=True)
    return 1, "", 1

own.add("unregisterPublisher")
master.register_function(withdraw, "unregisterPublisher")

def notify(listeners, *words, notify=RegistrationListeners.notify_removed):
    begun.set()
    time.sleep(0.5)
    notify(listeners, *words)

RegistrationListeners.notify_removed = notify

class Runs:
    def __init__(self):
        self.publisher = rospy.Publisher("words", Empty, queue_size=1)
        process.end()

    def close(self):
        threading.Thread(target=self.publisher.unregister, daemon=True).start()
        begun.wait()

process = NodeProcess("node", ["node"], Runs)
sys.exit(process.run())
"""
LOST = """
def lose_master():
    master.shutdown()
    master.server_close()
    threading.Thread(target=after_that, daemon=True).start()

from dyknow.ros.process.node_process import NodeProcess

class Runs:
    def close(self):
        pass

def start():
    begun = os.path.exists("begun")
    print("started" + " at last" * begun)
    if not begun:
        open("begun", "w").close()
        lose_master()
        rospy.get_param("~anything", None)
    process.end()
    return Runs()

process = NodeProcess("node", ["node"], start)
sys.exit(process.run())
"""


@pytest.mark.parametrize(
    ("code", "status", "printed"),
    [
        pytest.param(NODE, 0, "closed while rospy works: True", id="node"),
        pytest.param(LOAD, 130, "Loading nodelet", id="load"),
        pytest.param(SCRIPT, 0, "over", id="script"),
        pytest.param(WOKEN, 0, "woken at the end: True", id="woken"),
    ],
)
def test_a_node_that_is_killed_while_it_starts_ends_in_order(tmp_path, code, status, printed):
    ended, lines = ends(tmp_path, KILL + code)
    assert ended == status
    assert any(printed in line for line in lines), lines


def test_the_end_waits_for_what_other_threads_withdraw(tmp_path):
    assert ends(tmp_path, MASTER + WITHDRAWN) == (0, ["withdrawn", ""])


def test_a_script_that_shuts_its_node_down_does_not_log_dyknow(tmp_path):
    assert ends(tmp_path, MASTER + SHUT_DOWN) == (0, ["over", ""])


#: The master comes back at its address, or the node is told to end.
BACK = """
def after_that():
    time.sleep(0.6)
    next_master = SimpleXMLRPCServer(master.server_address, logRequests=False)
    next_master.register_function(lambda caller: (1, "", 1), "getPid")
    next_master.serve_forever()
"""
ENDED = """
def after_that():
    time.sleep(0.6)
    process.end()
"""


@pytest.mark.parametrize(
    ("then", "status", "starts"),
    [
        pytest.param(BACK, 0, ["started", "started at last"], id="back"),
        pytest.param(ENDED, 130, ["started"], id="ended"),
    ],
)
def test_a_node_that_loses_its_master_while_it_starts_begins_again_with_the_next(
    tmp_path, then, status, starts
):
    assert ends(tmp_path, MASTER + then + LOST) == (status, [*starts, ""])


def ends(folder, code):
    """Run code in a process of its own; returns the exit code, and the lines that it printed."""
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, cwd=folder, timeout=60, stdout=subprocess.PIPE, text=True)
    return run.returncode, run.stdout.split("\n")
