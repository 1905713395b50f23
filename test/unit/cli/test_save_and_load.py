# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`save` and `load`: the round trip, the checks before, and undoing."""

from __future__ import annotations

import dataclasses
import io
import os
import re
from typing import Any

import pytest
from unit.cli.fake_client import FakeClient, play, run
from unit.manager.world import World

from dyknow.cli.main import execute, parse
from dyknow.cli.output import write_file
from dyknow.cli.shell import Shell
from dyknow.errors import ManagerUnreachable, Refused
from dyknow.model.graph import Model, NodeletKind, NodeletStatus, SpawnRequest, State
from dyknow.model.streams import ClaimState, StreamRequest, StreamStatus
from dyknow.model.transformation import Parameter, Port, Transformation
from dyknow.wiring.load import unsettled
from dyknow.wiring.plan import readers_first
from dyknow.wiring.wiring import Wiring, wiring_of

IMAGE = "sensor_msgs/Image"


def spawn_chain(client):
    client.world.spawn("camera", "cam", config={"image": "raw"})
    client.world.spawn("relay", "/robot/relay", config={"in": "/raw"}, is_protected=True)
    client.world.spawn("native", "n", config={"image": "/raw", "~out": "small"}, isolated=True)


@pytest.fixture(name="file", autouse=True)
def _file(tmp_path, monkeypatch):
    """A saved chain, w.xml in the present folder: camera, relay, and a C++ nodelet."""
    monkeypatch.chdir(tmp_path)
    client = FakeClient(World())
    spawn_chain(client)
    assert run(client, "save w.xml").code == 0
    return tmp_path / "w.xml"


@pytest.mark.parametrize("command", ["save -", "export", "library camera"])
def test_standard_output_is_utf8_in_every_locale(command):
    """As the text of a file is: an XML file without a declaration is."""
    client: Any = FakeClient(World())
    text = client.world.manager.library.get("camera").to_xml()
    client.world.manager.add_transformation(
        text.replace(">30<", ">30 ü<").replace("double", "string")
    )
    client.world.spawn("camera", "cam")
    out = io.TextIOWrapper(io.BytesIO(), "latin-1", "backslashreplace")
    arguments = parse(command.split())
    assert execute(arguments, Shell(lambda: client, False, out, io.StringIO())) == 0
    assert "30 ü" in out.buffer.getvalue().decode("utf-8")


def test_a_file_is_on_disk_before_it_replaces_the_old_one(tmp_path, monkeypatch):
    file, seen = tmp_path / "w.xml", []
    file.write_bytes(b"old")
    monkeypatch.setattr(
        os, "fsync", lambda stream: seen.append((file.read_bytes(), os.fstat(stream).st_size))
    )
    write_file(str(file), b"newer")
    assert (seen, file.read_bytes()) == ([(b"old", 5)], b"newer")


@pytest.mark.parametrize("command", ["load /dev/zero", "load -", "import /dev/zero", "import -"])
def test_a_file_without_an_end_is_refused(client, monkeypatch, command):
    monkeypatch.setattr("dyknow.cli.output._LARGEST", 2**16)
    with open("/dev/zero") as endless:
        monkeypatch.setattr("sys.stdin", endless)
        outcome = run(client, command)
    assert outcome.code == 1
    assert "is too large; expected at most 65536 bytes" in outcome.err


def replace(file, old, new):
    file.write_text(file.read_text().replace(old, new))


def graph(client):
    return [
        (each.name, each.transformation, each.is_protected, each.isolated, each.ports)
        for each in client.get_graph().nodelets
    ]


def topics(client, name):
    return {port.name: port.topic for port in client.get_graph().nodelet(name).ports}


def rate(client, nodelet):
    return client.world.host.parameters[f"{nodelet}/rate"]


def give_the_library_another_camera(client):
    text = client.world.manager.library.get("camera").to_xml()
    client.world.manager.add_transformation(text.replace(">30<", ">31<"))


NO = Refused("no")


def failing(*steps, error=NO):
    """Make calls of the client fail; an empty name stands for any."""

    def fail(*found):
        if any(all(one in ("", two) for one, two in zip(step, found)) for step in steps):
            raise error

    return fail


