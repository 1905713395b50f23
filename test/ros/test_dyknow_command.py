#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line `dyknow` against a real manager: the graph, `doctor` and `restart`.

Most commands run in this process; those whose process matters (signals, pipes, completion) run in
one of their own. In the class RestartTest files are edited, and the robot runs them.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import psutil
import rospy
from graph import Heard
from manager_suite import CHILD, MANAGER, PROGRAM, ManagerCase, library, specification
from nodelet.srv import NodeletList, NodeletLoad
from processes import (
    DYKNOW,
    Done,
    Ended,
    Running,
    becomes,
    eventually,
    free_port,
    nodes,
    run,
    suspended,
)
from roslib.packages import find_node
from std_msgs.msg import Int32, String
from stream_suite import Events

from dyknow.errors import HostError, Refused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter
from dyknow.ros.client import ManagerClient
from dyknow.ros.shell.doctor import Doctor
from dyknow.ros.shell.shell_client import ShellClient
from dyknow.ros.wire.master import Master

WATCH = ("stats", "--watch", "0.01")
MOODY = "dyknow_manager_test/Moody"
#: A package that tests edit.
EDITED = tempfile.TemporaryDirectory()
os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join([EDITED.name, os.environ["ROS_PACKAGE_PATH"]])
MANIFEST = """<package format="2"><name>edited</name><version>0.0.0</version><description/>
<maintainer email="a@example.org">a</maintainer><license>BSD-3-Clause</license>
<export><dyknow plugin="${prefix}/nodelets.xml"/></export></package>"""
PLUGINS = """<library path="src">
  <class name="edited/Source" type="edited_source.Source" base_class_type="dyknow.Nodelet"/>
  <class name="edited/Sum" type="edited_sum.Sum" base_class_type="dyknow.Nodelet"/>
</library>"""
SOURCE = """import dyknow
from std_msgs.msg import Int32
import edited_value
class Source(dyknow.Nodelet):
    def on_init(self):
        handle = dyknow.NodeHandle(self.node_handle)
        self.value = edited_value.VALUE + handle.get_param("~step", 0)
        self.out = handle.Publisher("out", Int32, queue_size=10)
        self.timer = handle.Timer(handle.Duration(0.01), self.publish)
    def publish(self, event):
        self.out.publish(Int32(self.value))
"""
SUM = """import dyknow
from std_msgs.msg import Int32
class Sum(dyknow.Nodelet):
    def on_init(self):
        handle = dyknow.NodeHandle(self.node_handle)
        self.out = handle.Publisher("out", Int32, queue_size=10)
        self.input = handle.Subscriber("in", Int32, self.out.publish, queue_size=10)
"""
SCRIPT = """#!/usr/bin/env python3
import rospy
from std_msgs.msg import Int32
import script_value
rospy.init_node("script")
publisher = rospy.Publisher("out", Int32, queue_size=10)
rate = rospy.Rate(100)
while not rospy.is_shutdown():
    publisher.publish(script_value.VALUE)
    rate.sleep()
"""
LIBRARY = library(
    specification("source", "edited/Source", "out>=Value(it)", step=0),
    specification("sum", "edited/Sum", ">in=Value(it) out>=Sum(it)"),
    specification("script", "edited/script.py", "out>", "node"),
)


def execute(*command, **environment):
    """A command in a process of its own, with the texts that it writes."""
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        env={**os.environ, **environment},
    )


def completions(line):
    """Completions by argcomplete at the end of a line, without the space after a word."""
    done = execute(
        *("sh", "-c", 'exec "$@" 8>&1 >/dev/null', "sh", *DYKNOW),
        _ARGCOMPLETE="1",
        _ARGCOMPLETE_COMP_WORDBREAKS=" \t\n\"'><=;|&(:",
        COMP_LINE=line,
        COMP_POINT=str(len(line)),
    )
    return [each.strip() for each in done.stdout.split("\013") if each]


