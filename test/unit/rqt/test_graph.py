# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What is drawn of the computation graph, without Qt and ROS."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import pydot
import pytest

from dyknow.model.graph import NodeletStatus, PortState, State
from dyknow_rqt.graph.figure import Boxes, Options, VertexKind, figure_of
from dyknow_rqt.graph.filters import BadFilter, completions, parse
from dyknow_rqt.graph.geometry import Layout, Point, Size, around
from dyknow_rqt.graph.layout import (
    BadLayout,
    arranged,
    read_graphs,
    read_layout,
    to_dot,
    without_crossings,
)
from dyknow_rqt.graph.parts import divide
from dyknow_rqt.graph.snapshot import PlainNode, Snapshot, plain_nodes
from dyknow_rqt.graph.stabilise import backwards, moved, stabilise


def nodelet(name, *ports):
    """A nodelet; ports are written `>name=topic` for in, `name>=topic` for out."""
    states = []
    for text in ports:
        port, _, topic = text.partition("=")
        direction = "in" if port.startswith(">") else "out"
        states.append(PortState(port.strip(">"), direction, "std_msgs/Header", topic))
    return NodeletStatus(
        name, "label", "/nodelet_manager", False, False, False, State.RUNNING, "", tuple(states)
    )


def chain(count, extra=()):
    """Nodelets `/nNN`, each publishing what the next receives."""
    return Snapshot(
        tuple(
            nodelet(f"/n{i:02}", *([f">in=/t{i - 1:02}"] if i else []), f"out>=/t{i:02}")
            for i in range(count)
        )
        + tuple(extra)
    )


def sizes_of(figure):
    return {v.key: Size(40 + 7 * len(v.name), 40) for v in figure.vertices}


def laid_out(figure):
    sizes = sizes_of(figure)
    answer = subprocess.run(
        ["dot", "-Tjson0"], input=to_dot(figure, sizes), capture_output=True, text=True, check=True
    )
    return read_layout(read_graphs(answer.stdout)["dyknow"], figure)


def drawn(figure, before=None, shape=1.5, are_laid_out=True):
    """Arrange a figure with graphviz, or without it."""
    parts = divide(figure)
    leaves = [leaf for part in parts for leaf in part.leaves()] if are_laid_out else []
    sizes = sizes_of(figure)
    texts = [to_dot(leaf.figure, sizes, around=leaf.box) for leaf in leaves]
    numbered = [text.replace("dyknow", f"g{number}", 1) for number, text in enumerate(texts)]
    answer = subprocess.run(
        ["dot", "-Tjson0"], input="".join(numbered), capture_output=True, text=True, check=True
    )
    graphs = read_graphs(answer.stdout)
    layouts = {each: read_layout(graphs[f"g{n}"], each.figure) for n, each in enumerate(leaves)}
    return arranged(figure, sizes, parts, layouts, shape, before)


@pytest.mark.parametrize(
    ("text", "shown", "hidden"),
    [
        ("", ["/a", "/b/c"], []),
        ("/", ["/a", "/b/c"], []),
        ("/a", ["/a", "/a/b"], ["/ab", "/b/a"]),
        ("/a, /b", ["/a/x", "/b"], ["/c"]),
        ("/c.*m", ["/cam", "/c/am"], ["/a/cam"]),
        ("/.*cam", ["/a/cam", "/cam/x"], ["/ca"]),
        ("-/a", ["/b", "/ab"], ["/a", "/a/b"]),
        ("/a, -/a/.*debug", ["/a/x"], ["/a/x/debug", "/b"]),
        ("/a{1,2}$", ["/a", "/aa"], ["/aaa"]),
        (" , -, ", ["/x"], []),
    ],
)
def test_filters(text, shown, hidden):
    wanted = parse(text)
    assert [name for name in shown + hidden if wanted(name)] == shown


def test_a_filter_that_is_no_expression_says_where():
    with pytest.raises(BadFilter, match=r"filter '/a\[' is not a regular expression"):
        parse("/b, /a[")


def test_completion_is_of_the_last_part():
    names = ["/robot/cam", "/robot/ball", "/world"]
    assert completions("/world, -/ro", names) == [
        "/world, -/robot",
        "/world, -/robot/ball",
        "/world, -/robot/cam",
    ]


