# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The commands, on a manager without ROS."""

from __future__ import annotations

import io
import json
import os
import threading
from types import SimpleNamespace

import pytest
from clocks import wait_for
from unit.cli.fake_client import Outcome, play, run
from unit.manager.world import TRACKER

from dyknow.cli.main import execute, parse
from dyknow.cli.shell import Shell
from dyknow.errors import ManagerUnreachable, Refused
from dyknow.model.statistics import NodeletLoad
from dyknow.model.transformation import Port, Transformation
from dyknow.ros.client import ManagerClient
from dyknow.ros.shell import shell_client
from dyknow.ros.shell.load_meter import Loads
from dyknow.ros.wire.master import Master

#: With a camera, and a protected relay behind it.
SESSIONS = {
    "list": """
$ list
/cam
/robot/relay
$ list robot
/robot/relay
$ list /
/cam
/robot/relay
$ list -l
NODELET       TRANSFORMATION  STATE              IN  OUT  BUSY %  CPU %  MEMORY MB  MANAGER
/cam          camera          running             0    1       -      -          -  /fake_0
/robot/relay  relay           running,protected   1    1       -      -          -  /fake_0
""",
    "info": """
$ info cam /robot/relay
...Nodelet [/cam]...Out-ports:
 * image [sensor_msgs/Image]
    topic: /raw
    tag: Raw(camera)
    to: /robot/relay:in
...In-ports:
...    from: /cam:image
... * out [sensor_msgs/Image]
    topic: (disconnected)...
$ info /camm /cam
...Nodelet [/cam]...
dyknow: no nodelet named '/camm' runs; did you mean /cam?
[1]
""",
    "spawn": """
$ spawn relay r --protected --connect in:/a out:b
spawned /r from relay in /fake_0
  in - /a
  out - /b
$ spawn rellay r
dyknow: no transformation is labelled 'rellay'; did you mean relay?
[1]
$ spawn relay s --connect in:r:out
spawned /s from relay in /fake_0
  in - /b
$ spawn relay t --connect out:s:in
spawned /t from relay in /fake_0
  out - /t/out
$ info s
...Nodelet [/s]...
    topic: /t/out
    from: /t:out...
$ spawn relay u --connect in:s:in
dyknow: ...'/s:in' is an in-port, expected an out-port first...
[1]
$ spawn relay u --connect inn:r:out
dyknow: transformation 'relay' declares no port 'inn'; known ports: in, out
[1]
$ spawn relayy u --connect in:r:out
dyknow: no transformation is labelled 'relayy'; did you mean relay?
[1]
$ spawn relay q --connect in:/a --connect in:/b
dyknow: ...port 'in' is named twice...
[1]
$ destroy r
dyknow: ...
[1]
""",
    "protection": """
$ unprotect /robot/relay
unprotected /robot/relay
$ protect cam
protected /cam
$ destroy cam
dyknow: ...
[1]
$ destroy robot/relay
destroyed /robot/relay
""",
    "library": """
$ library -l camera
LABEL   TYPE     SOURCE      COST  IN  OUT
camera  nodelet  pkg/Camera     1   0    1
$ library camera
<transformation type=...
$ library camra relay nix relay
<transformation type=...<label>relay</label>...</transformation>
dyknow: ...'camra'; did you mean camera?
dyknow: ...'nix'...
[1]
$ export camra relay nix
dyknow: ...'camra'; did you mean camera?
dyknow: ...'nix'...
[1]
""",
    "graph": """
$ graph
/raw [sensor_msgs/Image]
    from /cam:image
    to   /robot/relay:in
(disconnected)
    out  /robot/relay:out
""",
}


@pytest.mark.parametrize("name", SESSIONS)
def test_sessions(chain, name):
    play(chain, SESSIONS[name])


def test_a_transformation_as_json_has_all_its_fields(client):
    text = client.world.manager.library.get("camera").to_xml()
    required = "<requires>Holds(light)</requires></transformation>"
    client.world.manager.add_transformation(text.replace("</transformation>", required))
    (camera,) = run(client, "library camera --json").json["transformations"]
    assert camera.keys() == {*Transformation._fields, "specification"}
    assert camera["requires"] == [{"tag": "Holds(light)", "initially": True}]
    assert camera["ports"][0].keys() == set(Port._fields)


