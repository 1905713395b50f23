#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager's services and model, and its start and end, with real processes."""

from __future__ import annotations

import os
import re
import signal
import sys
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import rosnode
import rospy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dyknow_msgs.msg import Model, PortConfig
from dyknow_msgs.srv import Spawn
from faulty_disk import full, kept_aside, read_only, small_disk
from graph import Heard, Manager
from manager_suite import (
    CHILD,
    LIBRARY,
    MANAGER,
    ManagerCase,
    ManagerProcess,
    everything,
    listed,
    registrations,
    specification,
)
from nodelet.srv import NodeletLoad, NodeletUnload
from processes import BUSY, Done, Running, becomes, eventually, run
from roslib.packages import find_node

from dyknow import __version__
from dyknow.errors import Refused
from dyknow.model.graph import State
from dyknow.model.streams import StreamRequest
from dyknow.ros.process.signals import FAILED

NUMBERS = specification("numbers", "dyknow_manager_test/Counter", "out>")
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
DIAGNOSTICS = EXAMPLES / "diagnostics.yaml"
WORKSHOP = EXAMPLES / "ontologies" / "workshop.ttl"
LABEL = "<http://www.w3.org/2000/01/rdf-schema#label>"
TEMPLATE = """
<transformation>
  <label>view(${Observer})</label><source>dyknow/Source</source>
  <args><arg label="Observer">http://dyknow.example.org/workshop#Observer</arg></args>
</transformation>
"""
PACKAGE = """
<package format="2">
  <name>lab</name><version>0.1.0</version><description>Cameras of a lab</description>
  <maintainer email="lab@example.org">Lab</maintainer><license>BSD</license>
  <export><dyknow transformations="${prefix}/views.xml" ontology="lab.ttl"/></export>
</package>
"""
VIEWS = """
<transformation>
  <label>view of ${Camera}</label><source>dyknow/Source</source>
  <args><arg label="Camera">http://lab.example.org#Camera</arg></args>
  <ports><port type="out" datatype="std_msgs/Header">out</port></ports>
  <tags><tag port="out">View(${Camera})</tag></tags>
</transformation>
"""
LAB = """
@prefix : <http://lab.example.org#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
:Camera a owl:Class ; rdfs:label "Camera" .
:left a :Camera ; rdfs:label "left" .
"""