def test_topics_stand_between_nodelets_or_are_the_arrows():
    figure = figure_of(chain(2), Options())
    assert [v.key for v in figure.vertices] == ["n_/n00", "n_/n01", "t_/t00", "t_/t01"]
    assert [tuple(edge) for edge in figure.edges] == [
        ("n_/n00", "out", "t_/t00", "", "/t00"),
        ("n_/n01", "out", "t_/t01", "", "/t01"),
        ("t_/t00", "", "n_/n01", "in", "/t00"),
    ]
    assert [tuple(edge) for edge in figure_of(chain(3), Options(topics=False)).edges] == [
        ("n_/n00", "out", "n_/n01", "in", "/t00"),
        ("n_/n01", "out", "n_/n02", "in", "/t01"),
    ]


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        (Options(), ["/t00", "/t01", "/waits"]),
        (Options(hide_dead_sinks=True), ["/t00", "/waits"]),
        (Options(hide_leaf_topics=True), ["/t00"]),
        (Options(topic_filter=parse("-/t00")), ["/t01", "/waits"]),
        (Options(nodelet_filter=parse("/n00")), ["/t00"]),
    ],
)
def test_what_is_hidden(options, topics):
    snapshot = chain(2, [nodelet("/waiting", ">in=/waits")])
    figure = figure_of(snapshot, options)
    assert [v.name for v in figure.vertices if v.kind is VertexKind.TOPIC] == topics


def test_quiet_names_are_hidden_on_request():
    snapshot = Snapshot((nodelet("/a", "log>=/rosout"),))
    assert len(figure_of(snapshot, Options(hide_debug=True)).vertices) == 1
    assert len(figure_of(snapshot, Options(hide_debug=False)).vertices) == 2


def test_ordinary_nodes_of_these_topics_can_be_shown():
    nodes = plain_nodes(
        [("/t00", ["/nodelet_manager", "/driver"]), ("/far", ["/away"])],
        [("/t01", ["/rviewer", "/driver"]), ("/far", ["/driver"])],
        {"/t00", "/t01"},
        {"/nodelet_manager"},
    )
    assert nodes == (
        PlainNode("/driver", ("/t00",), ("/t01",)),
        PlainNode("/rviewer", (), ("/t01",)),
    )
    snapshot = Snapshot(chain(2).nodelets, nodes)
    assert not [v for v in figure_of(snapshot, Options()).vertices if v.kind is VertexKind.NODE]
    figure = figure_of(snapshot, Options(show_nodes=True, hide_dead_sinks=True))
    assert [v.name for v in figure.vertices if v.kind is VertexKind.NODE] == [
        "/driver",
        "/rviewer",
    ]
    assert ("p_/driver", "", "t_/t00", "", "/t00") in [tuple(e) for e in figure.edges]


def test_boxes_hold_more_than_topics():
    snapshot = Snapshot(
        (
            nodelet("/robot/left/cam", "image>=/robot/left/image"),
            nodelet("/robot/view", ">in=/robot/left/image", "out>=/elsewhere/out"),
        )
    )
    groups = {v.name: v.group for v in figure_of(snapshot, Options(depth=2)).vertices}
    assert groups == {
        "/robot/left/cam": ("/robot", "/robot/left"),
        "/robot/left/image": ("/robot", "/robot/left"),
        "/robot/view": ("/robot",),
        "/elsewhere/out": (),
    }
    assert figure_of(snapshot, Options(depth=1)).groups() == [("/robot",)]
    assert figure_of(snapshot, Options(depth=0)).groups() == []


def test_boxes_of_hosts_hold_those_of_nodelet_managers():
    def on(host, manager, name, *ports):
        return replace(nodelet(name, *ports), manager=manager, host=host)

    snapshot = Snapshot(
        (
            on("desk", "/m/one", "/a", "out>=/inner"),
            on("desk", "/m/one", "/b", ">in=/inner", "out>=/between"),
            on("desk", "/two", "/c", ">in=/between", "out>=/away"),
            on("far", "", "/d", ">in=/away"),
            on("", "/lost", "/e", ">in=/away"),
        )
    )

    def groups(**options):
        figure = figure_of(snapshot, Options(**options))
        return {v.name: v.group for v in figure.vertices if v.group}

    one, two = ("desk", "/m/one"), ("desk", "/two")
    assert groups(boxes=Boxes.HOSTS) == {
        "/a": one,
        "/b": one,
        "/inner": one,
        "/c": two,
        "/between": ("desk",),
        "/d": ("far",),
        "/e": ("/lost",),
    }
    assert groups(boxes=Boxes.HOSTS, depth=1)["/inner"] == ("desk",)
    assert groups(boxes=Boxes.HOSTS, depth=0) == {}
    assert groups(boxes=Boxes.MANAGERS) == {
        "/a": ("/m/one",),
        "/b": ("/m/one",),
        "/inner": ("/m/one",),
        "/c": ("/two",),
        "/e": ("/lost",),
    }
    collapsed = figure_of(snapshot, Options(boxes=Boxes.HOSTS, collapsed=frozenset({("desk",)})))
    assert [v.note for v in collapsed.vertices if v.name == "desk"] == ["3 nodelets"]


