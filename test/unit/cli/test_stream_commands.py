# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The commands about streams on request, on a manager without ROS."""

from __future__ import annotations

import pytest
from unit.cli.fake_client import play, run
from unit.cli.test_completion import offered
from unit.manager.world import LIBRARY

from dyknow.errors import ManagerUnreachable

ACQUIRE = "acquire 'Raw(camera)'"
CAMERA = LIBRARY[LIBRARY.index("<transformation>") :].partition("</transformation>")[0]
CAMERA += "</transformation>"
SLOW = """<transformation><label>slow</label><source>pkg/Camera</source>
<ports><port type="out" rate="5">image</port></ports>
<tags><tag port="image">Heat(oven)</tag></tags></transformation>"""
JOINTS = """<transformation type="topic"><label>t</label><source>/t</source>
<ports><port type="out">o</port></ports>
<tags><tag port="o">Joints(nao)</tag></tags></transformation>"""
PAIR = """<transformation><label>pair</label><source>pkg/Relay</source><ports>
<port type="in">in</port><port type="in">other</port><port type="out">out</port></ports>
<tags><tag port="in">Raw(?c)</tag><tag port="other">Raw(?d)</tag><tag port="out">Half(?c)</tag>
<tag port="out">Pair(?c, ?d)</tag><tag port="out">Nothing(?c)(</tag></tags></transformation>"""

SESSIONS = {
    "plan": """
$ plan 'Raw(camera)'
Raw(camera): cost 1 (proven least)
└─ camera.image (new, cost 1)
$ plan 'Raw(camera)' --dot
digraph...
}
$ plan 'Raw(camera)' --exclude camera
dyknow: no plan for Raw(camera): Raw(camera) cannot be used: camera is excluded
[1]
$ plan 'Raw(camera)' --exclude camra relay
Raw(camera): ...
dyknow: warning: no transformation is labelled 'camra'; did you mean camera?
$ plan 'Raw(camera)' --prefer camra --avoid Rawe cat
Raw(camera): ...
dyknow: warning: no transformation, and no name in its tags, is 'camra'; did you mean camera?
dyknow: warning: no transformation, and no name in its tags, is 'Rawe'; did you mean Raw?
dyknow: warning: no transformation, and no name in its tags, is 'cat'...
$ plan 'Raw(camera)' --prefer camera --avoid Raw relay
Raw(camera): ...
$ plan 'Raw(cat)' --exclude camra
dyknow: ...(excluded: camra); did you mean Raw(camera)?; no transformation is labelled 'camra'; ...
[1]
$ plan 'Rawe(camera)'
dyknow: ...nothing supplies Rawe(camera); did you mean Raw(camera)?
[1]
$ plan Raw
dyknow: ...nothing supplies Raw; supplied: Raw(camera)
[1]
$ plan 'FieldPosition(ball)'
dyknow: ...nothing supplies FieldPosition(ball)
[1]
$ list
""",
    "rates": """
$ plan 'Heat(oven)' --min-rate 5
Heat(oven)...
$ plan 'Heat(oven)' --min-rate 10
dyknow: ...it is stated at 5 Hz, below 10 Hz...
[1]
""",
    "tags": """
$ spawn camera cam
...
$ tags raw
TAG          FOR  TYPE               SUPPLIED BY
Raw(camera)  -    sensor_msgs/Image  camera, /cam (runs)
""",
    "claims": """
$ acquire 'Raw(camera)' --lease 0 --exclude camra
Raw(camera) on /camera_1/image [sensor_msgs/Image]
...
dyknow: warning: no transformation is labelled 'camra'; did you mean camera?
$ streams
CLAIM  ...  STATE   TAG          TOPIC            TYPE               DETAIL
...  active  Raw(camera)  /camera_1/image  sensor_msgs/Image  no message yet
$ streams -l
Stream [...]
...
Nodelets: /camera_1
$ replan nonesuch
dyknow: ...
[1]
""",
    "quantifiers": """
$ holds 'every ?c: Camera (battery.data > 1)' --bag no.bag
dyknow: a bag has no individuals ?c: expected a formula without 'every' and 'some', or live streams
[1]
$ holds 'every ?c (battery.data > 1)'
dyknow: the port 'battery' has a stream for each individual: give its tag, as ...
[1]
$ holds 'every ?c (battery.data > 1)' --port 'battery=Battery(?x)'
dyknow: the tag Battery(?x) of the port 'battery' has the variable ?x; ...the quantifier's, ?c
[1]
$ holds 'every ?c (battery.data > 1)' --port 'battery=Battery(nao)'
dyknow: the tag Battery(nao) of the port 'battery' has no variable; ...the quantifier's, ?c
[1]
$ holds 'every ?c: Camera (image)' --port 'image=Image(?c: Lidar)'
dyknow: ...?c with the concept Lidar; expected the quantifier's, Camera
[1]
$ holds 'every ?c (image) and some ?d (image)' --port 'image=Image(?c)'
dyknow: formula, line 1, column 22: the port 'image' has a stream for each ?c...
...
[1]
$ holds 'every ?c (image) and image' --port 'image=Image(?c)'
dyknow: formula, line 1, column 1: ?c has no individuals...
...
[1]
""",
}


def leave(client):
    """Leave a claim behind; return its id."""
    return str(run(client, f"{ACQUIRE} --lease 0 --json").json["claim"])


@pytest.mark.parametrize("name", SESSIONS)
def test_sessions(client, name):
    client.world.manager.add_transformation(SLOW)
    play(client, SESSIONS[name])


