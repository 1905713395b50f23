# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The commands about streams on request, on a manager without ROS."""

from __future__ import annotations

import signal
from typing import Iterator

import pytest
from unit.cli.fake_client import FakeClient, run
from unit.cli.test_completion import offered
from unit.manager.world import LIBRARY, World

from dyknow.errors import ManagerUnreachable

ACQUIRE = "acquire 'Raw(camera)'"


@pytest.fixture
def client() -> FakeClient:
    return FakeClient(World())


@pytest.fixture(autouse=True)
def kept_signals() -> Iterator[None]:
    handler = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, handler)


def left(client: FakeClient) -> str:
    """Id of a claim that is left behind."""
    return str(run(client, f"{ACQUIRE} --lease 0 --json").json["claim"])


class TestTags:
    def test_who_supplies_what(self, client: FakeClient) -> None:
        client.world.spawn("camera", "cam")
        outcome = run(client, "tags")
        assert outcome.lines == [
            "TAG          FOR  TYPE               SUPPLIED BY",
            "Raw(camera)  -    sensor_msgs/Image  camera, /cam (runs)",
        ]

    def test_what_variables_can_stand_for(self, client: FakeClient) -> None:
        client.world.manager.add_transformation(
            "<transformation><label>pair</label><source>pkg/Relay</source><ports>"
            '<port type="in">in</port><port type="in">other</port><port type="out">out</port>'
            '</ports><tags><tag port="in">Raw(?c)</tag><tag port="other">Raw(?d)</tag>'
            '<tag port="out">Half(?c)</tag><tag port="out">Pair(?c, ?d)</tag>'
            '<tag port="out">Nothing(?c)(</tag></tags></transformation>'
        )
        other = LIBRARY[LIBRARY.index("<transformation>") :].partition("</transformation>")[0]
        other = other.replace("camera</label>", "second</label>").replace("(camera)", "(second)")
        client.world.manager.add_transformation(other + "</transformation>")
        assert [line.split("  ")[:2] for line in run(client, "tags half").lines[1:]] == [
            ["Half(?c)", "?c=camera|second"]
        ]
        found = run(client, "tags pair --json").json["tags"][0]["bindings"]
        names = ("camera", "second")
        assert found == [{"?c": c, "?d": d} for c in names for d in names]
        assert "?c=camera ?d=camera, ?c=camera ?d=second, " in run(client, "tags pair").out
        client.world.manager.remove_transformation("camera")
        assert "  ?c=second  " in run(client, "tags half").out
        client.world.manager.remove_transformation("second")
        assert "  nothing now  " in run(client, "tags half").out
        assert run(client, "tags nothing --json").json["tags"][0]["bindings"] is None

    def test_json(self, client: FakeClient) -> None:
        client.world.manager.add_transformation(
            '<transformation type="topic"><label>t</label><source>/t</source><ports>'
            '<port type="out">o</port></ports><tags><tag port="o">Joints(nao)</tag></tags>'
            "</transformation>"
        )
        shape = run(client, "tags JOINTS --json").json
        assert shape == {
            "tags": [
                {
                    "tag": "Joints(nao)",
                    "datatypes": [],
                    "transformations": ["t"],
                    "nodelets": [],
                    "bindings": None,
                }
            ]
        }


