# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The commands, on a manager without ROS."""

from __future__ import annotations

from pathlib import Path

import pytest
from unit.cli.fake_client import FakeClient, run
from unit.manager.world import TRACKER, World

from dyknow.errors import ManagerUnreachable


@pytest.fixture
def client() -> FakeClient:
    return FakeClient(World())


@pytest.fixture
def chain(client: FakeClient) -> FakeClient:
    """A camera and a relay behind it."""
    client.world.spawn("camera", "cam", config={"image": "raw"})
    client.world.spawn("relay", "/robot/relay", config={"in": "/raw"}, is_protected=True)
    return client


class TestList:
    def test_names_one_a_line(self, chain: FakeClient) -> None:
        assert run(chain, "list").lines == ["/cam", "/robot/relay"]
        assert run(chain, "list robot").lines == ["/robot/relay"]
        assert run(chain, "list /").lines == ["/cam", "/robot/relay"]

    def test_long(self, chain: FakeClient) -> None:
        assert run(chain, "list -l").lines == [
            "NODELET       TRANSFORMATION  STATE              IN  OUT  MANAGER",
            "/cam          camera          running             0    1  /fake_0",
            "/robot/relay  relay           running,protected   1    1  /fake_0",
        ]

    def test_details_stand_below(self, chain: FakeClient) -> None:
        chain.host.details["/cam"] = "a callback has been running for 12 s"
        chain.world.manager.look({"/cam"})
        assert run(chain, "list -l").lines[3:] == ["/cam: a callback has been running for 12 s"]

    def test_json(self, chain: FakeClient) -> None:
        (camera, relay) = run(chain, "list --json").json["nodelets"]
        assert relay["protected"] and not camera["protected"]
        assert camera == {
            "name": "/cam",
            "transformation": "camera",
            "manager": "/fake_0",
            "protected": False,
            "isolated": False,
            "fixed": False,
            "kind": "nodelet",
            "host": "",
            "state": "running",
            "detail": "",
            "ports": [
                {
                    "name": "image",
                    "direction": "out",
                    "datatype": "sensor_msgs/Image",
                    "topic": "/raw",
                    "tags": ["Raw(camera)"],
                }
            ],
            "parameters": [],
        }

    def test_nothing_runs(self, client: FakeClient) -> None:
        assert run(client, "list").out == ""
        assert run(client, "list --json").json == {"nodelets": []}


class TestInfo:
    def test_shows_both_ends(self, chain: FakeClient) -> None:
        text = run(chain, "info cam /robot/relay").out
        assert "Nodelet [/cam]" in text
        assert "    to: /robot/relay:in" in text
        assert "    from: /cam:image" in text
        assert "    tag: Raw(camera)" in text
        assert " * out [sensor_msgs/Image]\n    topic: (disconnected)" in text

    def test_unknown_ones_are_named_and_the_others_shown(self, chain: FakeClient) -> None:
        outcome = run(chain, "info /camm /cam --json")
        assert outcome.code == 1
        assert outcome.err == ("dyknow: no nodelet named '/camm' runs; did you mean /cam?\n")
        assert [each["name"] for each in outcome.json["nodelets"]] == ["/cam"]


class TestSpawn:
    def test_says_what_runs_where(self, client: FakeClient) -> None:
        outcome = run(client, "spawn relay r --protected --connect in:/a out:b")
        assert outcome.lines == ["spawned /r from relay in /fake_0", "  in - /a", "  out - /b"]
        assert client.get_graph().nodelet("/r").is_protected

    def test_json_is_the_nodelet(self, client: FakeClient) -> None:
        assert run(client, "spawn relay r --isolated --json").json["isolated"]

    def test_parameters_may_be_given(self, client: FakeClient) -> None:
        client.world.manager.add_transformation(TRACKER)
        refused = run(client, "spawn tracker t")
        assert refused.code == 1
        assert "nothing says what ?camera" in refused.err
        outcome = run(client, "spawn tracker t --param '?camera=cam1' rate=5 --json")
        assert outcome.json["parameters"] == [
            {"name": "?camera", "type": "string", "value": "cam1"},
            {"name": "rate", "type": "int", "value": "5"},
        ]
        assert client.world.host.parameters["/t/frame"] == "cam1_link"
        shown = run(client, "info t").out
        assert "Parameters given at the spawn: ?camera=cam1, rate=5" in shown
        with pytest.raises(SystemExit) as ended:
            run(client, "spawn relay r --param rate")
        assert ended.value.code == 2

    def test_refusals_are_one_line(self, client: FakeClient) -> None:
        outcome = run(client, "spawn rellay r")
        assert outcome.code == 1
        assert outcome.err == (
            "dyknow: no transformation is labelled 'rellay'; did you mean relay?\n"
        )
        twice = run(client, "spawn relay r --connect in:/a --connect in:/b")
        assert (twice.code, "port 'in' is named twice" in twice.err) == (1, True)