class CommandTest(ManagerCase):
    def setUp(self):
        self.manager = self.started()
        self.client = self.manager.client

    def done(self, *words):
        """Run a command that has to succeed and print only its result."""
        done = Done(*words)
        self.assertEqual((done.code, done.err), (0, ""), done.out)
        return done

    def test_spawn_list_info_destroy(self):
        done = self.done(
            "spawn", "relay", "/robot/r", "--protected", "--connect", "in:/x", "out:y"
        )
        self.assertEqual(
            done.lines,
            [f"spawned /robot/r from relay in {CHILD}", "  in - /x", "  out - /robot/y"],
        )
        (alone,) = self.done("list", "-l", "--json").json["nodelets"]
        self.assertGreater(alone["load"]["memory"], 10**6, "it has its process to itself")
        self.done("spawn", "counter", "c")
        self.assertEqual(self.done("list").lines, ["/c", "/robot/r"])
        self.assertIn("running,protected", self.done("list", "-l").lines[2])
        nodelets = self.done("list", "-l", "--json").json["nodelets"]
        for each in nodelets:
            self.assertLess(each["load"].pop("busy"), 1.0)
            self.assertEqual(each["load"], {"cpu": None, "memory": None}, "they share a process")
        (shape,) = self.done("info", "robot/r", "--json").json["nodelets"]
        self.assertEqual(
            {port["name"]: (port["datatype"], port["topic"]) for port in shape["ports"]},
            {"in": ("std_msgs/Header", "/x"), "out": ("std_msgs/Header", "/robot/y")},
        )
        refused = Done("destroy", "robot/r")
        self.assertEqual(refused.code, 1)
        self.assertIn("protected", refused.err)
        self.done("unprotect", "robot/r")
        self.assertEqual(self.done("destroy", "robot/r", "c").lines[0], "destroyed /robot/r")
        eventually(lambda: self.done("list").out == "", 5.0, "nothing is listed")

    def test_connect_and_disconnect_while_messages_flow(self):
        self.done("spawn", "counter", "c")
        self.done("spawn", "relay", "r", "--connect", "out:/out")
        heard = self.enter(Heard("/out"))
        done = self.done("connect", "c:out", "r:in")
        self.assertEqual(done.lines, ["/c:out -> /c/out -> /r:in"])
        heard.flows()
        # When the command ends, its effect is in the model.
        self.assertEqual(self.manager.topics("/r"), {"in": "/c/out", "out": "/out"})
        shape = self.done("connect", "c:out", "r:in", "--topic", "other", "--json").json
        self.assertEqual(
            [(each["nodelet"], each["before"], each["after"]) for each in shape["changed"]],
            [("/r", "/c/out", "/other"), ("/c", "/c/out", "/other")],
        )
        heard.flows()
        self.assertEqual(self.done("disconnect", "r:in").lines, ["/r:in has left /other"])
        self.assertEqual(self.manager.topics("/r"), {"in": "", "out": "/out"})

    def test_a_process_has_the_exit_code_and_the_output_of_its_command(self):
        self.done("spawn", "relay", "r")
        for words, code, out, err in (
            (["list"], 0, "/r\n", ""),
            (["info", "x"], 1, "", "dyknow: no nodelet named '/x' runs; see 'dyknow list'\n"),
            (["list", "--manager-node", "n"], 3, "", None),
        ):
            done = execute(*DYKNOW, *words)
            self.assertEqual((done.returncode, done.stdout), (code, out), done.stderr)
            self.assertEqual(done.stderr, done.stderr if err is None else err)
            self.assertEqual(done.stderr.count("\n"), int(code > 0), done.stderr)
        before = nodes()
        with Running(*DYKNOW, "stats", "--watch", "0.1") as watching:
            watching.wait_for("/r")
            self.assertEqual(nodes(), before)  # no node is started
            watching.stop()
            self.assertEqual(watching.exit_code(20.0), 130)
            self.assertNotIn("Traceback", watching.output)
        # A reader that goes away ends it quietly.
        done = execute(
            "bash", "-c", '"$@" | head -n 1; exit ${PIPESTATUS[0]}', "-", *DYKNOW, *WATCH
        )
        self.assertEqual((done.returncode, done.stderr), (141, ""))

    def test_completion(self):
        self.done("spawn", "relay", "r")
        for line, candidates in (
            ("dyknow info ", ["/r"]),
            ("dyknow connect r:", ["out"]),
            ("dyknow spawn relay x --connect in:/dyknow_manager/m", ["/dyknow_manager/model"]),
        ):
            # It gives up early rather than keep the user waiting, so a busy machine may need two.
            becomes(lambda line=line: completions(line), candidates)