class ServicesTest(ManagerCase):
    def setUp(self):
        self.manager = self.started()
        self.client = self.manager.client
        self.told = self.enter(Heard(f"{MANAGER}/model", Model))
        eventually(lambda: self.told, 5.0, "the model is told")

    def refused(self, *args, **kwds):
        with self.assertRaises(Refused) as caught:
            self.client.spawn(*args, **kwds)
        return str(caught.exception)

    def nothing_left(self, prefix):
        becomes(lambda: everything(prefix), set())

    def test_diagnostics(self):
        self.client.spawn("counter", "/c", {"out": "/s"})

        def levels(array):
            return {each.name: each.level for each in array.status}

        ok = DiagnosticStatus.OK
        host = self.client.get_model().nodelet("/c").host
        with Heard("/diagnostics", DiagnosticArray, levels) as heard:
            subjects = ("manager", "nodelet /c", f"host {host}")
            fine = {f"dyknow_manager: {subject}": ok for subject in subjects}
            heard.has(lambda each: each == fine)
            with self.manager.child_stopped():
                heard.has(lambda each: each["dyknow_manager: nodelet /c"] > ok, 20.0)
            becomes(lambda: heard[-1], fine)

    def test_the_example_groups_what_is_there(self):
        self.client.spawn("counter", "/c", {"out": "/s"})
        self.parameter("/aggregator", yaml.safe_load(DIAGNOSTICS.read_text()))
        aggregator = find_node("diagnostic_aggregator", "aggregator_node")
        self.enter(Running(*aggregator, "__name:=aggregator"))
        ok, nodelet = DiagnosticStatus.OK, "/DyKnow/Nodelets/c"

        def levels(array):
            return {each.name: each.level for each in array.status}

        with Heard("/diagnostics_agg", DiagnosticArray, levels) as heard:
            heard.has(lambda each: each.get(nodelet) == ok, 20.0)
            self.assertEqual((heard[-1]["/DyKnow"], heard[-1]["/DyKnow/Claims"]), (ok, ok))
            self.client.destroy("/c")
            becomes(lambda: nodelet in heard[-1], False)
            self.assertEqual(heard[-1]["/DyKnow"], ok)

    def test_a_chain_and_its_model(self):
        self.client.spawn("counter", "camera/counter", {"out": "raw"}, is_protected=True)
        self.client.spawn("relay", "/relay", {"in": "/camera/raw", "out": "~copy"})
        self.enter(Heard("/relay/copy")).flows()
        model = self.client.get_model()
        counter, relay = model.nodelet("/camera/counter"), model.nodelet("/relay")
        self.assertEqual((counter.transformation, counter.manager), ("counter", CHILD))
        self.assertTrue(counter.is_protected)
        self.assertIs(counter.state, State.RUNNING)
        self.assertEqual(counter.port("out").topic, "/camera/raw")
        self.assertEqual(relay.port("in").datatype, "std_msgs/Header")
        self.assertEqual(rospy.get_param("/camera/counter/rate"), 50.0)
        with self.assertRaisesRegex(Refused, "dyknow unprotect /camera/counter"):
            self.client.destroy("camera/counter")
        self.client.set_protection("camera/counter", False)
        self.client.destroy("camera/counter")
        self.client.destroy("/relay")
        self.assertEqual(everything("/camera"), set())

    def test_what_fails_leaves_nothing(self):
        before = everything()
        for label, expected in {
            "fails": "the camera is not plugged in",
            "wrong": "nothing",
            "unknown": "dyknow_manager_test/Nothing",
            "no such label": "no such label",
        }.items():
            message = self.refused(label, "/fail")
            self.assertIn(expected, message)
            self.assertNotIn("b'", message)
            self.assertIsNone(self.manager.nodelet("/fail"))
            self.assertEqual(everything(), before, label)
        self.assertIn("sideways", self.refused("relay", "/fail", {"sideways": "/x", "in": "/y"}))
        self.assertIn("/nobody", self.refused("relay", "/fail", manager="/nobody"))
        self.assertIn("?", self.refused("relay", "what?"))
        doubled = rospy.ServiceProxy(f"{MANAGER}/spawn", Spawn)(
            label="relay", name="/fail", config=[PortConfig("in", "/a"), PortConfig("in", "/b")]
        )
        self.assertFalse(doubled.success)
        self.assertIn("twice", doubled.message)
        self.assertEqual(everything(), before)
        self.client.spawn("relay", "/fail")
        self.assertIn("/fail", self.refused("relay", "/fail"))
        self.assertIs(self.manager.nodelet("/fail").state, State.RUNNING)

    def test_an_isolated_nodelet_and_those_that_destroy_themselves(self):
        self.client.spawn("counter", "/alone", {"out": "/numbers"}, isolated=True)
        self.assertEqual(self.manager.nodelet("/alone").manager, "/alone_nodelet_manager")
        self.assertTrue(self.manager.nodelet("/alone").isolated)
        self.client.spawn("suicidal", "/suicidal", {"in": "/numbers"})
        self.client.spawn("suicidal", "/suicidal_too", {"in": "/numbers"}, isolated=True)
        for name in ("/suicidal", "/suicidal_too"):
            self.manager.is_gone(name)
        process = self.manager.child("/alone_nodelet_manager")
        self.client.destroy("/alone")
        self.assertFalse(process.alive)
        self.nothing_left("/alone")
        self.nothing_left("/suicidal")

    def test_what_others_do_shows(self):
        load = rospy.ServiceProxy(f"{CHILD}/load_nodelet", NodeletLoad)
        load("/theirs", "dyknow_manager_test/Relay", ["/in"], ["/a"], [], "")
        self.manager.becomes("/theirs", State.RUNNING)
        self.assertEqual(self.manager.nodelet("/theirs").transformation, "")
        self.manager.shows("/theirs", **{"in": "/a", "out": ""})
        self.client.set_config("/theirs", {"out": "/b"})
        self.manager.shows("/theirs", out="/b")
        self.client.spawn("relay", "/ours", {"in": "/a"})
        self.client.set_config("/ours", {"in": "", "out": "/c"})
        self.manager.shows("/ours", **{"in": "", "out": "/c"})

        def told_topics():
            return [(n.name, p.topic) for n in self.told[-1].nodelets for p in n.ports]

        eventually(lambda: ("/ours", "/c") in told_topics(), 1.0, "the topic tells")
        for name in ("/ours", "/theirs"):
            rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)(name)
            self.manager.is_gone(name)
        self.nothing_left("/ours")

    def test_the_topic_carries_every_last_state_once(self):
        self.client.spawn("relay", "/busy")
        for number in range(41):
            self.client.set_protection("/busy", number % 2 == 0)
        revision = self.client.get_model().revision
        eventually(lambda: self.told[-1].revision >= revision, 1.0, "it is told")
        models = [*self.told]
        self.assertEqual(models[-1].transformations, [])
        revisions = [(model.revision, model.library_revision) for model in models]
        self.assertEqual(revisions, sorted(set(revisions)))

    def test_a_second_manager_of_that_name_does_not_end_the_first(self):
        manager = self.manager
        self.client.spawn("relay", "/relay")
        second = ManagerProcess(manager.state)
        second.start(wait=False)
        self.assertIn("runs already", second.fails())
        self.assertIs(manager.nodelet("/relay").state, State.RUNNING)
        # Under another name it has its own state and nodelet managers.
        other = ManagerProcess(manager.state, "/other_manager")
        self.addCleanup(other.destroy)
        other.start()
        eventually(lambda: listed(f"{CHILD}_2") is not None, 20.0, "it has a child of its own")
        self.assertIs(manager.nodelet("/relay").state, State.RUNNING)