def test_list_as_json(chain):
    (camera, relay) = run(chain, "list --json").json["nodelets"]
    assert relay["protected"] and not camera["protected"]
    port = {"name": "image", "direction": "out", "topic": "/raw", "tags": ["Raw(camera)"]}
    assert camera == {
        "name": "/cam",
        "transformation": "camera",
        "manager": "/fake_0",
        **dict.fromkeys(("protected", "isolated", "fixed"), False),
        "kind": "nodelet",
        "host": "",
        "state": "running",
        "detail": "",
        "outdated": "",
        "owner": "",
        "ports": [{**port, "datatype": "sensor_msgs/Image"}],
        "parameters": [],
    }


LOADS = """
$ list -l
NODELET       TRANSFORMATION  STATE              IN  OUT  BUSY %  CPU %  MEMORY MB  MANAGER
/cam          camera          running             0    1      10    150         61  /fake_0
/robot/relay  relay           running,protected   1    1       0      0          -  /fake_0
/cam: a callback has been running for 12 s

PROCESS  CPU %  MEMORY MB
/fake_0     12         48
"""


def test_a_long_list_has_the_load_of_nodelets_and_of_the_processes_of_this_machine(chain):
    chain.host.details["/cam"] = "a callback has been running for 12 s"
    chain.world.manager.look()
    processes = {"/fake_0": (0.123, 48_500_000), "/elsewhere": (1.0, 1)}
    cam, relay = NodeletLoad(0.096, 1.5, 61_000_000), NodeletLoad(0, 0, None)
    chain.loaded = Loads({"/cam": cam, "/robot/relay": relay}, processes)
    play(chain, LOADS)
    chain.loaded = Loads({"/cam": cam}, processes)
    value = run(chain, "list -l --json").json
    assert [each["load"] for each in value["nodelets"]] == [cam._asdict(), None]
    assert value["processes"] == [{"name": "/fake_0", "cpu": 0.123, "memory": 48_500_000}]


def test_a_spawn_with_parameters(client):
    client.world.manager.add_transformation(TRACKER)
    assert run(client, "spawn relay q --isolated --json").json["isolated"]
    refused = run(client, "spawn tracker t")
    assert refused.code == 1 and "nothing says what ?camera" in refused.err
    outcome = run(client, "spawn tracker t --param '?camera=cam1' rate=5 --json")
    assert outcome.json["parameters"] == [
        {"name": "?camera", "type": "string", "value": "cam1"},
        {"name": "rate", "type": "int", "value": "5"},
    ]
    assert client.world.host.parameters["/t/frame"] == "cam1_link"
    assert "Parameters given at the spawn: ?camera=cam1, rate=5" in run(client, "info t").out


def test_destroy_goes_on_after_a_refusal(chain):
    outcome = run(chain, "destroy /robot/relay nobody cam --json")
    assert outcome.code == 1
    assert outcome.json["destroyed"] == ["/cam"]
    assert [each["nodelet"] for each in outcome.json["failed"]] == ["/robot/relay", "/nobody"]
    assert outcome.err.count("\n") == 2


def test_a_manager_that_goes_ends_a_command_with_3_and_what_was_done_before_is_told(chain):
    def fail(call, subject):
        if subject != "/robot/relay":
            raise ManagerUnreachable("DyKnow manager '/dyknow_manager' is not running")

    chain.fail = fail
    assert run(chain, "unprotect /robot/relay").code == 0
    outcome = run(chain, "destroy /robot/relay cam nobody")
    assert (outcome.code, outcome.out) == (3, "destroyed /robot/relay\n")
    assert outcome.err.count("\n") == 1


def test_export_to_standard_output(client):
    printed = run(client, "export").out
    assert run(client, "export -o -") == Outcome(0, printed, "")


def test_import_reads_what_export_wrote(client, tmp_path):
    file = tmp_path / "all.xml"
    before = client.get_model().transformations
    assert run(client, f"export -o {file}").code == 0
    labels = run(client, "library").lines
    assert "wrong ports" in labels
    for label in labels:
        assert run(client, f"remove '{label}'").code == 0
    outcome = run(client, "remove nix --json")
    assert (outcome.code, outcome.json["removed"]) == (1, [])
    assert run(client, f"import {file} --json").json["failed"] == []
    assert client.get_model().transformations == before