def test_loading_what_was_saved_and_saving_it_again_is_the_identity(client, file):
    client.world.host.ensure(NodeletKind.PYTHON)
    client.world.manager.remove_transformation("camera")
    assert "nodelet /cam: would be spawned" in run(client, "load w.xml --dry-run").lines
    assert client.calls == []
    play(
        client,
        """
        $ load w.xml
        transformation camera: added
        transformation native: exists already
        transformation relay: exists already
        nodelet /n: spawned
        nodelet /robot/relay: spawned
        nodelet /cam: spawned
        $ save again.xml
        ...
        """,
    )
    assert file.with_name("again.xml").read_text() == file.read_text()
    client.calls.clear()
    kept = ["/cam", "/n", "/robot/relay"]
    nothing = {"spawned": [], "replaced": [], "changed": [], "kept": kept}
    assert run(client, "load w.xml --json").json["nodelets"] == nothing
    assert client.calls == []


@pytest.mark.parametrize("end", ["its load fails", "it hangs at the manager's start"])
def test_what_does_not_run_is_saved_as_it_is_to_be_connected(tmp_path, end):
    world = World(str(tmp_path / "state"))
    world.spawn("camera", "cam", config={"image": "/raw"})
    before, manager = wiring_of(world.manager.get_model()), world.manager.graph.get("/cam").manager
    if end == "its load fails":
        world.host.fail_at("load", "cam", "the camera is unplugged")
        world.host.kill(manager)
    else:
        world.host.hang(manager)
        world.kill_manager()
    world.manager.look()
    assert world.states() != {"/cam": "RUNNING"}
    assert wiring_of(world.manager.get_model()) == before


def test_what_runs_is_brought_to_what_the_file_says(client, file):
    client.world.spawn("relay", "/robot/relay", config={"in": "/x", "out": "/y"})
    client.world.spawn("camera", "other")
    outcome = run(client, "load w.xml --json")
    assert outcome.json["nodelets"]["changed"] == ["/robot/relay"]
    assert client.get_graph().nodelet("/robot/relay").is_protected
    assert topics(client, "/robot/relay") == {"in": "/raw", "out": ""}
    assert client.get_graph().nodelet("/other") is not None


def test_a_nodelet_that_was_isolated_since_it_crashed_is_kept(client):
    assert run(client, "load w.xml").code == 0
    records = client.world.manager.graph
    records.put(dataclasses.replace(records.get("/cam"), isolated=True))
    for options in ("", "--replace"):
        assert "/cam" in run(client, f"load w.xml {options} --json").json["nodelets"]["kept"]
    records.put(dataclasses.replace(records.get("/n"), isolated=False))
    outcome = run(client, "load w.xml")
    assert (outcome.code, "'/n' runs already, not isolated" in outcome.err) == (1, True)


def two_managers(client, file):
    shared = client.world.spawn("native", "other").manager
    replace(file, 'name="/n"', f'name="/n" manager="{shared}"')


def all_wrong(client, file):
    client.world.spawn("camera", "/robot/relay")
    client.world.manager.add_transformation(
        "<transformation><label>native</label><source>pkg/Native</source></transformation>"
    )
    replace(file, 'transformation="camera"', 'transformation="unheard of"')
    replace(file, 'name="/n"', 'name="/n" manager="/elsewhere"')


def few(client, file):
    client.world.host.parameters[f"{client.manager}/limits/nodelets"] = 2


def other_type(client, file):
    text = '<port type="out" datatype="{}">image'
    replace(file, text.format(IMAGE), text.format("std_msgs/Header"))


def fixed(client, file):
    client.world.spawn("native", "n", config={"image": "/other"}, isolated=True)


def protected(client, file):
    give_the_library_another_camera(client)
    client.world.spawn("camera", "cam", is_protected=True)


def unknown_port(client, file):
    client.world.spawn("camera", "cam")
    replace(file, 'port="image" topic="/raw"', 'port="imag" topic="/raw"')


@pytest.mark.parametrize(
    ("setting", "options", "said"),
    [
        (unknown_port, "--dry-run", ["36: nodelet '/cam': unknown port 'imag'"]),
        (
            all_wrong,
            "",
            [
                "17: transformation 'native' is in the library already, and differs; replace it",
                "35: nodelet '/cam': neither the file nor the library has its transformation",
                "42: nodelet '/robot/relay' runs already, made from 'camera'; expected 'relay'",
                "38: nodelet '/n': its nodelet manager '/elsewhere' is not running, or "
                "~nodelet_managers does not name it; start or name it, or let",
            ],
        ),
        (two_managers, "", ["38: nodelet '/n': isolated, and in nodelet manager '/fake_0'"]),
        (
            other_type,
            "--replace",
            [f"39: topic '/raw': '/n:image' has type {IMAGE}, '/cam:image' has std_msgs/Header"],
        ),
        (fixed, "", ["38: the topics of '/n' are fixed"]),
        (few, "", ["42: more than 2 nodelets; the manager allows no more"]),
        (protected, "--replace", ["35: nodelet '/cam' is protected"]),
    ],
)
def test_everything_is_checked_before_anything_is_changed(client, file, setting, options, said):
    setting(client, file)
    outcome = run(client, f"load w.xml {options}")
    assert (outcome.code, outcome.out, client.calls) == (1, "", [])
    for each in said:
        assert f"dyknow: w.xml:{each}" in outcome.err