class TestEach:
    def test_destroy_goes_on_after_a_refusal(self, chain: FakeClient) -> None:
        outcome = run(chain, "destroy /robot/relay nobody cam --json")
        assert outcome.code == 1
        assert outcome.json["destroyed"] == ["/cam"]
        assert [each["nodelet"] for each in outcome.json["failed"]] == ["/robot/relay", "/nobody"]
        assert outcome.err.count("\n") == 2

    def test_protection_is_given_and_taken(self, chain: FakeClient) -> None:
        assert run(chain, "unprotect /robot/relay").lines == ["unprotected /robot/relay"]
        assert run(chain, "protect cam").lines == ["protected /cam"]
        assert run(chain, "destroy cam").code == 1
        assert run(chain, "destroy robot/relay").code == 0

    def test_a_manager_that_is_gone_ends_it_with_3(self, chain: FakeClient) -> None:
        def fail(call: str, subject: str) -> None:
            raise ManagerUnreachable("DyKnow manager '/dyknow_manager' is not running")

        chain.fail = fail
        outcome = run(chain, "destroy cam nobody")
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (3, "", 1)


class TestLibrary:
    def test_labels_table_and_specifications(self, client: FakeClient) -> None:
        assert "wrong ports" in run(client, "library").lines
        assert run(client, "library -l camera").lines[1].split() == [
            *("camera", "nodelet", "pkg/Camera", "1", "0", "1"),
        ]
        assert run(client, "library camera").out.startswith("<transformation type=")

    def test_export_is_read_by_import(self, client: FakeClient, tmp_path: Path) -> None:
        file = tmp_path / "all.xml"
        before = client.get_model().transformations
        assert run(client, f"export -o {file}").code == 0
        for label in run(client, "library").lines:
            assert run(client, f"remove '{label}'").code == 0
        outcome = run(client, f"import {file} --json")
        assert outcome.json["failed"] == []
        assert client.get_model().transformations == before

    def test_import_names_file_and_line_of_every_problem(
        self, client: FakeClient, tmp_path: Path
    ) -> None:
        bad = tmp_path / "bad.xml"
        bad.write_text("<transformation>\n<label/>\n<nonsense/>\n</transformation>")
        outcome = run(client, f"import {tmp_path / 'missing.xml'} {bad}")
        assert outcome.code == 1
        lines = outcome.err.splitlines()
        assert lines[0] == (
            f"dyknow: {tmp_path / 'missing.xml'}: cannot be read: No such file or directory"
        )
        assert any(line.startswith(f"dyknow: {bad}:2: ") for line in lines)
        assert any(line.startswith(f"dyknow: {bad}:3: ") for line in lines)

    def test_unknown_labels_are_all_named(self, client: FakeClient) -> None:
        outcome = run(client, "export camra relay nix")
        assert (outcome.code, outcome.out) == (1, "")
        assert "'camra'; did you mean camera?" in outcome.err
        assert "'nix'" in outcome.err

    def test_remove_goes_on(self, client: FakeClient) -> None:
        outcome = run(client, "remove nix camera --json")
        assert (outcome.code, outcome.json["removed"]) == (1, ["camera"])


