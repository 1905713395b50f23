# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`save` and `load`: the round trip, the checks before, and undoing."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import pytest
from unit.cli.fake_client import FakeClient, run
from unit.manager.world import World

from dyknow.errors import ManagerUnreachable, Refused
from dyknow.model.graph import NodeletKind, SpawnRequest
from dyknow.model.streams import StreamRequest
from dyknow.model.transformation import Parameter, Port, Transformation
from dyknow.wiring.plan import readers_first


@pytest.fixture
def client() -> FakeClient:
    return FakeClient(World())


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A saved chain: camera, relay, and a C++ nodelet."""
    client = FakeClient(World())
    client.world.spawn("camera", "cam", config={"image": "raw"})
    client.world.spawn("relay", "/robot/relay", config={"in": "/raw"}, is_protected=True)
    client.world.spawn("native", "n", config={"image": "/raw", "~out": "small"}, isolated=True)
    file = tmp_path / "w.xml"
    assert run(client, f"save {file}").code == 0
    return file


def graph(client: FakeClient) -> list[tuple[object, ...]]:
    return [
        (each.name, each.transformation, each.is_protected, each.isolated, each.ports)
        for each in client.get_graph().nodelets
    ]


def topics(client: FakeClient, name: str) -> dict[str, str]:
    return {port.name: port.topic for port in client.get_graph().nodelet(name).ports}


def rate(client: FakeClient, nodelet: str) -> object:
    return client.world.host.parameters[f"{nodelet}/rate"]


def give_the_library_another_camera(client: FakeClient) -> None:
    text = client.world.manager.library.get("camera").to_xml()
    client.world.manager.add_transformation(text.replace(">30<", ">31<"))


NO = Refused("no")


def failing(
    is_it: Callable[[str, str], bool], error: BaseException = NO
) -> Callable[[str, str], None]:
    """Make calls of the client fail."""

    def fail(call: str, subject: str) -> None:
        if is_it(call, subject):
            raise error

    return fail


def test_loading_what_was_saved_and_saving_it_again_is_the_identity(
    client: FakeClient, file: Path, tmp_path: Path
) -> None:
    client.world.host.ensure(NodeletKind.PYTHON)
    client.world.manager.remove_transformation("camera")
    outcome = run(client, f"load {file} --dry-run")
    assert "nodelet /cam: would be spawned" in outcome.lines
    assert client.calls == []
    outcome = run(client, f"load {file}")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.lines == [
        "transformation camera: added",
        "transformation native: exists already",
        "transformation relay: exists already",
        "nodelet /n: spawned",
        "nodelet /robot/relay: spawned",
        "nodelet /cam: spawned",
    ]
    again = tmp_path / "again.xml"
    run(client, f"save {again}")
    assert again.read_text() == file.read_text()
    client.calls.clear()
    assert run(client, f"load {file} --json").json["nodelets"] == {
        "spawned": [],
        "replaced": [],
        "changed": [],
        "kept": ["/cam", "/n", "/robot/relay"],
    }
    assert client.calls == []


def test_what_runs_is_brought_to_what_the_file_says(client: FakeClient, file: Path) -> None:
    client.world.spawn("relay", "/robot/relay", config={"in": "/x", "out": "/y"})
    client.world.spawn("camera", "other")
    outcome = run(client, f"load {file} --json")
    assert outcome.json["nodelets"]["changed"] == ["/robot/relay"]
    assert client.get_graph().nodelet("/robot/relay").is_protected
    assert topics(client, "/robot/relay") == {"in": "/raw", "out": ""}
    assert client.get_graph().nodelet("/other") is not None


def test_everything_is_checked_first(client: FakeClient, file: Path) -> None:
    client.world.spawn("camera", "/robot/relay")
    client.world.manager.add_transformation(
        "<transformation><label>native</label><source>pkg/Native</source></transformation>"
    )
    text = file.read_text()
    text = text.replace('transformation="camera"', 'transformation="unheard of"')
    text = text.replace('name="/n"', 'name="/n" manager="/elsewhere"')
    file.write_text(text)
    outcome = run(client, f"load {file}")
    assert (outcome.code, outcome.out) == (1, "")
    for said in (
        "transformation 'native' is in the library already, and differs; replace it with",
        "nodelet '/cam': neither the file nor the library has its transformation 'unheard of'",
        "nodelet '/robot/relay' runs already, made from 'camera'; expected 'relay'",
        "nodelet '/n': its nodelet manager '/elsewhere' is not running; start it, or let the",
    ):
        assert f"dyknow: {file}: {said}" in outcome.err
    assert client.calls == []


def test_isolated_in_a_named_manager_is_a_contradiction(client: FakeClient, file: Path) -> None:
    shared = client.world.spawn("native", "other").manager
    file.write_text(file.read_text().replace('name="/n"', f'name="/n" manager="{shared}"'))
    outcome = run(client, f"load {file}")
    assert outcome.code == 1
    assert f"nodelet '/n': isolated, and in nodelet manager '{shared}'" in outcome.err
    assert client.calls == []


def test_types_on_a_topic_have_to_fit(client: FakeClient, file: Path) -> None:
    text = '<port type="out" datatype="{}">image'
    old, new = text.format("sensor_msgs/Image"), text.format("std_msgs/Header")
    file.write_text(file.read_text().replace(old, new))
    outcome = run(client, f"load {file} --replace")
    said = "topic '/raw': '/n:image' has type sensor_msgs/Image, '/cam:image' has std_msgs/Header"
    assert said in outcome.err


def test_another_manager_can_be_allowed(client: FakeClient, file: Path) -> None:
    file.write_text(file.read_text().replace('manager="/fake_0"', 'manager="/elsewhere"'))
    assert run(client, f"load {file}").code == 1
    assert run(client, f"load {file} --any-manager").code == 0


def test_fixed_topics_are_found_before_anything_is_changed(client: FakeClient, file: Path) -> None:
    client.world.spawn("native", "n", config={"image": "/other"}, isolated=True)
    outcome = run(client, f"load {file}")
    assert outcome.code == 1
    assert f"dyknow: {file}: the topics of '/n' are fixed" in outcome.err
    assert client.calls == []


def test_more_nodelets_than_the_manager_allows_are_refused_before_the_first_is_made(
    client: FakeClient, file: Path
) -> None:
    client.world.host.parameters[f"{client.manager}/limits/nodelets"] = 2
    outcome = run(client, f"load {file}")
    assert outcome.code == 1
    assert "more than 2 nodelets; the manager allows no more" in outcome.err
    assert graph(client) == []
    client.world.host.parameters[f"{client.manager}/limits/nodelets"] = 3
    assert run(client, f"load {file} --dry-run").code == 0


def test_nodelets_of_a_replaced_transformation_are_made_again(
    client: FakeClient, file: Path
) -> None:
    give_the_library_another_camera(client)
    client.world.spawn("camera", "cam", config={"image": "elsewhere"})
    client.world.spawn("camera", "other")
    assert rate(client, "/cam") == 31
    outcome = run(client, f"load {file} --replace --dry-run")
    assert "nodelet /cam: would be replaced" in outcome.lines
    outcome = run(client, f"load {file} --replace --json")
    assert outcome.json["transformations"]["replaced"] == ["camera"]
    assert outcome.json["nodelets"]["replaced"] == ["/cam"]
    assert outcome.json["nodelets"]["spawned"] == ["/n", "/robot/relay"]
    assert rate(client, "/cam") == 30
    assert topics(client, "/cam") == {"image": "/raw"}
    assert rate(client, "/other") == 31  # the file does not name it


def test_a_nodelet_of_an_earlier_transformation_is_made_again(
    client: FakeClient, file: Path
) -> None:
    camera = client.world.manager.library.get("camera")
    give_the_library_another_camera(client)
    client.world.spawn("camera", "cam", config={"image": "/raw"})
    client.world.manager.add_transformation(camera.to_xml())
    difference = "parameter rate is 31.0, expected 30"
    lines = run(client, f"load {file}").lines
    assert f"nodelet /cam: exists already ({difference}: see --replace)" in lines
    assert rate(client, "/cam") == 31
    outcome = run(client, f"load {file} --replace --json")
    assert outcome.json["nodelets"]["replaced"] == ["/cam"]
    assert outcome.json["differences"] == [{"nodelet": "/cam", "differences": [difference]}]
    assert rate(client, "/cam") == 30
    assert run(client, f"load {file} --replace --json").json["nodelets"]["replaced"] == []


def test_a_protected_nodelet_is_not_made_again(client: FakeClient, file: Path) -> None:
    give_the_library_another_camera(client)
    client.world.spawn("camera", "cam", is_protected=True)
    outcome = run(client, f"load {file} --replace")
    assert outcome.code == 1
    assert "nodelet '/cam' is protected" in outcome.err
    assert "dyknow unprotect /cam" in outcome.err
    assert client.calls == []


@pytest.mark.parametrize(
    ("call", "subject", "step"),
    [
        ("spawn", "/n", "spawning '/n'"),
        ("set_protection", "/robot/relay", "protecting '/robot/relay'"),
    ],
)
def test_a_step_that_is_refused_undoes_those_before(
    client: FakeClient, file: Path, call: str, subject: str, step: str
) -> None:
    give_the_library_another_camera(client)
    client.world.spawn("camera", "cam", config={"image": "elsewhere"})
    client.world.spawn("relay", "/robot/relay", config={"in": "/x"})
    before, library = graph(client), client.get_model().transformations
    client.fail = failing(lambda *found: found == (call, subject), Refused("not today"))
    outcome = run(client, f"load {file} --replace")
    assert outcome.code == 1
    assert outcome.err == f"dyknow: {step}: not today; everything is as it was\n"
    assert graph(client) == before
    assert rate(client, "/cam") == 31
    assert client.get_model().transformations == library


def test_what_cannot_be_undone_is_told(client: FakeClient, file: Path) -> None:
    client.fail = failing(lambda *found: found == ("spawn", "/cam") or found[0] == "destroy")
    error = run(client, f"load {file}").err
    assert "spawning '/cam': no; spawning '/robot/relay' could not be taken back: no" in error


@pytest.mark.parametrize("was_done", [True, False])
def test_a_step_without_an_answer_is_undone_too(
    client: FakeClient, file: Path, was_done: bool
) -> None:
    def fail(call: str, subject: str) -> None:
        if (call, subject) == ("spawn", "/cam"):
            client.fail = lambda call, subject: None
            if was_done:
                client.spawn("camera", "/cam")
            raise ManagerUnreachable("did not answer within 30 s")

    client.fail = fail
    outcome = run(client, f"load {file}")
    assert outcome.code == 1
    assert outcome.err.endswith("did not answer within 30 s; everything is as it was\n")
    assert graph(client) == []


def test_ctrl_c_undoes(client: FakeClient, file: Path) -> None:
    client.fail = failing(lambda *found: found == ("spawn", "/cam"), KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(client, f"load {file}")
    assert graph(client) == []


def test_keep_going_keeps_what_was_done(client: FakeClient, file: Path) -> None:
    client.fail = failing(lambda call, subject: subject == "/n")
    outcome = run(client, f"load {file} --keep-going --json")
    assert outcome.code == 1
    assert outcome.err == "dyknow: spawning '/n': no\n"
    assert outcome.json["nodelets"]["spawned"] == ["/robot/relay", "/cam"]
    assert outcome.json["failed"] == [{"subject": "/n", "step": "spawning '/n'", "message": "no"}]
    assert [each[0] for each in graph(client)] == ["/cam", "/robot/relay"]


def test_ports_that_are_not_declared_are_connected_after_the_spawn(
    client: FakeClient, tmp_path: Path
) -> None:
    client.world.manager.add_transformation(
        "<transformation><label>bare</label><source>pkg/Relay</source></transformation>"
    )
    client.world.spawn("bare", "b")
    client.set_config("/b", {"in": "/x"})
    file = tmp_path / "w.xml"
    run(client, f"save {file}")
    client.destroy("/b")
    assert run(client, f"load {file}").code == 0
    assert topics(client, "/b")["in"] == "/x"


def test_what_cannot_be_saved(client: FakeClient, tmp_path: Path) -> None:
    client.world.spawn("camera", "cam")
    process = client.world.host.processes["/fake_0"]
    process.nodelets["/foreign"] = process.nodelets["/cam"]
    client.world.manager.look()
    outcome = run(client, f"save {tmp_path / 'w.xml'} --json")
    assert outcome.json["left_out"] == ["/foreign"]
    assert outcome.err.startswith("dyknow: warning: '/foreign' is not saved")

    client.world.manager.remove_transformation("camera")
    file = tmp_path / "gone.xml"
    outcome = run(client, f"save {file}")
    assert outcome.code == 1
    assert "the library has no more 'camera' of '/cam'" in outcome.err
    assert not file.exists()


def test_relays_of_shared_streams_are_saved(client: FakeClient, tmp_path: Path) -> None:
    client.host.sources["dyknow/Relay"] = client.host.sources["pkg/Relay"]
    for tag in ("Raw(camera)", "Raw(?c)"):
        client.acquire_stream(StreamRequest(tag))
    (relay,) = [
        each for each in client.get_graph().nodelets if each.transformation.startswith("relay of ")
    ]
    file, again = tmp_path / "w.xml", tmp_path / "again.xml"
    outcome = run(client, f"save {file}")
    assert (outcome.code, outcome.err) == (0, "")
    for claim in client.list_streams():
        client.release_stream(claim.claim_id)
    for each in client.get_graph().nodelets:
        client.destroy(each.name)
    assert run(client, f"load {file}").code == 0
    assert client.get_graph().nodelet(relay.name).connections == relay.connections
    assert run(client, f"save {again}").code == 0
    assert again.read_text() == file.read_text()


@pytest.mark.parametrize(
    ("command", "name", "said"), [("load", "nix.xml", "read"), ("save", "no/x.xml", "written")]
)
def test_files_that_cannot_be_used(
    client: FakeClient, tmp_path: Path, command: str, name: str, said: str
) -> None:
    outcome = run(client, f"{command} {tmp_path / name}")
    assert outcome.code == 1
    assert outcome.err.endswith(f"{name}: cannot be {said}: No such file or directory\n")


def test_readers_come_before_writers_also_in_long_chains_and_rings() -> None:
    relay = Transformation("r", "p/R", ports=(Port("in", "in"), Port("out", "out")))

    def wired(number: int, into: int, out: int) -> SpawnRequest:
        return SpawnRequest("r", f"/n{number:04}", {"in": f"/t{into}", "out": f"/t{out}"})

    chain = [wired(number, number, number + 1) for number in range(3000)]
    assert readers_first(chain, {"r": relay}) == chain[::-1]
    ring = [wired(number, number, (number + 1) % 5) for number in range(5)]
    assert {each.name for each in readers_first(ring, {"r": relay})} == {
        each.name for each in ring
    }


@pytest.mark.parametrize("is_lazy", [False, True])
def test_undeclared_ports_of_a_cpp_nodelet_stay_unless_the_file_moves_them(
    client: FakeClient, file: Path, tmp_path: Path, is_lazy: bool
) -> None:
    host = client.world.host
    host.stock = False
    host.sources["pkg/Native"] = [
        ("image", "in", "sensor_msgs/Image"),
        ("~out", "out", "sensor_msgs/Image"),
        ("/tf", "in", "tf2_msgs/TFMessage"),
    ]
    run(client, f"load {file}")
    host.connect("/n", {"/tf": "/other/tf"})
    client.world.manager.look({"/n"})
    assert run(client, f"load {file} --json").json["nodelets"]["changed"] == []
    moved = tmp_path / "moved.xml"
    run(client, f"save {moved}")
    run(client, "destroy n")
    if is_lazy:  # the nodelet does not have the port yet
        host.lazy["pkg/Native"] = ("/tf",)
    outcome = run(client, f"load {moved}")
    assert (outcome.code, outcome.err) == (0, "")
    expected = {"image": "/raw", "~out": "/small", "/tf": "/other/tf"}
    if is_lazy:
        del expected["/tf"]
    assert topics(client, "/n") == expected
    assert run(client, f"load {moved} --json").json["nodelets"]["changed"] == []


NODES = """<transformations>
  <transformation type="node"><label>copier</label><source>topic_tools/relay words copy</source>
    <ports><port type="in">words</port><port type="out">copy</port></ports></transformation>
  <transformation type="node" node="/driver"><label>driver</label>
    <ports><port type="in">words</port><port type="out">copy</port></ports></transformation>