TEMPLATE = (
    "<transformation><label>l(${X})</label><source>dyknow/Relay</source>\n"
    '<args><arg label="X">%s</arg></args></transformation>'
)
FILES = {
    "nonsense.xml": "<transformation>\n<label/>\n<nonsense/>\n</transformation>",
    "good.xml": "<transformation><label>l</label><source>dyknow/Relay</source>"
    '<params><param name="a-b">1</param></params></transformation>',
    "bad.xml": "<transformation>\n<label>l</label>\n</transformation>",
    "unread.ttl": "@prefix : <http://x.org/#> .\n@prefix owl: <http://www.w3.org/2002/07/owl#> .\n"
    ":Camera a owl:Class .\n:Camera owl:equivalentClass [ owl:complementOf :Ball ] .\n"
    ":front a :Camera .\n",
    "unread.xml": TEMPLATE % "http://x.org/#Camera",
    "catalogue.xml": '<catalog xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">'
    '<uri name="http://y.org/" uri="other.ttl"/></catalog>',
    "importing.ttl": "<u:o> <http://www.w3.org/2002/07/owl#imports> <http://y.org/> .",
    "other.ttl": "@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .\n"
    '<u:C> rdfs:label "C" . <u:x> a <u:C> ; rdfs:label "front"@en, "vorn"@de .',
    "labels.xml": TEMPLATE % "u:C",
    "programs.xml": '<transformations><transformation type="node"><label>a</label>'
    "<source>topic_tools/relay words copy</source></transformation>"
    '<transformation type="node"><label>b</label><source>topic_tools/relais</source>'
    '</transformation><transformation type="node" node="/c"><label>c</label></transformation>'
    "</transformations>",
    "types.xml": "<transformations><transformation><label>a</label><source>dyknow/Rely</source>"
    '<ports><port type="in" datatype="sensor_msgs/Imge">in</port></ports></transformation>'
    "<transformation><label>b</label><source>dyknow/Rely</source></transformation>"
    '<transformation type="topic"><label>c</label><source>/c</source>'
    '<ports><port type="out">out</port></ports></transformation></transformations>',
}
CHECKS = """
$ check good.xml
good.xml:1: warning: ...
good.xml: 1 transformation: l
$ check unread.xml --ontology unread.ttl
unread.ttl:3: warning: no label, so that the last part of the URI is the name: ...#Camera>, ...
unread.ttl:4: warning: owl:complementOf in the description of ...#Camera> is not read
unread.xml:2: warning: the individual ...#front> has no label; it goes by the last part of its URI
unread.xml: 1 transformation: l(front)
$ check labels.xml --ontology importing.ttl --catalogue catalogue.xml
labels.xml: 1 transformation: l(front)
$ check labels.xml --ontology importing.ttl --catalogue catalogue.xml --language de
labels.xml: 1 transformation: l(vorn)
$ check programs.xml
programs.xml: warning: transformation 'b': package 'topic_tools' has no program 'relais'
programs.xml: 3 transformations: a, b, c
$ check types.xml
types.xml: warning: transformation 'a': no package declares a nodelet type 'dyknow/Rely'...did \
you mean dyknow/Relay...
types.xml: warning: transformation 'a': no message type 'sensor_msgs/Imge' is installed; did you \
mean sensor_msgs/Image...
types.xml: 3 transformations: a, b, c
"""


@pytest.fixture(name="files")
def _files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)


@pytest.mark.usefixtures("files")
def test_check_needs_no_manager():
    play(None, CHECKS)
    outcome = run(None, "check good.xml bad.xml --json")
    assert outcome.code == 1
    first, second = outcome.json["files"]
    assert (first["labels"], first["problems"]) == (["l"], [])
    assert second["problems"][0]["file"] == "bad.xml" and second["problems"][0]["line"] >= 1
    shape = run(None, "check unread.xml --ontology unread.ttl --json").json
    assert [each["line"] for each in shape["ontology_warnings"]] == [3, 4]


@pytest.mark.usefixtures("files")
def test_import_names_file_and_line_of_every_problem(client):
    outcome = run(client, "import missing.xml nonsense.xml")
    assert outcome.code == 1
    first, *others = outcome.err.splitlines()
    assert first == "dyknow: missing.xml: cannot be read: No such file or directory"
    assert {each.split(": ")[1] for each in others} >= {"nonsense.xml:2", "nonsense.xml:3"}


def test_graph_as_json_and_of_a_namespace(chain):
    assert run(chain, "graph --json").json["topics"] == [
        {
            "topic": "/raw",
            "datatype": "sensor_msgs/Image",
            "out": [{"nodelet": "/cam", "port": "image"}],
            "in": [{"nodelet": "/robot/relay", "port": "in"}],
        }
    ]
    assert '"n/cam"' not in run(chain, "graph --dot --namespace robot").out