def test_the_manager_may_allow_more_nodelets_and_another_manager(client, file):
    client.world.host.parameters[f"{client.manager}/limits/nodelets"] = 3
    replace(file, 'manager="/fake_0"', 'manager="/elsewhere"')
    client.world.host.add("/elsewhere", foreign=True)  # it runs, for another manager
    for options in ("", "--dry-run"):
        told = run(client, f"load w.xml {options}")
        assert (told.code, client.calls) == (1, []) and "does not name it" in told.err
    assert run(client, "load w.xml --any-manager").code == 0


def test_nodelets_of_a_replaced_transformation_are_made_again(client, file):
    give_the_library_another_camera(client)
    client.world.spawn("camera", "cam", config={"image": "elsewhere"})
    client.world.spawn("camera", "other")
    assert rate(client, "/cam") == 31
    outcome = run(client, "load w.xml --replace --dry-run")
    assert "nodelet /cam: would be replaced" in outcome.lines
    found = run(client, "load w.xml --replace --json").json
    assert found["transformations"]["replaced"] == ["camera"]
    assert found["nodelets"]["replaced"] == ["/cam"]
    assert found["nodelets"]["spawned"] == ["/n", "/robot/relay"]
    assert topics(client, "/cam") == {"image": "/raw"}
    assert (rate(client, "/cam"), rate(client, "/other")) == (30, 31)  # no file names the other


def test_a_nodelet_of_an_earlier_transformation_is_made_again(client, file):
    camera = client.world.manager.library.get("camera")
    give_the_library_another_camera(client)
    client.world.spawn("camera", "cam", config={"image": "/raw"})
    client.world.manager.add_transformation(camera.to_xml())
    difference = "parameter rate is 31.0, expected 30"
    lines = run(client, "load w.xml").lines
    assert f"nodelet /cam: exists already ({difference}: see --replace)" in lines
    assert rate(client, "/cam") == 31
    found = run(client, "load w.xml --replace --json").json
    assert found["nodelets"]["replaced"] == ["/cam"]
    assert found["differences"] == [{"nodelet": "/cam", "differences": [difference]}]
    assert rate(client, "/cam") == 30
    assert run(client, "load w.xml --replace --json").json["nodelets"]["replaced"] == []


@pytest.mark.parametrize(
    "given",
    [
        {"tree/a": "5"},
        {"tree": "{a: 5}"},
        {"tree": "{q: 1}", "tree/a": "5"},
        {"tree//a": "5", "c/": "2"},
        {"flat": "1", "flat/x": "2", "tree/a": "5"},
    ],
)
def test_parameters_below_others_are_as_the_parameter_server_has_them(client, given):
    trees = """
        <transformation><label>deep</label><source>pkg/Camera</source><params>
          <param name="tree" type="yaml">{a: 1, b: 2}</param>
          <param name="tree/z" type="int">3</param>
        </params><ports><port type="out">image</port></ports></transformation>"""
    client.world.manager.add_transformation(trees)
    parameters = tuple(Parameter(name, "", text) for name, text in given.items())
    client.world.spawn("deep", "d", parameters=parameters)
    assert run(client, "save deep.xml").code == 0
    assert "nodelet /d: exists already" in run(client, "load deep.xml --dry-run").lines
    client.world.host.parameters["/d/tree/a"] = 6
    changed = run(client, "load deep.xml --dry-run").out
    assert re.search(r"/d: exists already \(parameter tree.* is .*6.*, expected .*5.*\)", changed)


def test_a_nodelet_with_a_parameter_that_the_file_lacks_is_made_again(client):
    given = (Parameter("gain", "", "5"), Parameter("rate", "", "20"))
    client.world.spawn("camera", "cam", config={"image": "/raw"}, parameters=given)
    found = run(client, "load w.xml --replace --json").json
    differences = ["parameter gain is 5, expected none", "parameter rate is 20.0, expected 30"]
    assert found["differences"] == [{"nodelet": "/cam", "differences": differences}]
    assert "/cam/gain" not in client.world.host.parameters
    assert run(client, "load w.xml --replace --json").json["nodelets"]["replaced"] == []