class StartTest(ManagerCase):
    def labels(self, manager):
        return [each.label for each in manager.client.get_model().transformations]

    def test_bad_parameters_files_and_states_are_explained(self):
        manager = self.make(spawn_timeout="soon", num_nodelet_managers=0)
        manager.start(wait=False)
        said = "parameter '~spawn_timeout' is 'soon': expected seconds, at least 0.001"
        self.assertIn(said, manager.fails())
        good, bad = f"{manager.state}/good.xml", f"{manager.state}/bad.xml"
        Path(good).write_text(LIBRARY)
        Path(bad).write_text("<transformations>")
        manager.parameters.update(spawn_timeout=10.0, ontology="field.ttl")
        manager.start()
        self.assertIn("unknown parameter ~ontology; did you mean ~ontologies?", manager.output)
        manager.stop()
        [state] = Path(manager.state).glob("*.sqlite3")
        state.write_bytes(b"not a database" * 1000)
        manager.command.append(f"_transformations:=[{good}, {bad}]")
        manager.start()
        self.assertIn("set aside", manager.output)
        [aside] = state.parent.glob("*.broken-*")
        self.assertEqual(aside.read_bytes(), b"not a database" * 1000)
        self.assertIn("counter", self.labels(manager))
        self.assertIn(bad, manager.output)
        self.assertTrue(rospy.has_param(f"{MANAGER}/transformations"))
        manager.stop()
        other = self.make(num_nodelet_managers=0)
        other.start()
        self.assertEqual(self.labels(other), [])

    def test_an_end_on_purpose_leaves_nothing_but_transformations(self):
        self.end_idle()
        before = everything()
        manager = self.started(own=True)
        for number, end in enumerate(
            (
                manager.stop,
                lambda: manager.stop(signal.SIGTERM),
                lambda: rosnode.kill_nodes([MANAGER]),
            )
        ):
            if number > 0:
                manager.start()
                self.assertEqual(manager.client.get_model().nodelets, ())
                self.assertIn("counter", self.labels(manager))
            manager.client.spawn("counter", "/counter", {"out": "/numbers"}, is_protected=True)
            manager.client.spawn("relay", "/alone", {"in": "/numbers"}, isolated=True)
            children = manager.children()
            end()
            self.assertEqual(manager.process.wait(20.0 * BUSY), 0, manager.output)
            self.assertFalse([name for name, each in children.items() if each.alive])
            rospy.delete_param(MANAGER)
            self.assertEqual(everything(), before)

    def test_several_nodelet_managers_and_those_of_others(self):
        with Manager("/other") as other:
            manager = self.started(num_nodelet_managers=2, nodelet_managers=["/other", "/absent"])
            children = {CHILD, CHILD + "_2"}
            self.spawned(manager, "/asked", "other")
            for child in children:
                eventually(lambda child=child: listed(child) is not None, 20.0, f"{child} is up")
            for number in range(6):
                manager.client.spawn("relay", f"/r{number}", {"in": f"/in{number}"})
            hosts = {nodelet.manager for nodelet in manager.client.get_model().nodelets}
            self.assertEqual(hosts, children | {"/other"})
            with self.assertRaisesRegex(Refused, "absent"):
                manager.client.spawn("relay", "/nowhere", manager="/absent")
            other.stop(signal.SIGSTOP)
            manager.becomes("/asked", State.LOST)
            manager.client.spawn("relay", "/elsewhere")
            self.assertIn(manager.nodelet("/elsewhere").manager, children)
            other.stop(signal.SIGCONT)
            manager.becomes("/asked", State.RUNNING)
            manager.stop()
            self.assertFalse(other.has_ended)
            self.assertEqual(registrations("/asked"), [])

    def test_terms_in_the_language_that_was_asked_for(self):
        manager = self.make(language="de", num_nodelet_managers=0)
        owl, library = Path(manager.state, "lab.ttl"), Path(manager.state, "library.xml")
        catalogue = Path(manager.state, "elsewhere.xml")
        manager.parameters.update(
            ontologies=str(owl), catalogues=str(catalogue), transformations=str(library)
        )
        owl.write_text("<u:lab> <http://www.w3.org/2002/07/owl#imports> <u:workshop> .")
        catalogue.write_text(
            '<catalog xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">'
            f'<uri name="u:workshop" uri="{WORKSHOP}"/></catalog>'
        )
        library.write_text(TEMPLATE)
        manager.start()
        self.assertEqual(self.labels(manager), ["view(Deckenkamera)", "view(Greiferkamera)"])
        manager.stop()
        owl.write_text(f'<u:a> a <u:C>; {LABEL} "arm" . <u:b> a <u:C>; {LABEL} "arm" .')
        manager.start(wait=False)
        self.assertIn("the individuals <u:a> and <u:b> share the label 'arm'", manager.fails())

    def test_a_package_brings_transformations_and_individuals(self):
        folder = self.make_folder()
        path = f"{folder}:{os.environ['ROS_PACKAGE_PATH']}"
        with mock.patch.dict(os.environ, ROS_PACKAGE_PATH=path):
            self.manager = self.started(own=True)
        (folder / "views.xml").write_text(VIEWS)
        (folder / "lab.ttl").write_text(LAB)
        (folder / "package.xml").write_text(PACKAGE)
        self.assertIn("view of left", self.tagged("View(left)"))
        claim = self.manager.client.acquire_stream(StreamRequest("View(left)"))
        with (folder / "lab.ttl").open("a") as file:
            file.write(':right a :Camera ; rdfs:label "right" .\n')
        self.tagged("View(right)")
        (stream,) = self.manager.client.list_streams()
        self.assertEqual((stream.claim_id, stream.topic), (claim.claim_id, claim.topic))
        (folder / "package.xml").unlink()
        becomes(self.views, [])

    def views(self):
        return [each for each in self.labels(self.manager) if each.startswith("view of")]

    def tags(self):
        return Done("tags").out

    def tagged(self, tag):
        eventually(lambda: tag in self.tags(), 20.0, f"there is {tag}", self.tags)
        return self.tags()