@pytest.mark.parametrize("command", ["list", "list -l", "graph --namespace"])
def test_a_namespace_without_nodelets_is_named(chain, command):
    assert run(chain, f"{command} robot").err == ""
    told = "dyknow: warning: no nodelet is in the namespace"
    assert run(chain, f"{command} robo").err == f"{told} '/robo'\n"
    hint = "it is a nodelet: see 'dyknow info /cam'"
    assert run(chain, f"{command} cam").err == f"{told} '/cam'; {hint}\n"
    assert run(chain, f"{command} /").err == ""


#: Of nodelets with outside connections, a hung one, and ones without ports or counts.
STATS = """
$ stats
NODELET  PORT                     HZ  MESSAGES  DROPPED  UNSENT  MEAN   MAX  ERRORS  TOPIC  OUTSIDE
/cam     image              out  5.0       300        -       4  1.00  2.50       2  /raw   SHMROS, 2 TCPROS
/hung    (does not answer)
/plain   (no ports)                                                               -
/quiet   image              out    -         -        -       -     -     -       -  -      -
/relay   in                 in   5.0       300        4       -  1.00  2.50       2  /raw   -
/relay   out                out  5.0       300        -       4  1.00  2.50       2  -      -
dyknow: nodelet '/hung' did not answer within 5 s
[1]
$ stats nobody
dyknow: no nodelet named '/nobody' runs; see 'dyknow list'
[1]
"""  # noqa: E501


def test_stats(client):
    client.world.host.sources["pkg/Plain"] = []
    plain = "<transformation><label>plain</label><source>pkg/Plain</source></transformation>"
    client.add_transformation(plain)
    client.spawn("camera", "/cam", {"image": "/raw"})
    client.spawn("relay", "/relay", {"in": "/raw"})
    for label, name in (("camera", "/hung"), ("camera", "/quiet"), ("plain", "/plain")):
        client.spawn(label, name)
    client.hung.update(["/hung", "/plain"])
    client.uncounted.add("/quiet")
    client.links["/fake_0", "out", "/raw"] = ["TCPROS", "SHMROS", "TCPROS"]
    play(client, STATS)
    found = run(client, "stats --json")
    assert (found.code, found.json["silent"]) == (1, ["/hung"])
    cam, quiet, relay = found.json["nodelets"]
    assert [each["nodelet"] for each in (cam, quiet, relay)] == ["/cam", "/quiet", "/relay"]
    assert cam["ports"][0]["transports"] == ["SHMROS", "TCPROS", "TCPROS"]
    assert quiet["callback_errors"] is None
    uncounted = ("messages", "dropped", "rate", "mean_callback", "max_callback")
    port = {"name": "image", "direction": "out", "topic": "", **dict.fromkeys(uncounted)}
    assert quiet["ports"] == [{**port, "transports": []}]


def test_a_spawn_connects_two_out_ports_with_one_in_port_at_no_time(client):
    """The second topic took the place of the first, which was shown as connected."""
    client.world.host.sources["pkg/Two"] = [(name, "out", "sensor_msgs/Image") for name in "lr"]
    client.core.add_transformation(
        "<transformation><label>two</label><source>pkg/Two</source><ports>"
        '<port type="out">l</port><port type="out">r</port></ports></transformation>'
    )
    client.world.spawn("relay", "relay")
    play(
        client,
        """
        $ spawn two pair --connect l:relay:in r:relay:in
        dyknow: port '/relay:in' is named twice or more; expected one topic for each port
        [1]
        $ graph
        (disconnected)
            in   /relay:in
            out  /relay:out
        """,
    )


@pytest.mark.parametrize("option", ["", "--protected"])
def test_a_spawn_that_cannot_be_connected_leaves_nothing(chain, monkeypatch, option):
    def refuse(moves):
        raise Refused("topic '/r/out' is denied")

    monkeypatch.setattr(chain, "connect", refuse)
    outcome = run(chain, f"spawn relay r {option} --connect out:/robot/relay:in")
    assert outcome == Outcome(1, "", "dyknow: cannot connect: topic '/r/out' is denied\n")
    assert chain.get_graph().nodelet("/r") is None


@pytest.mark.parametrize("option", ["", "--protected"])
@pytest.mark.parametrize("error", [ManagerUnreachable("no answer"), KeyboardInterrupt()])
@pytest.mark.parametrize("call", ["spawn_nodelet", "connect"])
@pytest.mark.parametrize("is_done", [True, False])
def test_a_spawn_without_an_answer_or_with_ctrl_c_leaves_nothing(
    chain, monkeypatch, option, error, call, is_done
):
    chain.connect([("/robot/relay", {"out": ""})])
    before, make = chain.get_graph().nodelets, getattr(chain, call)

    def fail(request):
        monkeypatch.setattr(chain, call, make)
        if is_done:
            make(request)
        raise error

    monkeypatch.setattr(chain, call, fail)
    line = f"spawn relay r {option} --connect in:/robot/relay:out"
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            run(chain, line)
    else:
        assert run(chain, line) == Outcome(3, "", "dyknow: no answer\n")
    assert chain.get_graph().nodelets == before