def test_a_parameter_that_is_not_a_number_is_that_of_the_file(client):
    text = client.world.manager.library.get("camera").to_xml()
    client.world.manager.add_transformation(text.replace(">30<", ">nan<"))
    client.world.spawn("camera", "cam", config={"image": "raw"})
    assert run(client, "save w.xml").code == 0
    assert run(client, "load w.xml --replace --json").json["nodelets"]["kept"] == ["/cam"]


@pytest.mark.parametrize(
    ("call", "step"),
    [
        (("spawn", "/n"), "spawning '/n'"),
        (("set_protection", "/robot/relay"), "protecting '/robot/relay'"),
    ],
)
def test_a_step_that_is_refused_undoes_those_before(client, call, step):
    give_the_library_another_camera(client)
    client.world.host.machine = "desk"
    client.world.host.add("/far", machine="rover")
    client.world.manager.look()
    client.world.spawn("camera", "cam", config={"image": "elsewhere"}, manager="@rover")
    client.world.spawn("relay", "/robot/relay", config={"in": "/x"})
    before, library = graph(client), client.get_model().transformations
    client.fail = failing(call, error=Refused("not today"))
    outcome = run(client, "load w.xml --replace")
    assert outcome.code == 1
    assert outcome.err == f"dyknow: {step}: not today; everything is as it was\n"
    assert graph(client) == before
    assert rate(client, "/cam") == 31
    assert client.get_model().transformations == library
    assert client.world.manager.graph.get("/cam").pinned == "rover"


@pytest.mark.parametrize("was_done", [True, False])
@pytest.mark.parametrize("error", [ManagerUnreachable("no answer"), KeyboardInterrupt()])
def test_a_step_without_an_answer_or_with_ctrl_c_is_undone_too(client, error, was_done):
    def fail(call, subject):
        if (call, subject) == ("spawn", "/cam"):
            client.fail = failing()
            if was_done:
                client.spawn("camera", "/cam")
            raise error

    client.fail = fail
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            run(client, "load w.xml")
    else:
        outcome = run(client, "load w.xml")
        assert outcome.code == 1
        assert outcome.err.endswith("no answer; everything is as it was\n")
    assert graph(client) == []


def test_what_cannot_be_undone_is_told(client):
    client.fail = failing(("spawn", "/cam"), ("destroy", ""))
    error = run(client, "load w.xml").err
    assert "spawning '/cam': no; spawning '/robot/relay' could not be taken back: no" in error


def test_keep_going_keeps_what_was_done(client):
    client.fail = failing(("", "/n"))
    outcome = run(client, "load w.xml --keep-going --json")
    assert (outcome.code, outcome.err) == (1, "dyknow: spawning '/n': no\n")
    assert outcome.json["nodelets"]["spawned"] == ["/robot/relay", "/cam"]
    assert outcome.json["failed"] == [{"subject": "/n", "step": "spawning '/n'", "message": "no"}]
    assert [each[0] for each in graph(client)] == ["/cam", "/robot/relay"]


def test_ports_that_are_not_declared_are_connected_after_the_spawn(client):
    client.world.manager.add_transformation(
        "<transformation><label>bare</label><source>pkg/Relay</source></transformation>"
    )
    client.world.spawn("bare", "b")
    client.set_config("/b", {"in": "/x"})
    run(client, "save w.xml")
    client.destroy("/b")
    assert run(client, "load w.xml").code == 0
    assert topics(client, "/b")["in"] == "/x"


def test_what_cannot_be_saved(client, file):
    client.world.spawn("camera", "cam")
    process = client.world.host.processes["/fake_0"]
    process.nodelets["/foreign"] = process.nodelets["/cam"]
    client.world.manager.look()
    outcome = run(client, "save w.xml --json")
    assert outcome.json["left_out"] == ["/foreign"]
    assert outcome.err.startswith("dyknow: warning: '/foreign' is not saved")
    client.world.manager.remove_transformation("camera")
    outcome = run(client, "save gone.xml")
    assert outcome.code == 1
    assert "the library has no more 'camera' of '/cam'" in outcome.err
    assert not file.with_name("gone.xml").exists()


