# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes of the graph, and the ways back, on a manager that is made up."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dyknow.errors import DyKnowError, InvalidName
from dyknow.manager.steps import StepFailed
from dyknow.model.graph import PortRef, SpawnRequest
from dyknow.model.hosts import pins
from dyknow.model.transformation import IN, Parameter
from dyknow.wiring.ports import CannotConnect
from dyknow.wiring.wiring import Wiring, wiring_of
from dyknow_rqt.graph.changes import (
    CannotUndo,
    Present,
    UndoHistory,
    add_transformations,
    destroy,
    isolate,
    load_wiring,
    protect,
    release,
    remove_transformations,
    set_parameters,
    spawn,
)
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph.wiring import connect, connect_topic, disconnect, topics_for
from dyknow_rqt.monitoring.simulated import soccer

CEILING = PortRef("/field/ceiling_camera", "field_position")
TRACKER = PortRef("/field/tracker", "position")
LOCALIZED = PortRef("/nao1/localization", "field_position")
HSV_IN = PortRef("/nao1/line_detector", "hsv")
BGR = PortRef("/nao1/subsampler", "bgr")


@pytest.fixture
def remote():
    return soccer()


def seen(remote):
    return Snapshot(remote.graph().nodelets)


def library(remote):
    return {each.label: each for each in remote.client.get_model().transformations}


def apply(remote, change):
    return change.apply(Present(remote.client, seen(remote), library(remote)))


def there_and_back(remote, change):
    """Make a change and take it back; everything has to be as before."""
    before, known = seen(remote), library(remote)
    done = apply(remote, change)
    assert (seen(remote), library(remote)) != (before, known)
    done.undo()
    assert (seen(remote), library(remote)) == (before, known)


def test_the_order_of_the_two_ports_does_not_matter_and_topics_have_to_fit(remote):
    assert connect(seen(remote), TRACKER, CEILING) == connect(seen(remote), CEILING, TRACKER)
    assert topics_for(seen(remote), TRACKER) == ["/field/ball", "/nao1/ball_detector/ball"]
    with pytest.raises(CannotConnect, match="carries geometry_msgs/PointStamped"):
        connect_topic(seen(remote), HSV_IN, "/field/ball")
    with pytest.raises(InvalidName):
        connect_topic(seen(remote), HSV_IN, "not a topic")


def test_names_of_topics_begin_in_the_namespace_of_the_nodelet(remote):
    for text, topic in (("x", "/field/x"), ("~x", "/field/tracker/x"), ("/x", "/x")):
        assert dict(connect_topic(seen(remote), TRACKER, text).topics) == {TRACKER: topic}


def test_changes_can_be_taken_back(remote):
    for change in (
        connect(seen(remote), CEILING, TRACKER),
        connect_topic(seen(remote), TRACKER, "/other"),
        disconnect(seen(remote), (TRACKER, LOCALIZED)),
        spawn(SpawnRequest("tracker", "/second", {"position": "/field/ball"})),
        spawn(SpawnRequest("tracker", "/second", is_protected=True)),
        destroy("/field/tracker"),
        protect("/field/tracker", True),
        remove_transformations(["tracker", "recorder"]),
        add_transformations(
            "<transformations>"
            "<transformation><label>new</label><source>p/New</source></transformation>"
            "<transformation><label>tracker</label><source>p/Other</source></transformation>"
            "</transformations>"
        ),
    ):
        there_and_back(remote, change)


def test_a_nodelet_that_is_made_again_stays_on_the_host_that_was_named(remote):
    client = remote.client
    client.host.machine = "desk"
    client.host.add("/far", machine="rover")
    client.core.look()
    client.spawn_nodelet(SpawnRequest("tracker", "/far_one", manager="@rover"))
    client.spawn_nodelet(SpawnRequest("tracker", "/near_one", manager="@desk"))
    before = {"/far_one": "rover", "/near_one": "desk"}
    for change in (isolate(["/near_one"], True), isolate(["/far_one"], False)):
        done = apply(remote, change)
        assert pinned(remote) == before
        done.undo()
        assert pinned(remote) == before
    for name in before:
        there_and_back(remote, destroy(name))
        assert pinned(remote) == before
    with pytest.raises(StepFailed, match="'rover' needs a nodelet in a nodelet manager"):
        apply(remote, isolate(["/far_one"], True))
    assert pinned(remote) == before


def pinned(remote):
    return pins(remote.client.list_hosts())


def test_a_nodelet_that_is_made_again_keeps_ports_that_are_not_declared(remote):
    remote.client.host.sources["soccer/Tracker"] += (("more", IN, "std_msgs/Header"),)
    remote.client.spawn("tracker", "/x", {"position": "/field/ball"})
    remote.client.set_config("/x", {"more": "/more"})
    for change in (isolate(["/x"], True), destroy("/x")):
        there_and_back(remote, change)
    apply(remote, isolate(["/x"], True))
    assert seen(remote).nodelet("/x").connections["more"] == "/more"