def test_dot_can_be_read_by_others():
    snapshot = Snapshot(
        (nodelet("/robot/a", 'odd"port\\>=/robot/t'), nodelet("/robot/b", ">in=/robot/t"))
    )
    figure = figure_of(snapshot, Options())
    (graph,) = pydot.graph_from_dot_data(to_dot(figure, sizes_of(figure)))
    (box,) = graph.get_subgraphs()
    assert sorted(node.get_name() for node in box.get_nodes()) == [
        '"n_/robot/a"',
        '"n_/robot/b"',
        '"t_/robot/t"',
    ]
    assert len(graph.get_edges()) == 2


def test_ports_stand_in_the_order_of_their_arrows():
    snapshot = Snapshot(
        (
            nodelet("/source", "first>=/b", "free>", "second>=/a"),
            nodelet("/sink", ">one=/b", ">two=/a", ">three"),
        )
    )
    figure = figure_of(snapshot, Options())
    layout = laid_out(figure)
    ports = {v.name: v.inputs + v.outputs for v in without_crossings(figure, layout)}
    a_is_above = layout.centres["t_/a"].y < layout.centres["t_/b"].y
    upper, lower = ("second", "first") if a_is_above else ("first", "second")
    assert ports["/source"] == (upper, "free", lower)
    assert ports["/sink"] == ("two", "one", "three") if a_is_above else ("one", "two", "three")


@pytest.mark.parametrize("answer", ["{}", "Segmentation fault"])
def test_a_layout_of_something_else_is_refused(answer):
    with pytest.raises(BadLayout):
        read_layout(read_graphs(answer).get("dyknow"), figure_of(chain(2), Options()))


ADDITIONS = [
    nodelet("/a_first", ">in=/t03"),
    nodelet("/n10a", ">in=/t10", "out>=/new"),
    nodelet("/zz", "out>=/t05"),
    nodelet("/between", ">in=/t02", "out>=/t17"),
    nodelet("/alone", ">in", "out>"),
]


@pytest.mark.parametrize("added", ADDITIONS, ids=lambda each: each.name)
def test_a_nodelet_more_leaves_the_others_where_they_are(added):
    """The others are 20 nodelets and their topics: at most 4 of the 40 may move."""
    before, after = (figure_of(chain(20, extra), Options()) for extra in ((), (added,)))
    old = laid_out(before)
    new = stabilise(old, before, laid_out(after), after, sizes_of(after))
    assert len(moved(old, new)) <= 4
    assert set(new.curves) == set(after.edges)


def test_the_layout_leads_from_left_to_right():
    figure = figure_of(chain(4), Options())
    layout = laid_out(figure)
    for edge in figure.edges:
        assert layout.centres[edge.tail].x < layout.centres[edge.head].x
        assert len(layout.curves[edge]) % 3 == 1
        assert layout.curves[edge][0].x < layout.curves[edge][-1].x


@pytest.mark.parametrize("are_laid_out", [True, False])
def test_nothing_lies_on_top_of_something_else(are_laid_out):
    snapshot = chain(
        6, [nodelet("/n03/x", ">in=/t01", "out>=/t04"), nodelet("/back", ">in=/t05", "out>=/t00")]
    )
    figure = figure_of(snapshot, Options())
    _check_apart(drawn(figure, are_laid_out=are_laid_out).layout, sizes_of(figure))


def test_settled_nothing_lies_on_top_of_something_else():
    before, after = (figure_of(chain(20, extra), Options()) for extra in ((), ADDITIONS))
    sizes = sizes_of(after)
    _check_apart(stabilise(laid_out(before), before, laid_out(after), after, sizes), sizes)


def test_connections_made_one_by_one_end_in_a_drawing_from_left_to_right():
    """Each connection may change places, so that no arrow leads backwards in the end."""
    ports = [(f">in=/t{i - 1}" if i else ">in", f"out>=/t{i}") for i in range(6)]
    loose = [nodelet(f"/n{i}", ">in", "out>") for i in (3, 1, 5, 0, 2, 4)]
    before = figure_of(Snapshot(tuple(loose)), Options())
    layout = laid_out(before)
    for connected in range(1, 7):
        chained = [nodelet(f"/n{i}", *ports[i]) for i in range(connected)]
        snapshot = Snapshot((*chained, *(n for n in loose if int(n.name[2:]) >= connected)))
        after = figure_of(snapshot, Options())
        layout = stabilise(layout, before, laid_out(after), after, sizes_of(after))
        before = after
        assert backwards(layout.centres, after, sizes_of(after)) == 0
        _check_apart(layout, sizes_of(after))


def _check_apart(layout, sizes):
    areas = {key: around(place, sizes[key]) for key, place in layout.centres.items()}
    assert not [(a, b) for a in areas for b in areas if a < b and areas[a].meets(areas[b])]


def test_a_drawing_of_other_things_is_taken_as_it_is():
    figure = figure_of(chain(3), Options())
    new = laid_out(figure)
    assert (
        stabilise(Layout({"n_/other": Point(0, 0)}), figure, new, figure, sizes_of(figure)) is new
    )