class DoctorCase(ManagerCase):
    def findings(self, check: str, **options: object) -> list[tuple[str, str, str]]:
        """The findings of one check: subject, problem and cure."""
        checks = dict(Doctor(ShellClient(MANAGER), **options).checks())
        return [(each.subject, each.problem, each.cure) for each in checks[check]()]

    def found(self, check: str, subject: str, said: str, cure: str, **options: object) -> None:
        """Wait until a check finds a defect: the system changes while it is examined."""
        eventually(
            lambda: any(
                each[0] == subject and said in each[1] and cure in each[2]
                for each in self.findings(check, **options)
            ),
            30.0,
            f"{check}: {subject}: {said}",
            lambda: self.findings(check, **options),
        )

    def nothing_found(self, check: str, **options: object) -> None:
        becomes(lambda: self.findings(check, **options), [])


class DoctorTest(DoctorCase):
    """`dyknow doctor`: a healthy system has no findings, each defect is named with its cure."""

    def test_a_healthy_system_has_no_findings(self):
        manager = self.started()
        manager.client.remove_transformation("unknown")  # its source is not installed
        manager.client.spawn("counter", "c")
        done: list[Done] = []

        def is_healthy() -> bool:
            done[:] = [Done("doctor", "--json")]
            return (done[0].code, done[0].json["findings"]) == (0, [])

        eventually(is_healthy, 30.0, "nothing is found", lambda: done[0].out + done[0].err)
        self.assertEqual(len(done[0].json["checks"]), 13)

    def test_a_node_that_was_killed(self):
        with Running(*find_node("topic_tools", "relay"), "/a", "/b", "__name:=gone") as relay:
            eventually(lambda: Master("/test").node("/gone"), 20.0, "the node is up")
            relay.stop(signal.SIGKILL)
            self.found("nodes", "/gone", "no process answers", "rosnode cleanup")

    def test_a_process_of_another_version(self):
        self.started()
        self.nothing_found("versions")
        for name, service_class in (("list", NodeletList), ("load_nodelet", NodeletLoad)):
            service = rospy.Service(f"~{name}", service_class, lambda request: None)
            self.addCleanup(service.shutdown)
        node = rospy.get_name()
        self.found("versions", node, "was started with another version", "restart it")

    def test_a_nodelet_has_the_name_of_the_node_that_loads_it(self):
        self.started()
        words = ("load", "dyknow/Source", CHILD, "__name:=loaded")
        with Running("rosrun", "dyknow", "nodelet", *words):
            rospy.wait_for_service("/loaded/get_config", 20.0)
            eventually(lambda: Master("/test").node("/loaded"), 20.0, "the loader is up")
            self.assertEqual(self.findings("versions"), [])

    def test_resources_of_a_process(self):
        manager = self.started()
        process = psutil.Process(manager.process.pid)
        self.nothing_found("descriptors")
        soft, hard = process.rlimit(psutil.RLIMIT_NOFILE)

        def is_found() -> bool:
            # Again with each look: how many the manager uses is in flux.
            process.rlimit(psutil.RLIMIT_NOFILE, (process.num_fds() * 9 // 8, hard))
            return any(
                subject == MANAGER
                and "file descriptors" in problem
                and f"ulimit -n {hard}" in cure
                for subject, problem, cure in self.findings("descriptors")
            )

        try:
            eventually(is_found, 30.0, "the manager has few descriptors left")
        finally:
            process.rlimit(psutil.RLIMIT_NOFILE, (soft, hard))
        with tempfile.TemporaryDirectory() as folder:
            code = Path(folder, "changed.py")
            code.touch()
            os.utime(code, (time.time() + 3600.0,) * 2)  # clocks may differ by some
            self.found("versions", MANAGER, "", "", code=Path(folder))
        full = self.findings("disks", disk_usage=lambda path: (2**40, 2**40 - 2**20, 2**20))
        self.assertIn("1 MiB left", full[0][1])
        self.assertTrue(manager.state.startswith(full[0][0]), full)
        self.nothing_found("disks", disk_usage=lambda path: (2**40, 2**39, 2**39))


class RestartTest(ManagerCase):
    folder = Path(EDITED.name)

    def setUp(self):
        for name in ("src", "scripts"):
            (self.folder / name).mkdir(exist_ok=True)
        self.write("package.xml", MANIFEST)
        self.write("nodelets.xml", PLUGINS)
        self.write("src/edited_source.py", SOURCE)
        self.write("src/edited_sum.py", SUM)
        self.value("src/edited_value.py", 1)
        self.write("scripts/script.py", SCRIPT)
        (self.folder / "scripts/script.py").chmod(0o755)
        self.value("scripts/script_value.py", 1)
        self.manager = self.running()
        self.client = self.manager.client
        self.client.add_transformation(LIBRARY)

    def write(self, path, text):
        (self.folder / path).write_text(text)

    def value(self, path, value):
        self.write(path, f"VALUE = {value}\n")

    def heard(self, topic):
        return self.enter(Heard(topic, Int32, lambda message: message.data))

    def is_outdated(self, name):
        becomes(lambda: bool(self.manager.nodelet(name).outdated), True)

    def test_today_s_code_and_what_is_kept(self):
        self.client.spawn("source", "/source", {"out": "/a"}, is_protected=True)
        self.client.spawn("sum", "/sum", {"in": "/a", "out": "/b"})
        self.client.spawn("source", "/alone", {"out": "/c"}, isolated=True)
        self.client.spawn("script", "/shared", {"out": "/d"})
        self.client.spawn("script", "/own", {"out": "/e"}, isolated=True)
        heard = {topic: self.heard(topic) for topic in ("/b", "/c", "/d", "/e")}
        for each in heard.values():
            each.has(lambda value: value == 1)
        before = {each.name: each for each in self.client.get_model().nodelets}
        self.value("src/edited_value.py", 2)
        self.value("scripts/script_value.py", 3)
        for name in ("/source", "/alone", "/shared", "/own"):
            self.is_outdated(name)
        self.assertEqual(self.manager.nodelet("/sum").outdated, "")
        text = "/source: outdated: its code changed since it was loaded"
        becomes(lambda: text in Done("list", "-l").out, True)
        self.assertIn("cure: dyknow restart /source\n", Done("doctor").out)
        done = Done("restart", "--all-outdated", "--json")
        self.assertEqual((done.code, done.err), (0, ""))
        self.assertEqual(done.json["restarted"], ["/alone", "/own", "/shared", "/source"])
        for topic, value in (("/b", 2), ("/c", 2), ("/d", 3), ("/e", 3)):
            heard[topic].has(lambda each, value=value: each == value)
        becomes(lambda: {n.name: n for n in self.client.get_model().nodelets}, before)
        self.assertEqual(Done("restart", "--all-outdated").out, "nothing is outdated\n")

    def test_edit_save_and_the_robot_runs_it(self):
        self.client.spawn("source", "/source", {"out": "/a"})
        heard = self.heard("/a")
        heard.flows()
        watch = self.enter(Ended(*DYKNOW, "restart", "--watch", "source"))
        spent = []
        for value in range(2, 4):
            eventually(lambda: not self.manager.nodelet("/source").outdated, 10.0, "it is new")
            saved = time.monotonic()
            self.value("src/edited_value.py", value)
            heard.has(lambda each, value=value: each == value)
            spent.append(time.monotonic() - saved)
        print(f"from saving a file to the first message: {sorted(spent)} s")
        self.write("src/edited_value.py", "VALUE = = 7\n")
        watch.wait_for("edited_value.py cannot be run: line 1: invalid syntax")
        heard.flows()
        self.assertEqual(heard[-1], 3)
        self.value("src/edited_value.py", 8)
        heard.has(lambda each: each == 8)
        self.write("src/edited_value.py", "VALUE = NAME\n")
        watch.wait_for("name 'NAME' is not defined")
        self.manager.becomes("/source", State.FAILED)
        self.value("src/edited_value.py", 9)
        heard.has(lambda each: each == 9)
        watch.stop()
        self.assertEqual(watch.exit_code(10.0), 130)

    def test_claims_go_on(self):
        events = self.enter(Events())
        claim = self.client.acquire_stream(StreamRequest("Sum(it)", max_silence=60.0))
        heard = self.heard(claim.topic)
        heard.flows()
        parts = [each.name for each in self.client.get_model().nodelets]
        self.value("src/edited_value.py", 2)
        for name in (*parts, CHILD):
            heard.clear()
            done = self.client.restart(name)
            self.assertEqual(list(done.names), parts if name == CHILD else [name])
            heard.flows(100)
        self.assertEqual(heard[-1], 2)
        self.assertEqual([each.name for each in self.client.get_model().nodelets], parts)
        states = {each.after.state for each in events if each.after.claim_id == claim.claim_id}
        self.assertLessEqual(states, {ClaimState.ACTIVE, ClaimState.PENDING})
        self.assertNotIn("lost", self.manager.output)

    def test_a_parameter_is_set_for_life(self):
        self.client.spawn("source", "/source", {"out": "/a"})
        heard = self.heard("/a")
        heard.flows()
        done = Done("set", "source", "step", "10")
        self.assertIn("reads it when it is restarted: dyknow restart /source", done.out)
        self.assertEqual(
            Done("set", "source", "step", "20", "--restart").out, "/source: step = 20\n"
        )
        heard.has(lambda each: each == 21)
        self.assertNotIn(11, heard)
        self.manager.kill_child()
        heard.clear()
        heard.has(lambda each: each == 21)
        given = self.manager.nodelet("/source").parameters
        self.assertEqual(given, (Parameter("step", "int", "20"),))
        self.assertEqual(Done("set", "source", "step", "many").code, 1)
        with self.assertRaisesRegex(Refused, "no nodelet named '/nothing'"):
            self.client.restart("nothing")

    def test_a_nodelet_with_dynamic_reconfigure_reads_at_once(self):
        ports = ">image ~image>"
        half = specification("half", "image_proc/resize", ports, use_scale=True, scale_width=0.5)
        self.client.add_transformation(half)
        self.client.spawn("half", "/half")
        done = Done("set", "half", "scale_width", "0.25", "--restart", "--json")
        self.assertEqual((done.json["is_read"], done.err), (True, ""))
        self.assertNotIn("restarting", self.manager.output)
        self.assertEqual(rospy.get_param("/half/scale_width"), 0.25)
        self.assertFalse(Done("set", "half", "unknown", "1", "--json").json["is_read"])

    def test_the_manager_is_killed_while_it_restarts_a_nodelet(self):
        self.client.spawn("source", "/source", {"out": "/a"}, is_protected=True)
        heard = self.heard("/a")
        heard.flows()
        hang, begun = self.folder / "hang", self.folder / "begun"
        wait = f"import os, time\nopen('{begun}', 'w').close()\n"
        wait += f"while os.path.exists('{hang}'):\n    time.sleep(0.01)\n"
        hang.touch()
        self.write("src/edited_value.py", f"{wait}VALUE = 2\n")
        self.enter(Ended(*DYKNOW, "restart", "source"))
        eventually(begun.exists, 10.0, "it is loaded again")
        self.assertEqual(self.manager.nodelet("/source").state, State.STARTING)
        self.manager.kill()
        hang.unlink()
        self.manager.start()
        found = self.manager.becomes("/source", State.RUNNING)
        self.assertTrue(found.is_protected)
        heard.has(lambda each: each == 2)
        self.assertEqual(self.manager.topics("/source"), {"out": "/a"})


class UnhealthyTest(DoctorCase):
    def test_mistakes_in_the_library_and_in_parameters(self):
        manager = self.started(denied_topics=["/e_stop"], ontolgies="/x.owl")
        manager.client.add_transformation(specification("lost", "dyknow/Sourse", ">out"))
        manager.client.spawn("counter", "c", parameters=[Parameter("rte", "", "5")])
        done = Done("doctor", "--quiet")
        self.assertEqual(done.code, 1, done.out)
        for said in (
            "transformation 'lost': no package declares",
            "did you mean dyknow/Source",
            f"{MANAGER}/ontolgies: the DyKnow manager has no such parameter",
            f"cure: rosparam delete {MANAGER}/ontolgies",
            "declares no parameter 'rte'",
        ):
            self.assertIn(said, done.out)
        self.assertNotIn("\nok ", done.out)

    def test_a_callback_and_a_nodelet_manager_that_hang(self):
        self.end_idle()
        rospy.set_param(f"{CHILD}/stuck_after", 0.5)
        self.addCleanup(rospy.set_param, "/let_go", False)
        manager = self.started(own=True)
        manager.client.add_transformation(specification("moody", MOODY, ">in out>"))
        manager.client.spawn("counter", "c", {"out": "/s"})
        manager.client.spawn("moody", "/moody", {"in": "/s"})
        mood = self.publisher("/moody/order", String, latch=True)
        mood.publish("hang")
        running = "a callback has been running for"
        self.found("nodelets", "/moody", running, "dyknow info /moody")
        self.assertIn(f"/moody: {running}", Done("list", "-l").out)
        self.assertIn(f"/moody: {running}", Done("stats").out)
        manager.client.destroy("/moody")
        self.found("remains of nodelets", CHILD, "/moody was unloaded", f"rosnode kill {CHILD}")
        manager.client.spawn("moody", "/moody", {"in": "/t"})
        becomes(lambda: manager.nodelet("/moody").detail, "")
        rospy.set_param("/let_go", True)
        self.nothing_found("remains of nodelets")

        # A nodelet manager that is suspended, and one that the master does not know.
        with manager.child_stopped() as child:
            self.found("nodes", CHILD, "does not answer", "kill -CONT")
            self.found("nodelets", "/c", "is LOST", "dyknow info /c")
        master = Master("/test")
        master.purge(CHILD, master.node(CHILD))
        pid = child.pid
        self.found("processes of an earlier master", CHILD, f"process {pid} runs", f"kill {pid}")

    def test_a_manager_that_does_not_run(self):
        self.end_idle()
        self.found("DyKnow manager", MANAGER, "is not running", "rosrun dyknow manager")
        self.assertEqual(Done("doctor", ROS_MASTER_URI="http://localhost:1").code, 3)


class UnreachableTest(ManagerCase):
    """The missing party is named, and the exit code is 3."""

    def check(self, said, *words, **environment):
        done = Done(*words, **environment)
        self.assertEqual((done.code, done.out), (3, ""), done.err)
        self.assertIn(said, done.err)
        self.assertEqual(done.err.count("\n"), 1, done.err)
        return done

    def test_no_manager(self):
        for words in (["list"], ["library"], ["spawn", "a", "b"], ["save", "-"], ["stats"]):
            self.check("DyKnow manager '/n' is not running", *words, "--manager-node", "n")
        self.end_idle()
        said = "'/ns/other' is not running: start one with 'rosrun dyknow manager"
        words = " __name:=other __ns:=/ns'\n"
        self.check(said + words, "list", DYKNOW_MANAGER="other", ROS_NAMESPACE="/ns")
        self.started()
        self.check(f"'/n' is not running, but {MANAGER} is: see", "list", "--manager-node", "n")

    def test_a_manager_takes_no_words_that_would_have_no_effect(self):
        done = execute(PROGRAM, "--read-only")
        self.assertEqual((done.returncode, done.stdout), (255, ""))
        self.assertIn("'--read-only' would have no effect", done.stderr)
        done = execute(PROGRAM, "__name:=m 2")
        self.assertEqual((done.returncode, done.stdout), (255, ""))
        self.assertIn("'/m 2' is not a valid name of a node: expected letters", done.stderr)
        self.assertNotIn("Traceback", done.stderr)

    def test_a_manager_that_hangs_was_killed_or_stopped(self):
        manager = self.started()
        with suspended(manager.process.pid):
            for words in (["list"], ["library"], ["destroy", "x"]):
                done = self.check("did not answer within 2 s", *words, "--timeout", "2")
                self.assertIn("it hangs, is busy, or its host is away", done.err)
                self.assertNotIn("start one", done.err)
            self.assertEqual(completions("dyknow info "), [])
        manager.kill()
        for words in (["list"], ["library"]):
            done = self.check(f"'{MANAGER}' is registered, but does not answer", *words)
            self.assertIn("start it again", done.err)
        self.answers_once_up(manager, "library")
        manager.stop()
        for words in (["list"], ["library"]):
            self.check("is not running: start one", *words)
        self.answers_once_up(manager, "list")
        for words in (["list", "--timeout", "1"], ["library", "--timeout", "1"]):
            node = f"--manager-node={rospy.get_name()}"
            self.check("or the node is not a DyKnow manager", *words, node)

    def test_a_program_waits_for_a_manager_that_is_being_started(self):
        manager = self.started()
        manager.stop()
        began = self.begin(manager)
        with contextlib.suppress(HostError):
            ManagerClient().get_model(timeout=20.0)
            return
        self.assertGreaterEqual(time.monotonic() - began, 10.0)

    def test_a_command_waits_for_the_master_that_roslaunch_starts(self):
        port, folder = free_port(), self.make_folder()
        uri = f"http://localhost:{port}"
        launch = ("roslaunch", "-p", port, "dyknow", "manager.launch", f"state_dir:={folder}")
        robot = self.run_process("env", f"ROS_MASTER_URI={uri}", *launch)
        process = psutil.Process(robot.pid)
        eventually(lambda: process.environ().get("ROS_MASTER_URI") == uri, 10.0, "it has begun")
        began = time.monotonic()
        done = execute(*DYKNOW, "list", "--timeout", "20", ROS_MASTER_URI=uri)
        if done.returncode:  # this machine is slow
            self.assertGreaterEqual(time.monotonic() - began, 10.0, done.stderr)
        else:
            self.assertEqual(done.stderr, "")

    def begin(self, manager):
        """Start a manager; return the moment at which its process has its command line."""
        manager.start(wait=False)
        process = psutil.Process(manager.process.pid)
        eventually(lambda: PROGRAM in process.cmdline(), 10.0, "it has begun")
        return time.monotonic()

    def answers_once_up(self, manager, command):
        """A command waits for the services of a manager that was just started."""
        began = self.begin(manager)
        done = Done(command, "--timeout", "20")
        if done.code:  # this machine is slow
            self.assertIn("being started", done.err)
            self.assertGreaterEqual(time.monotonic() - began, 10.0)
            becomes(lambda: Done(command).code, 0)
        else:
            self.assertEqual(done.err, "")


if __name__ == "__main__":
    run()