@pytest.mark.parametrize("how", ['isolated="true"', 'type="node"'])
def test_what_needs_a_process_of_its_own_does_not_end_to_share_one(remote, how):
    remote.client.add_transformation(
        f"<transformation {how}><label>own</label><source>p/own</source></transformation>"
    )
    remote.client.spawn("own", "/x", {})
    with pytest.raises(CannotUndo, match="of /x gives it a process of its own"):
        apply(remote, isolate(["/field/tracker", "/x"], False))
    assert not [call for call in remote.client.calls if call[0] == "destroy"]


def test_a_wiring_that_replaces_a_transformation_makes_its_nodelets_again(remote):
    saved, _ = wiring_of(remote.client.get_model())
    wiring = replace(
        saved,
        transformations=tuple(
            each._replace(cost=77) if each.label == "tracker" else each
            for each in saved.transformations
        ),
    )
    done = apply(remote, load_wiring(wiring))
    assert library(remote)["tracker"].cost == 77
    assert done.steps[0].what == "ending '/field/tracker'"
    apply(remote, load_wiring(saved))
    there_and_back(remote, load_wiring(wiring))


def test_a_connection_is_made_whole_or_not_at_all(remote):
    change = connect(seen(remote), CEILING, TRACKER)
    remote.client.destroy("/field/tracker")
    between = seen(remote)
    with pytest.raises(DyKnowError, match="/field/tracker"):
        apply(remote, change)
    assert seen(remote) == between


def test_what_others_changed_is_not_taken_back(remote):
    change = connect_topic(seen(remote), TRACKER, "/mine")
    done = apply(remote, change)
    remote.client.set_config("/field/tracker", {"position": "/theirs"})
    with pytest.raises(CannotUndo, match="has been connected to /theirs by another client"):
        done.undo()
    with pytest.raises(CannotUndo, match="/theirs"):
        change.check(remote.client)


MODE, SLOW = (Parameter("mode", "string", text) for text in ("fast", "slow"))


X = SpawnRequest("tracker", "/x")


@pytest.mark.parametrize(
    ("change", "other", "why"),
    [
        (spawn(X), lambda c: c.destroy("/x"), "/x is gone"),
        (spawn(X), lambda c: (c.destroy("/x"), c.spawn("resize", "/x", {})), "/x from resize"),
        (spawn(X), lambda c: c.set_protection("/x", True), "client has protected /x"),
        (
            load_wiring(Wiring(nodelets=(X,))),
            lambda c: c.set_protection("/x", True),
            "client has protected /x",
        ),
        (
            isolate(["/nao1/resize", "/field/tracker"], True),
            lambda c: c.set_config("/field/tracker", {"position": "/theirs"}),
            "/field/tracker:position has been connected to /theirs by another client",
        ),
        (
            set_parameters("/nao1/resize", [MODE], {"mode": SLOW}),
            lambda c: c.set_parameter("/nao1/resize", MODE._replace(text="theirs")),
            "another client has set mode of /nao1/resize to 'theirs'",
        ),
        (
            protect("/field/tracker", True),
            lambda c: c.set_protection("/field/tracker", False),
            "another client has released /field/tracker",
        ),
    ],
)
def test_what_another_client_changed_since_is_left_as_it_is(remote, change, other, why):
    done = apply(remote, change)
    other(remote.client)
    theirs = seen(remote)
    with pytest.raises(CannotUndo, match=why):
        done.undo()
    assert seen(remote) == theirs


def test_probable_mistakes_are_in_the_outcome(remote):
    wrong = (
        '<transformation><label>w</label><source>p/W</source><params><param name="rate" '
        'type="int">5</param></params><ports><port type="out">o</port></ports>'
        '<tags><tag port="o">Not a (term</tag></tags></transformation>'
    )
    assert "passed over by the planner" in apply(remote, add_transformations(wrong)).text
    remote.client.spawn("w", "/w", {})
    parameters = set_parameters("/w", [Parameter("rat", "", "7")], {})
    assert "did you mean rate" in apply(remote, parameters).text


def test_parameters_without_a_former_value_do_not_keep_others_from_being_set_back(remote):
    rate = Parameter("rate", "", "5")
    done = apply(remote, set_parameters("/nao1/resize", [MODE, rate], {"mode": SLOW}))
    with pytest.raises(CannotUndo, match="had no rate before"):
        done.undo()
    assert SLOW in seen(remote).nodelet("/nao1/resize").parameters


def test_a_change_without_a_way_back_says_why(remote):
    remote.client.remove_transformation("tracker")
    with pytest.raises(CannotUndo, match="does not have the transformation"):
        apply(remote, destroy("/field/tracker")).undo()
    with pytest.raises(CannotUndo, match="another one"):
        next(iter(release("claim", "Tag").steps(Present(remote.client)))).undo()


def test_history_is_a_pair_of_stacks(remote):
    history, names = UndoHistory(), ("/field/tracker", "/nao1/resize")
    one, two = (apply(remote, protect(name, True)) for name in names)
    history.note(one)
    history.note(two)
    assert history.texts == ("protect /nao1/resize", "")
    history.drop()
    history.note_undone()
    assert history.texts == ("", "protect /field/tracker")
    history.note_redone(one)
    assert history.texts == ("protect /field/tracker", "")
    history.note_undone()
    history.note(two)
    assert history.texts == ("protect /nao1/resize", "")