class TestDemands:
    def test_a_rate_that_is_stated_to_be_too_low(self, client: FakeClient) -> None:
        client.world.manager.add_transformation(
            "<transformation><label>slow</label><source>pkg/Camera</source><ports>"
            '<port type="out" rate="5">image</port></ports>'
            '<tags><tag port="image">Slow(camera)</tag></tags></transformation>'
        )
        assert run(client, "plan 'Slow(camera)' --min-rate 5").code == 0
        outcome = run(client, "plan 'Slow(camera)' --min-rate 10")
        assert outcome.code == 1
        assert "it is stated at 5 Hz, below 10 Hz" in outcome.err

    def test_the_claim_has_what_was_demanded(self, client: FakeClient) -> None:
        run(client, f"{ACQUIRE} --lease 0 --min-rate 10 --max-age 0.2 --budget 2")
        (request,) = [each.request for each in client.reconciler.claims()]
        assert (request.min_rate, request.max_age, request.budget) == (10.0, 0.2, 2.0)

    @pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf", "fast"])
    def test_what_is_no_rate_is_refused(
        self, client: FakeClient, rate: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with pytest.raises(SystemExit):
            run(client, f"{ACQUIRE} --min-rate={rate}")
        assert f"'{rate}': expected Hz above 0, such as 10" in capsys.readouterr().err


class TestPlan:
    def test_as_a_tree(self, client: FakeClient) -> None:
        assert run(client, "plan 'Raw(camera)'").lines == [
            "Raw(camera): cost 1 (proven least)",
            "└─ camera.image (new, cost 1)",
        ]
        assert client.get_graph().nodelets == ()

    def test_as_a_drawing(self, client: FakeClient) -> None:
        outcome = run(client, "plan 'Raw(camera)' --dot")
        assert outcome.lines[0].startswith("digraph")
        assert outcome.lines[-1] == "}"

    def test_json(self, client: FakeClient) -> None:
        shape = run(client, "plan 'Raw(camera)' --json").json
        assert shape == {
            "tag": "Raw(camera)",
            "cost": 1,
            "spawned": ["camera"],
            "reused": [],
            "plan": "Raw(camera): cost 1 (proven least)\n└─ camera.image (new, cost 1)",
            "bindings": [],
            "least_cost": 1.0,
        }

    def test_what_was_left_out_is_told(self, client: FakeClient) -> None:
        error = run(client, "plan 'Raw(camera)' --exclude camera").err
        assert "Raw(camera) cannot be used: camera is excluded" in error

    def test_a_label_that_excludes_nothing(self, client: FakeClient) -> None:
        outcome = run(client, "plan 'Raw(camera)' --exclude camra relay")
        said = "no transformation is labelled 'camra'; did you mean camera?"
        assert outcome.code == 0
        assert outcome.err == f"dyknow: warning: {said}\n"
        error = run(client, "plan 'Raw(cat)' --exclude camra").err
        assert f"(excluded: camra); did you mean Raw(camera)?; {said}" in error
        outcome = run(client, "acquire 'Raw(camera)' --lease 0 --exclude camra")
        assert outcome.err == f"dyknow: warning: {said}\n"

    def test_a_tag_that_is_nearly_one(self, client: FakeClient) -> None:
        error = run(client, "plan 'Rawe(camera)'").err
        assert "nothing supplies Rawe(camera); did you mean Raw(camera)?" in error
        assert "did you mean" not in run(client, "plan 'FieldPosition(ball)'").err

    def test_what_is_missing(self, client: FakeClient) -> None:
        outcome = run(client, "plan 'Raw(camera)' --exclude camera")
        assert (outcome.code, outcome.out) == (1, "")
        assert outcome.err == (
            "dyknow: no plan for Raw(camera): Raw(camera) cannot be used: camera is excluded\n"
        )


class TestAcquire:
    def test_is_held_until_ctrl_c(self, client: FakeClient) -> None:
        outcome = run(client, ACQUIRE)
        (claim,) = client.reconciler.claims()
        assert outcome.lines == [
            "Raw(camera) on /camera_1/image [sensor_msgs/Image]",
            f"  claim {claim.claim_id}",
            "  cost 1 (proven least)",
            "  no message yet",
            "  nodelets /camera_1",
            "held until Ctrl-C",
            f"released {claim.claim_id}",
        ]
        assert (outcome.code, claim.state.name) == (0, "RELEASED")

    def test_tells_what_happens(self, client: FakeClient) -> None:
        client.script = [
            lambda: client.world.manager.destroy("/camera_1"),
            client.reconciler.reconcile,
        ]
        outcome = run(client, ACQUIRE)
        told = [line.split(" ", 1)[1] for line in outcome.lines if line[2:3] == ":"]
        assert told == [
            "recovering: nodelet /camera_1 is gone",
            "active: mended: nodelet /camera_1 is gone; /camera_2 is used now",
        ]

    def test_a_claim_that_others_release_ends_it(self, client: FakeClient) -> None:
        client.script = [lambda: client.reconciler.release(client.reconciler.claims()[0].claim_id)]
        assert run(client, ACQUIRE).code == 1

    def test_a_manager_that_cannot_be_reached_at_the_end(self, client: FakeClient) -> None:
        def fail(call: str, subject: str) -> None:
            if call == "release":
                raise ManagerUnreachable("nobody")

        client.fail = fail
        assert run(client, ACQUIRE).code == 3

    def test_leaves_a_claim(self, client: FakeClient) -> None:
        outcome = run(client, f"{ACQUIRE} --lease 60")
        (claim,) = client.reconciler.claims()
        assert claim.deadline == 60.0
        assert outcome.lines[1] == f"  claim {claim.claim_id}"
        assert not claim.state.ended

    def test_gives_up_what_cannot_be_made(self, client: FakeClient) -> None:
        outcome = run(client, "acquire 'Nothing(x)'")
        assert (outcome.code, outcome.out) == (1, "")
        assert outcome.err.endswith("nothing supplies Nothing(x)\n")
        assert [claim.state.name for claim in client.reconciler.claims()] == ["RELEASED"]

    def test_or_waits_for_it(self, client: FakeClient) -> None:
        client.world.manager.remove_transformation("camera")
        client.script = [
            lambda: client.world.manager.add_transformation(CAMERA) and None,
            client.reconciler.reconcile,
        ]
        outcome = run(client, f"{ACQUIRE} --wait --json")
        first, *_, active, released = outcome.lines
        assert '"state": "pending"' in first and '"cost": null' in first
        assert '"state": "active"' in active
        assert '"released"' in released


CAMERA = """
<transformation><label>camera</label><source>pkg/Camera</source>
<ports><port type="out" datatype="sensor_msgs/Image">image</port></ports>
<tags><tag port="image">Raw(camera)</tag></tags></transformation>
"""


class TestStreams:
    def test_lists_claims(self, client: FakeClient) -> None:
        claim = left(client)
        assert run(client, "streams").lines == [
            "CLAIM         STATE   TAG          TOPIC            TYPE               DETAIL",
            f"{claim}  active  Raw(camera)  /camera_1/image  sensor_msgs/Image  no message yet",
        ]
        assert run(client, "streams -l").lines[-2] == "Nodelets: /camera_1"
        assert [each["claim"] for each in run(client, "streams --json").json["streams"]] == [claim]
        run(client, f"release {claim}")
        assert run(client, "streams --json").json["streams"] == []
        (ended,) = run(client, "streams --all --json").json["streams"]
        assert ended["state"] == "released"

    def test_release(self, client: FakeClient) -> None:
        claim = left(client)
        outcome = run(client, f"release nonesuch {claim}")
        assert (outcome.code, outcome.lines) == (1, [f"released {claim}"])
        assert outcome.err == "dyknow: there is no claim 'nonesuch'; see 'dyknow streams'\n"

    def test_replan(self, client: FakeClient) -> None:
        claim = left(client)
        outcome = run(client, f"replan {claim} --dry-run")
        assert outcome.code == 0
        assert outcome.lines[0].startswith("Raw(camera)")
        assert run(client, "replan nonesuch").code == 1


def test_completion(client: FakeClient) -> None:
    claim = left(client)
    assert offered(client, "acq") == ["acquire"]
    assert offered(client, "plan 'R") == ["Raw(camera)"]
    assert offered(client, "acquire x --exclude ca") == ["camera"]
    assert offered(client, "release ") == [claim]
    assert offered(client, f"release {claim} ") == []
    assert offered(client, "replan ") == [claim]