def test_relays_of_shared_streams_are_saved(client, file):
    client.host.sources["dyknow/Relay"] = client.host.sources["pkg/Relay"]
    for tag in ("Raw(camera)", "Raw(?c)"):
        client.acquire_stream(StreamRequest(tag))
    nodelets = client.get_graph().nodelets
    (relay,) = [each for each in nodelets if each.transformation.startswith("relay of ")]
    assert run(client, "save w.xml").err == ""
    for claim in client.list_streams():
        client.release_stream(claim.claim_id)
    for each in client.get_graph().nodelets:
        client.destroy(each.name)
    assert run(client, "load w.xml").code == 0
    assert client.get_graph().nodelet(relay.name).connections == relay.connections
    assert run(client, "save again.xml").code == 0
    assert file.with_name("again.xml").read_text() == file.read_text()


def test_files_that_cannot_be_used(client):
    play(
        client,
        """
        $ load nix.xml
        dyknow: nix.xml: cannot be read: No such file or directory
        [1]
        $ save no/x.xml
        dyknow: no/x.xml: cannot be written: No such file or directory
        [1]
        $ save /
        dyknow: /: cannot be written: Is a directory
        [1]
        """,
    )


def test_readers_come_before_writers_also_in_long_chains_and_rings():
    relay = Transformation("r", "p/R", ports=(Port("in", "in"), Port("out", "out")))

    def wired(number, into, out):
        return SpawnRequest("r", f"/n{number:04}", {"in": f"/t{into}", "out": f"/t{out}"})

    chain = [wired(number, number, number + 1) for number in range(3000)]
    assert readers_first(chain, {"r": relay}) == chain[::-1]
    ring = [wired(number, number, (number + 1) % 5) for number in range(5)]
    names = {each.name for each in ring}
    assert {each.name for each in readers_first(ring, {"r": relay})} == names


@pytest.mark.parametrize("is_lazy", [False, True])
def test_undeclared_ports_of_a_cpp_nodelet_stay_unless_the_file_moves_them(client, is_lazy):
    host = client.world.host
    host.stock = False
    tf = ("/tf", "in", "tf2_msgs/TFMessage")
    host.sources["pkg/Native"] = [("image", "in", IMAGE), ("~out", "out", IMAGE), tf]
    run(client, "load w.xml")
    host.connect("/n", {"/tf": "/other/tf"})
    client.world.manager.look()
    assert run(client, "load w.xml --json").json["nodelets"]["changed"] == []
    run(client, "save moved.xml")
    run(client, "destroy n")
    if is_lazy:  # the nodelet does not have the port yet
        host.lazy["pkg/Native"] = ("/tf",)
    outcome = run(client, "load moved.xml")
    assert (outcome.code, outcome.err) == (0, "")
    moved = {} if is_lazy else {"/tf": "/other/tf"}
    assert topics(client, "/n") == {"image": "/raw", "~out": "/small", **moved}
    assert run(client, "load moved.xml --json").json["nodelets"]["changed"] == []


NODES = """<transformations>
  <transformation type="node"><label>copier</label><source>topic_tools/relay words copy</source>
    <ports><port type="in">words</port><port type="out">copy</port></ports></transformation>
  <transformation type="node" node="/driver"><label>driver</label>
    <ports><port type="in">words</port><port type="out">copy</port></ports></transformation>
</transformations>"""


def test_nodes_are_saved_with_their_parameters_and_those_of_others_are_connected(client):
    source, other = "topic_tools/relay words copy", FakeClient(World())
    for each in (client, other):
        ports = [("words", "in", "std_msgs/String"), ("copy", "out", "std_msgs/String")]
        each.world.host.sources[source] = ports
        each.world.manager.add_transformation(NODES)

    def run_driver(where, topic):
        where.world.host.run_node("/driver", source, {"words": topic}, NodeletKind.CPP_NODE)
        where.world.manager.look()

    run_driver(client, "/a")
    given = (Parameter("rate", "int", "5"),)
    client.world.spawn("copier", "/copier", config={"words": "/a"}, parameters=given)
    assert run(client, "save w.xml").err == ""
    absent = run(other, "load w.xml")
    assert absent.code == 1
    assert "nodelet '/driver': it is a node that others start, and does not run" in absent.err
    run_driver(other, "/b")
    assert run(other, "load w.xml").code == 0
    assert graph(other) == graph(client)
    assert other.world.manager.graph.get("/copier").parameters == given
    assert run(other, "load w.xml --replace").code == 0