def test_what_variables_can_stand_for(client):
    client.world.manager.add_transformation(PAIR)
    second = CAMERA.replace("camera</label>", "second</label>").replace("(camera)", "(second)")
    client.world.manager.add_transformation(second)
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


def test_tags_and_plans_as_json(client):
    client.world.manager.add_transformation(JOINTS)
    assert run(client, "tags JOINTS --json").json["tags"] == [
        {
            "tag": "Joints(nao)",
            "datatypes": [],
            "transformations": ["t"],
            "nodelets": [],
            "bindings": None,
        }
    ]
    assert run(client, "plan 'Raw(camera)' --json").json == {
        "tag": "Raw(camera)",
        "cost": 1,
        "spawned": ["camera"],
        "reused": [],
        "plan": "Raw(camera): cost 1 (proven least)\n└─ camera.image (new, cost 1)",
        "bindings": [],
        "least_cost": 1.0,
    }


def test_the_claim_has_what_was_demanded(client):
    run(client, f"{ACQUIRE} --lease 60 --min-rate 10 --max-age 0.2 --budget 2")
    (claim,) = client.reconciler.claims()
    request = claim.request
    assert (request.min_rate, request.max_age, request.budget) == (10.0, 0.2, 2.0)
    assert claim.deadline == 60.0 and not claim.state.ended


def test_a_claim_without_an_answer_ends_with_its_lease(client, monkeypatch):
    acquire = client.acquire_stream

    def interrupted(request):
        acquire(request)
        raise KeyboardInterrupt

    monkeypatch.setattr(client, "acquire_stream", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(client, f"{ACQUIRE} --lease 0")
    (claim,) = client.list_streams()
    assert claim.expires > 0


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf", "fast"])
def test_what_is_no_rate_is_refused(client, rate):
    refused = run(client, f"{ACQUIRE} --min-rate={rate}")
    assert refused.code == 2
    assert f"'{rate}': expected Hz above 0, such as 10" in refused.err


def test_an_empty_tag_is_refused(client):
    refusal = "dyknow: '' is not a tag: expected Functor or Functor(arg, …)"
    play(client, "".join(f"$ {each} ''\n{refusal}\n[1]\n" for each in ("acquire", "plan")))


def test_a_stream_is_held_until_ctrl_c(client):
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


def test_a_high_cost_is_written_in_full(client):
    text = client.core.library.get("camera").to_xml().replace('cost="1"', 'cost="4000000001"')
    client.core.add_transformation(text)
    assert "  cost 4000000001 (proven least)" in run(client, f"{ACQUIRE} --lease 9").lines


def test_changes_of_a_held_stream_are_printed(client):
    client.script = [
        lambda: client.world.manager.destroy("/camera_1"),
        client.reconciler.reconcile,
    ]
    lines = run(client, ACQUIRE).lines
    assert [line.split(" ", 1)[1] for line in lines if line[2:3] == ":"] == [
        "recovering: nodelet /camera_1 is gone",
        "active: mended: nodelet /camera_1 is gone; /camera_2 is used now",
    ]


def test_a_claim_that_another_client_releases_ends_the_command(client):
    client.script = [lambda: client.reconciler.release(client.reconciler.claims()[0].claim_id)]
    assert run(client, ACQUIRE).code == 1


def test_a_manager_that_cannot_be_reached_at_the_end(client):
    def fail(call, subject):
        if call == "release":
            raise ManagerUnreachable("nobody")

    client.fail = fail
    done = run(client, ACQUIRE)
    (claim,) = client.reconciler.claims()
    said = f"dyknow: warning: nobody; claim {claim.claim_id} ends with its lease\n"
    assert (done.code, done.err) == (0, said)
    assert "released" not in done.out


def test_a_stream_that_cannot_be_made_is_given_up(client):
    outcome = run(client, "acquire 'Nothing(x)'")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.endswith("nothing supplies Nothing(x)\n")
    assert [claim.state.name for claim in client.reconciler.claims()] == ["RELEASED"]


def test_a_stream_that_cannot_be_made_is_waited_for(client):
    client.world.manager.remove_transformation("camera")
    client.script = [
        lambda: client.world.manager.add_transformation(CAMERA) and None,
        client.reconciler.reconcile,
    ]
    first, *_, active, released = run(client, f"{ACQUIRE} --wait --json").lines
    assert '"state": "pending"' in first and '"cost": null' in first
    assert '"state": "active"' in active
    assert '"released"' in released


def test_claims_are_listed_planned_again_and_released(client):
    claim = leave(client)
    assert run(client, f"replan {claim} --dry-run").lines[0].startswith("Raw(camera)")
    assert [each["claim"] for each in run(client, "streams --json").json["streams"]] == [claim]
    outcome = run(client, f"release nonesuch {claim}")
    assert (outcome.code, outcome.lines) == (1, [f"released {claim}"])
    assert outcome.err == "dyknow: there is no claim 'nonesuch'; see 'dyknow streams'\n"
    assert run(client, "streams --json").json["streams"] == []
    (ended,) = run(client, "streams --all --json").json["streams"]
    assert ended["state"] == "released"


def test_completion(client):
    claim = leave(client)
    assert offered(client, "acq") == ["acquire"]
    assert offered(client, "plan 'R") == ["Raw(camera)"]
    assert offered(client, "acquire x --exclude ca") == ["camera"]
    assert offered(client, "release ") == [claim]
    assert offered(client, f"release {claim} ") == []
    assert offered(client, "replan ") == [claim]