</transformations>"""


def test_nodes_are_saved_with_their_parameters_and_those_of_others_are_connected(
    tmp_path: Path,
) -> None:
    file, source = tmp_path / "w.xml", "topic_tools/relay words copy"
    client, other = FakeClient(World()), FakeClient(World())
    for each in (client, other):
        ports = [("words", "in", "std_msgs/String"), ("copy", "out", "std_msgs/String")]
        each.world.host.sources[source] = ports
        each.world.manager.add_transformation(NODES)
    client.world.host.run_node("/driver", source, {"words": "/a"}, NodeletKind.CPP_NODE)
    client.world.manager.look()
    given = (Parameter("rate", "int", "5"),)
    client.world.spawn("copier", "/copier", config={"words": "/a"}, parameters=given)
    assert run(client, f"save {file}").err == ""

    absent = run(other, f"load {file}")
    assert absent.code == 1
    assert "nodelet '/driver': it is a node that others start, and does not run" in absent.err
    other.world.host.run_node("/driver", source, {"words": "/b"}, NodeletKind.CPP_NODE)
    other.world.manager.look()
    assert run(other, f"load {file}").code == 0
    assert graph(other) == graph(client)
    assert other.world.manager.graph.get("/copier").parameters == given
    assert run(other, f"load {file} --replace").code == 0