def test_waiting_for_the_manager_and_all_of_the_wiring(file, monkeypatch):
    client = FakeClient(World())
    happened = []

    def answer(method):
        if len(happened) < 2:
            raise ManagerUnreachable("the manager is not running")

    def happen(seconds):
        happened.append(seconds)
        if len(happened) == 4:
            client._altered.clear()

    def look(call, subject):
        if (call, subject) == ("spawn", "/robot/relay"):
            client.fail = lambda call, subject: None
            raise Refused("it has no device yet")

    client.asked, client.fail = answer, look
    monkeypatch.setattr("dyknow.cli.commands.save_load.time.sleep", happen)
    show = client.get_graph

    def get_graph():
        if client.get_model().nodelet("/cam") is not None and len(happened) < 4:
            client.alter("/cam", state=State.LOST, detail="its process has died")
        return show()

    monkeypatch.setattr(client, "get_graph", get_graph)
    done = run(client, "load w.xml --wait")
    assert done.code == 0, done.err
    assert "nodelet /cam: spawned" in done.lines
    assert [line.partition("; waiting")[0] for line in done.err.splitlines()] == [
        "dyknow: warning: the manager is not running",
        "dyknow: warning: spawning '/robot/relay': it has no device yet; everything is as it was",
        "dyknow: warning: nodelet '/cam' is lost: its process has died",
    ]
    assert client.get_model().nodelet("/n") is not None


@pytest.mark.parametrize("obstacle", ["a nodelet manager is missing", "the spawn is refused"])
def test_a_wait_reports_what_it_changed_itself(file, monkeypatch, obstacle):
    client = FakeClient(World())
    if obstacle == "a nodelet manager is missing":
        replace(file, 'manager="/fake_0"', 'manager="/elsewhere"')

    def refuse(call, subject):
        if call == "spawn" and obstacle == "the spawn is refused":
            raise Refused("it has no device yet")

    def another_loads(seconds):
        client.fail = lambda call, subject: None
        client.world.host.add("/elsewhere")
        assert run(client, "load w.xml").code == 0

    client.fail = refuse
    monkeypatch.setattr("dyknow.cli.commands.save_load.time.sleep", another_loads)
    nodelets = run(client, "load w.xml --wait --json").json["nodelets"]
    assert nodelets == {
        "spawned": [],
        "replaced": [],
        "changed": [],
        "kept": ["/cam", "/n", "/robot/relay"],
    }


def test_a_wait_has_a_limit_and_names_what_is_missing(file):
    client = FakeClient(World())
    done = run(client, "load w.xml --wait --within 0.000001 --dry-run")
    assert done.code == 1
    assert "dyknow: w.xml is not loaded completely" in done.err
    assert "dyknow: nodelet '/cam' is not there" in done.err
    assert "nodelet /cam: would be spawned" in done.lines
    assert client.host.running == []
    assert run(client, "load w.xml").code == 0
    done = run(client, "load w.xml --wait --dry-run")
    assert (done.code, done.err) == (0, "")
    assert "nodelet /cam: exists already" in done.lines
    client.alter("/cam", state=State.FAILED, detail="no device")
    done = run(client, "load w.xml --wait --within 0.000001")
    assert (done.code, done.err) == (1, "dyknow: nodelet '/cam' is failed: no device\n")


def test_a_wait_that_loads_nothing_takes_the_transformations_of_the_library(client):
    give_the_library_another_camera(client)
    spawn_chain(client)
    assert run(client, "load w.xml --wait --within 0.000001 --dry-run").code == 0
    assert run(client, "load w.xml --dry-run").code == 1


def test_a_wait_is_for_the_claims_that_use_the_wiring():
    def claim(number, state, *nodelets):
        detail, expires = "its part died", 0.0
        return StreamStatus(
            *(f"c{number}", "client", f"Tag({number})", "/t", "test/T"),
            *(state, detail, nodelets, expires),
        )

    wiring = Wiring((), (SpawnRequest("camera", "/cam"),))
    camera = NodeletStatus("/cam", "camera", "/m", False, False, False, State.RUNNING, "", ())
    model = Model(1, 1, (camera,))
    streams = [
        claim(1, ClaimState.ACTIVE, "/cam"),
        claim(2, ClaimState.RECOVERING, "/cam", "/x"),
        claim(3, ClaimState.PENDING, "/x"),
        claim(4, ClaimState.RELEASED, "/cam"),
    ]
    assert list(unsettled(wiring, model, streams)) == [
        "claim c2, Tag(2), is recovering: its part died"
    ]