class DiskTest(ManagerCase):
    """On a disk that is full or read-only."""

    def setUp(self):
        self.disk = self.enter(small_disk(self.make_folder() / "disk"))
        self.manager = self.make(state_dir=str(self.disk))
        self.manager.state = str(self.disk)

    def all_run(self, *names):
        wanted = dict.fromkeys(names, State.RUNNING)

        def states():
            return {each.name: each.state for each in self.manager.client.get_model().nodelets}

        eventually(lambda: states() == wanted, 30.0, f"{names} run", lambda: self.manager.output)

    def is_written_again(self):
        """Wait until the disk has everything."""
        said = lambda: "is written again" in self.manager.output  # noqa: E731
        eventually(said, 15.0, "the disk is tried again")

    def test_a_disk_that_is_full_or_read_only_stops_nothing(self):
        manager = self.manager
        manager.start()
        manager.client.add_transformation(NUMBERS)
        manager.client.spawn("numbers", "/a", {"out": "/s"})
        receiver, child = self.enter(Heard("/s")), manager.child()
        spawn = rospy.ServiceProxy(f"{MANAGER}/spawn", Spawn)
        with full(self.disk):
            message, count = "", 0
            while not message:  # there may be room for a few more
                answer = spawn(label="numbers", name=f"/n{count}")
                self.assertTrue(answer.success, answer.message)
                message, count = answer.message, count + 1
            self.assertIn("not on disk yet", message)
            for said in (message, manager.output):
                self.assertIn("the disk is full; free some space", said)
            self.assertNotIn("rollback", manager.output)
            with self.assertLogs("rosout.dyknow", "WARNING") as told:
                manager.client.spawn("numbers", "/alone", isolated=True)
            self.assertIn("not on disk yet", told.output[0])
            for number in range(count):
                manager.client.destroy(f"/n{number}")
            self.all_run("/a", "/alone")
            child.signal(9)
            eventually(lambda: not child.alive, 5.0, "it is dead")
            receiver.flows()
            self.all_run("/a", "/alone")
        becomes(lambda: {*manager.children()}, {CHILD, "/alone_nodelet_manager"})
        eventually(lambda: manager.child() != child, 15.0, "the list of processes is written")
        self.is_written_again()
        manager.kill()
        with full(self.disk):
            manager.start()
            self.all_run("/a", "/alone")

        # A read-only state is read, and the running processes are adopted.
        process = manager.child()
        manager.kill()
        with read_only(self.disk):
            manager.forget_output()
            manager.start()
            self.all_run("/a", "/alone")
            self.assertEqual(manager.topics("/a"), {"out": "/s"})
            self.assertEqual(manager.child(), process)
            self.assertIn("it is read-only", manager.output)
            said = re.findall("DyKnow manager.*", manager.output)[-1]
            for part in (f"manager {MANAGER}, version {__version__}", manager.state, "2 nodelets"):
                self.assertIn(part, said)  # its identity, and its restored state
            labels = [each.label for each in manager.client.get_model().transformations]
            self.assertEqual(labels, ["numbers"])
            manager.client.spawn("numbers", "/b")
            self.all_run("/a", "/alone", "/b")
        self.is_written_again()
        manager.kill()
        manager.start()
        self.all_run("/a", "/alone", "/b")
        (state,) = self.disk.glob("*-dyknow-manager.sqlite3")
        self.assertEqual(kept_aside(str(state)), [])

    def test_a_folder_that_cannot_be_written_is_named(self):
        advice = "~state_dir"
        for variables, argument, folder, cure in (
            ({}, "_state_dir:=/proc/none", "/proc/none", advice),
            ({}, f"_state_dir:={__file__}", __file__, advice),
            ({"ROS_LOG_DIR": "/proc/none"}, "_language:=en", "/proc/none", "ROS_LOG_DIR"),
            ({"ROS_HOME": "/proc/none"}, "_language:=en", "/proc/none", advice),
        ):
            with self.subTest(folder, **variables), mock.patch.dict(os.environ, variables):
                if "ROS_HOME" in variables:
                    os.environ.pop("ROS_LOG_DIR", None)
                with Running(*self.manager.command, argument) as running:
                    self.assertEqual(running.exit_code(60.0), FAILED, running.output)
                fatal = [each for each in running.output.splitlines() if "FATAL" in each]
                self.assertIn(f"'{folder}", fatal[0])
                self.assertIn(cure, fatal[0])


if __name__ == "__main__":
    run()