@pytest.mark.parametrize("error", [ManagerUnreachable("no answer"), KeyboardInterrupt()])
def test_a_spawn_says_what_it_leaves_where_a_nodelet_manager_hangs(
    chain, monkeypatch, caplog, error
):
    connect = chain.connect

    def fail(moves):
        monkeypatch.setattr(chain, "connect", connect)
        raise error

    def refuse(name):
        raise Refused(f"'{name}' is not destroyed yet")

    monkeypatch.setattr(chain, "connect", fail)
    monkeypatch.setattr(chain, "destroy", refuse)
    said = "spawning '/r' could not be taken back: '/r' is not destroyed yet"
    line = "spawn relay r --connect in:/robot/relay:out"
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            run(chain, line)
        assert said in caplog.text
    else:
        outcome = run(chain, line)
        assert outcome == Outcome(3, "", f"dyknow: warning: {said}\ndyknow: no answer\n")


@pytest.mark.parametrize("option", ["", "--protected"])
def test_a_spawn_that_cannot_be_shown_leaves_nothing(chain, monkeypatch, option):
    """Ctrl-C while it starts, or a reader of the output that has gone."""

    class Gone(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

        def fileno(self):
            return pipe

    reader, pipe = os.pipe()
    os.close(reader)
    before = chain.get_graph().nodelets
    arguments = parse(f"spawn relay r {option}".split())
    with pytest.raises(BrokenPipeError):
        execute(arguments, Shell(lambda: chain, False, Gone(), io.StringIO()))
    os.close(pipe)
    assert chain.get_graph().nodelets == before

    def interrupt():
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr(chain, "get_graph", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run(chain, f"spawn relay r {option}")
    assert chain.get_graph().nodelets == before


def test_stats_are_watched_until_the_count(chain):
    outcome = run(chain, "stats --watch 0.001 --count 3 --json")
    assert outcome.code == 0
    assert [len(json.loads(line)["nodelets"]) for line in outcome.lines] == [2, 2, 2]
    text = run(chain, "stats cam -w 0.001 -n 2").out
    assert text.count("NODELET") == 2 and "\x1b" not in text


@pytest.mark.parametrize(
    ("named", "known"),
    [(None, []), ("cams /rover", ["/r/cams", "/rover"]), (["cams"], ["/r/cams"])],
)
def test_nodelet_managers_are_those_that_the_manager_may_use(monkeypatch, named, known):
    own = ["/r/dyknow_cpp_nodelet_manager", "/r/dyknow_nodelet_manager_2"]
    others = ["/cams", "/dyknow_nodelet_manager", "/r/cams", "/rover"]
    services = [[f"{name}/load_nodelet", [name]] for name in (*own, *others)]

    def ask(master, question, *names):
        if question == "getParam":
            assert names == ("/r/manager/nodelet_managers",)
            if named is None:
                raise LookupError("it is not set")
            return named
        return [[], [], services]

    monkeypatch.setattr(Master, "ask", ask)
    for kind in (ManagerClient, shell_client.ShellClient):
        assert kind("/r/manager").nodelet_managers() == sorted([*own, *known])


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_terminal_shows_what_a_command_waits_for(monkeypatch, is_terminal):
    class Errors(io.StringIO):
        def isatty(self):
            return is_terminal

    told = threading.Event()

    def answer_late(client, *request, **options):
        wait_for(told)
        return SimpleNamespace(success=True, message="")

    def tell(service):
        shell.tell_wait(service)
        told.set()

    monkeypatch.setattr(shell_client, "_SILENCE", 0.0)
    monkeypatch.setattr(shell_client.ShellClient, "_find_master", lambda client: None)
    monkeypatch.setattr(ManagerClient, "_call", answer_late)
    client = shell_client.ShellClient("/dyknow_manager", on_wait=tell)
    shell = Shell(lambda: client, False, io.StringIO(), Errors())
    assert execute(parse(["destroy", "/slow"]), shell) == 0
    said = "dyknow: still waiting for /dyknow_manager/destroy\n" if is_terminal else ""
    assert (shell.out.getvalue(), shell.err.getvalue()) == ("destroyed /slow\n", said)