class TestCheck:
    def test_what_an_ontology_says_that_is_not_read(self, tmp_path: Path) -> None:
        nobody: FakeClient = None  # type: ignore[assignment]
        owl, xml = tmp_path / "o.ttl", tmp_path / "t.xml"
        owl.write_text(
            "@prefix : <http://x.org/#> .\n@prefix owl: <http://www.w3.org/2002/07/owl#> .\n"
            ":Camera a owl:Class .\n:Camera owl:equivalentClass [ owl:complementOf :Ball ] .\n"
            ":front a :Camera .\n"
        )
        xml.write_text(
            "<transformation><label>l(${X})</label><source>dyknow/Relay</source>\n"
            '<args><arg label="X">http://x.org/#Camera</arg></args></transformation>'
        )
        outcome = run(nobody, f"check {xml} --ontology {owl}")
        assert outcome.code == 0
        assert outcome.lines == [
            f"{owl}:3: warning: no label, so that the last part of the URI is the name: "
            "<http://x.org/#Camera>, <http://x.org/#front>",
            f"{owl}:4: warning: owl:complementOf in the description of <http://x.org/#Camera> "
            "is not read",
            f"{xml}:2: warning: the individual <http://x.org/#front> has no label; it goes by the "
            "last part of its URI",
            f"{xml}: 1 transformation: l(front)",
        ]
        shape = run(nobody, f"check {xml} --ontology {owl} --json").json
        assert [each["line"] for each in shape["ontology_warnings"]] == [3, 4]

    def test_programs_that_this_machine_does_not_have(self, tmp_path: Path) -> None:
        nobody: FakeClient = None  # type: ignore[assignment]
        xml = tmp_path / "t.xml"
        xml.write_text(
            '<transformations><transformation type="node"><label>a</label>'
            "<source>topic_tools/relay words copy</source></transformation>"
            '<transformation type="node"><label>b</label>'
            "<source>topic_tools/relais</source></transformation>"
            '<transformation type="node" node="/c"><label>c</label></transformation>'
            "</transformations>"
        )
        outcome = run(nobody, f"check {xml}")
        assert outcome.code == 0
        assert outcome.lines == [
            f"{xml}: warning: transformation 'b': package 'topic_tools' has no program 'relais'",
            f"{xml}: 3 transformations: a, b, c",
        ]

    def test_types_that_this_machine_does_not_have(self, tmp_path: Path) -> None:
        nobody: FakeClient = None  # type: ignore[assignment]
        xml = tmp_path / "t.xml"
        xml.write_text(
            "<transformations><transformation><label>a</label><source>dyknow/Rely</source>"
            '<ports><port type="in" datatype="sensor_msgs/Imge">in</port></ports></transformation>'
            "<transformation><label>b</label><source>dyknow/Rely</source></transformation>"
            '<transformation type="topic"><label>c</label><source>/c</source>'
            '<ports><port type="out">out</port></ports></transformation></transformations>'
        )
        outcome = run(nobody, f"check {xml}")
        assert outcome.code == 0
        nodelet_type, message_type, labels = outcome.lines
        assert nodelet_type.startswith(
            f"{xml}: warning: transformation 'a': no package declares a nodelet type 'dyknow/Rely'"
        )
        assert "did you mean dyknow/Relay" in nodelet_type
        assert message_type.startswith(
            f"{xml}: warning: transformation 'a': no message type 'sensor_msgs/Imge' is "
            "installed; did you mean sensor_msgs/Image"
        )
        assert labels == f"{xml}: 3 transformations: a, b, c"

    def test_imports_and_labels_of_an_ontology(self, tmp_path: Path) -> None:
        nobody: FakeClient = None  # type: ignore[assignment]
        owl, other, xml = tmp_path / "o.ttl", tmp_path / "other.ttl", tmp_path / "t.xml"
        catalogue = tmp_path / "c.xml"
        catalogue.write_text(
            '<catalog xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">'
            '<uri name="http://y.org/" uri="other.ttl"/></catalog>'
        )
        owl.write_text("<u:o> <http://www.w3.org/2002/07/owl#imports> <http://y.org/> .")
        other.write_text(
            "@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .\n"
            '<u:C> rdfs:label "C" . <u:x> a <u:C> ; rdfs:label "front"@en, "vorn"@de .'
        )
        xml.write_text(
            "<transformation><label>l(${X})</label><source>dyknow/Relay</source>"
            '<args><arg label="X">u:C</arg></args></transformation>'
        )
        check = f"check {xml} --ontology {owl} --catalogue {catalogue}"
        assert run(nobody, check).lines == [f"{xml}: 1 transformation: l(front)"]
        german = run(nobody, f"{check} --language de")
        assert german.lines == [f"{xml}: 1 transformation: l(vorn)"]

    def test_needs_nobody(self, tmp_path: Path) -> None:
        good, bad = tmp_path / "good.xml", tmp_path / "bad.xml"
        good.write_text(
            "<transformation><label>l</label><source>dyknow/Relay</source>"
            '<params><param name="a-b">1</param></params></transformation>'
        )
        bad.write_text("<transformation>\n<label>l</label>\n</transformation>")
        nobody: FakeClient = None  # type: ignore[assignment]
        fine = run(nobody, f"check {good}")
        assert fine.code == 0
        assert fine.lines[0].startswith(f"{good}:1: warning: ")
        assert fine.lines[1] == f"{good}: 1 transformation: l"
        outcome = run(nobody, f"check {good} {bad} --json")
        assert outcome.code == 1
        first, second = outcome.json["files"]
        assert (first["labels"], first["problems"]) == (["l"], [])
        assert second["problems"][0]["file"] == str(bad)
        assert second["problems"][0]["line"] >= 1


class TestGraph:
    def test_text_lists_topics_and_what_is_loose(self, chain: FakeClient) -> None:
        assert run(chain, "graph").lines == [
            "/raw [sensor_msgs/Image]",
            "    from /cam:image",
            "    to   /robot/relay:in",
            "(disconnected)",
            "    out  /robot/relay:out",
        ]

    def test_json(self, chain: FakeClient) -> None:
        shape = run(chain, "graph --json").json
        assert shape["topics"] == [
            {
                "topic": "/raw",
                "datatype": "sensor_msgs/Image",
                "out": [{"nodelet": "/cam", "port": "image"}],
                "in": [{"nodelet": "/robot/relay", "port": "in"}],
            }
        ]

    def test_namespace(self, chain: FakeClient) -> None:
        assert '"n/cam"' not in run(chain, "graph --dot --namespace robot").out


class TestStats:
    def test_a_line_for_each_port(self, chain: FakeClient) -> None:
        lines = run(chain, "stats").lines
        assert lines[0].split() == [
            *("NODELET", "PORT", "HZ", "MESSAGES", "DROPPED", "UNSENT"),
            *("MEAN", "MAX", "ERRORS", "TOPIC"),
        ]
        assert lines[1].split() == [
            *("/cam", "image", "out", "5.0", "300", "-", "4", "1.00", "2.50", "2", "/raw")
        ]
        assert lines[2].split()[4:7] == ["300", "4", "-"]
        assert len(lines) == 4

    def test_what_nobody_counts_is_not_shown_as_zero(self, chain: FakeClient) -> None:
        chain.uncounted.add("/cam")
        line = run(chain, "stats").lines[1].split()
        assert line == ["/cam", "image", "out", *"-------", "/raw"]
        nodelet = run(chain, "stats --json").json["nodelets"][0]
        assert nodelet["callback_errors"] is None
        assert nodelet["ports"][0] == {
            "name": "image",
            "direction": "out",
            "topic": "/raw",
            **dict.fromkeys(("messages", "dropped", "rate", "mean_callback", "max_callback")),
        }

    def test_who_does_not_answer_is_named(self, chain: FakeClient) -> None:
        chain.hung.add("/cam")
        outcome = run(chain, "stats --json")
        assert outcome.code == 1
        assert outcome.json["silent"] == ["/cam"]
        assert [each["nodelet"] for each in outcome.json["nodelets"]] == ["/robot/relay"]
        assert "did not answer" in outcome.err
        assert run(chain, "stats nobody").code == 1

    def test_watching_shows_again_and_ends_after_the_count(self, chain: FakeClient) -> None:
        import json

        outcome = run(chain, "stats --watch 0.001 --count 3 --json")
        assert outcome.code == 0
        assert [len(json.loads(line)["nodelets"]) for line in outcome.lines] == [2, 2, 2]
        text = run(chain, "stats cam -w 0.001 -n 2").out
        assert text.count("NODELET") == 2
        assert "\x1b" not in text
