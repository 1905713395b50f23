# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The drawing of the computation graph, without Qt and ROS."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import pydot
import pytest
from hypothesis import given
from hypothesis import strategies as some

from dyknow.model.graph import NodeletStatus, PortState, State
from dyknow_rqt.graph.figure import Boxes, Options, VertexKind, figure_of
from dyknow_rqt.graph.filters import BadFilter, completions, parse
from dyknow_rqt.graph.geometry import Size, around
from dyknow_rqt.graph.layout import (
    BadLayout,
    DrawingOrder,
    arranged,
    read_graphs,
    read_layout,
    to_dot,
)
from dyknow_rqt.graph.parts import MOST, divide, pack
from dyknow_rqt.graph.snapshot import PlainNode, Snapshot, plain_nodes
from dyknow_rqt.graph.stabilise import backwards, moved


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
    """Nodelets `/nNN`, each publishing the topic that the next one receives."""
    return Snapshot(
        tuple(
            nodelet(f"/n{i:02}", *([f">in=/t{i - 1:02}"] if i else []), f"out>=/t{i:02}")
            for i in range(count)
        )
        + tuple(extra)
    )


def sizes_of(figure):
    return {v.key: Size(40 + 7 * len(v.name), 40) for v in figure.vertices}


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
    return arranged(DrawingOrder(figure, sizes, shape=shape), parts, layouts, before)


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


@pytest.mark.parametrize(
    "part", ["/a{99999999999}", "(" * 5000 + ")" * 5000], ids=["repeated", "nested"]
)
def test_a_filter_that_is_too_large_an_expression_is_refused(part):
    with pytest.raises(BadFilter, match="is not a regular expression"):
        parse(part)


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
        (Options(hide_debug=False), ["/rosout", "/t00", "/t01", "/waits"]),
    ],
)
def test_what_is_hidden(options, topics):
    snapshot = chain(2, [nodelet("/waiting", ">in=/waits", "log>=/rosout")])
    figure = figure_of(snapshot, options)
    assert [v.name for v in figure.vertices if v.kind is VertexKind.TOPIC] == topics


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


def test_a_collapsed_box_counts_its_nodelets_alone():
    nodes = (PlainNode("/robot/view", (), ("/robot/image",)),)
    snapshot = Snapshot((nodelet("/robot/cam", "out>=/robot/image"),), nodes)
    options = Options(show_nodes=True, collapsed=frozenset({("/robot",)}))
    assert [v.note for v in figure_of(snapshot, options).vertices] == ["1 nodelet"]


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
        found = {}
        for v in figure.vertices:
            found.setdefault(" in ".join(v.group[::-1]), []).append(v.name)
        return {group: " ".join(members) for group, members in found.items() if group}

    lost = {"/lost": "/e"}
    assert groups(boxes=Boxes.HOSTS) == {
        "/m/one in desk": "/a /b /inner",
        "/two in desk": "/c",
        "desk": "/between",
        "far": "/d",
        **lost,
    }
    assert groups(boxes=Boxes.HOSTS, depth=1)["desk"] == "/a /b /c /between /inner"
    assert groups(boxes=Boxes.HOSTS, depth=0) == {}
    assert groups(boxes=Boxes.MANAGERS) == {"/m/one": "/a /b /inner", "/two": "/c", **lost}
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
    drawing = drawn(figure_of(snapshot, Options()))
    ports = {v.name: v.inputs + v.outputs for v in drawing.figure.vertices}
    a_is_above = drawing.layout.centres["t_/a"].y < drawing.layout.centres["t_/b"].y
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
    """Beside 20 nodelets and their topics: at most 4 of the 40 may move."""
    before, after = (figure_of(chain(20, extra), Options()) for extra in ((), (added,)))
    old = drawn(before)
    new = drawn(after, old)
    assert len(moved(old.layout, new.layout)) <= 4
    assert set(new.layout.curves) == set(after.edges)
    _check_apart(new)


@pytest.mark.parametrize("are_laid_out", [True, False])
def test_nothing_lies_on_top_of_something_else(are_laid_out):
    snapshot = chain(
        6, [nodelet("/n03/x", ">in=/t01", "out>=/t04"), nodelet("/back", ">in=/t05", "out>=/t00")]
    )
    figure = figure_of(snapshot, Options())
    _check_apart(drawn(figure, are_laid_out=are_laid_out))


def test_connections_made_one_by_one_end_in_a_drawing_from_left_to_right():
    """Each connection may change places, so that no arrow leads backwards in the end."""
    ports = [(f">in=/t{i - 1}" if i else ">in", f"out>=/t{i}") for i in range(6)]
    loose = [nodelet(f"/n{i}", ">in", "out>") for i in (3, 1, 5, 0, 2, 4)]
    drawing = drawn(figure_of(Snapshot(tuple(loose)), Options()))
    for connected in range(1, 7):
        chained = [nodelet(f"/n{i}", *ports[i]) for i in range(connected)]
        snapshot = Snapshot((*chained, *(n for n in loose if int(n.name[2:]) >= connected)))
        drawing = drawn(figure_of(snapshot, Options()), drawing)
        assert backwards(drawing.layout.centres, drawing.figure, drawing.sizes) == 0
        _check_apart(drawing)


def test_a_chain_that_is_turned_round_leads_from_left_to_right_again():
    """All vertices are those of before, and could keep their places."""
    before = drawn(figure_of(chain(6), Options()))
    ports = [(*([f">in=/t{i + 1:02}"] if i < 5 else []), f"out>=/t{i:02}") for i in range(6)]
    snapshot = Snapshot(tuple(nodelet(f"/n{i:02}", *each) for i, each in enumerate(ports)))
    after = drawn(figure_of(snapshot, Options()), before)
    assert backwards(after.layout.centres, after.figure, after.sizes) == 0


def _check_apart(drawing):
    places = drawing.layout.centres.items()
    areas = {key: around(place, drawing.sizes[key]) for key, place in places}
    assert not [(a, b) for a in areas for b in areas if a < b and areas[a].meets(areas[b])]


def chains(count, length=5, space="/chain{}/", joined=False):
    """Chains of nodelets, each in a namespace; joined: each feeds the next."""
    found = []
    for number in range(count):
        here = space.format(number)
        first = f"{space.format(number - 1)}t{length}" if joined and number else f"{here}t0"
        for place in range(length):
            source = f"{here}t{place}" if place else first
            found.append(nodelet(f"{here}n{place}", f">in={source}", f"out>={here}t{place + 1}"))
    return found


def figure_of_all(nodelets, **options):
    return figure_of(Snapshot(tuple(nodelets)), Options(**options))


def bounds(drawing):
    sizes = drawing.sizes
    areas = [around(centre, sizes[key]) for key, centre in drawing.layout.centres.items()]
    areas += drawing.layout.boxes.values()
    lefts, tops, rights, bottoms = zip(*areas)
    return max(rights) - min(lefts), max(bottoms) - min(tops)


def check_boxes(drawing):
    """Boxes hold their vertices, and nothing that belongs elsewhere."""
    boxes = drawing.layout.boxes
    for vertex in drawing.figure.vertices:
        area = around(drawing.layout.centres[vertex.key], drawing.sizes[vertex.key])
        for group, box in boxes.items():
            assert box.meets(area) is (vertex.group[: len(group)] == group), (vertex.key, group)
    for one, area in boxes.items():
        for other, another in boxes.items():
            nested = one[: len(other)] == other or other[: len(one)] == one
            assert nested or not area.meets(another), (one, other)


@pytest.mark.parametrize("is_downwards", [False, True])
@pytest.mark.parametrize("are_laid_out", [True, False])
@pytest.mark.parametrize("joined", [True, False])
def test_boxes_are_around_their_own_and_the_page_has_the_shape_of_the_view(
    is_downwards, are_laid_out, joined
):
    nodelets = chains(40, joined=joined) + chains(6, space="/deep/{}/")
    nodelets += [*chains(3, space="/{}_"), nodelet("/other/idle", "out>")]
    figure = figure_of_all(nodelets, is_downwards=is_downwards)
    shape = 0.6 if is_downwards else 1.6
    drawing = drawn(figure, shape=shape, are_laid_out=are_laid_out)
    check_boxes(drawing)
    width, height = bounds(drawing)
    assert shape / 1.5 < width / height < 1.5 * shape
    assert set(drawing.layout.curves) == set(figure.edges)


def test_parts_stand_in_reading_order():
    drawing = drawn(figure_of_all(chains(12)))
    boxes = drawing.layout.boxes
    ordered = sorted(boxes, key=lambda group: (round(boxes[group].top / 20), boxes[group].left))
    assert [group[0] for group in ordered] == [f"/chain{number}" for number in range(12)]


def test_a_part_that_is_large_is_divided_into_its_boxes():
    figure = figure_of_all(chains(40, joined=True))
    assert len(figure.vertices) > MOST
    parts = divide(figure)
    assert [len(part.figure.vertices) for part in parts] == [11] + [10] * 39
    (one,) = divide(figure_of_all(chains(4, joined=True)))
    assert not one.parts
    (whole,) = divide(figure_of_all(chains(40, space="/all/{}/", joined=True)))
    assert len(whole.parts) == 40 and len(list(whole.leaves())) == 40
    (giant,) = divide(figure_of_all(chains(40, space="/{}_", joined=True)))
    assert list(giant.leaves()) == [giant]
    assert sum(len(each.figure.vertices) for each in divide(giant.figure, 1)) == 401


@pytest.mark.parametrize("joined", [True, False])
def test_a_connection_between_two_groups_leaves_everything_where_it_is(joined):
    nodelets = chains(40, joined=joined)
    before = drawn(figure_of_all(nodelets))
    for number in (7, 9):  # backwards, and to a group that is far
        place = [each.name for each in nodelets].index(f"/chain{number}/n0")
        port = replace(nodelets[place].ports[0], topic="/chain20/t5")
        nodelets[place] = replace(nodelets[place], ports=(port, *nodelets[place].ports[1:]))
        after = drawn(figure_of_all(nodelets), before)
        changed = [
            key for key in moved(before.layout, after.layout) if f"/chain{number}/" not in key
        ]
        assert not changed
        assert ("t_/chain20/t5", f"n_/chain{number}/n0") in {
            (e[0], e[2]) for e in after.figure.edges
        }
        check_boxes(after)
        before = after


def test_what_comes_goes_or_grows_moves_nothing_else():
    nodelets = chains(20)
    before = drawn(figure_of_all(nodelets))
    for change in (
        [*nodelets, nodelet("/chain3/more", ">in=/chain3/t2", "out>=/chain3/x")],
        nodelets + chains(1, 9, space="/another{}/"),
        [each for each in nodelets if "/chain4/" not in each.name],
        [*nodelets, nodelet("/alone", "out>")],
    ):
        after = drawn(figure_of_all(change), before)
        assert not [key for key in moved(before.layout, after.layout) if "/chain3/" not in key]
        check_boxes(after)


def test_what_comes_is_drawn_with_all_arrows_before_it_is_laid_out():
    nodelets = chains(12, joined=True)
    before = drawn(figure_of_all(nodelets))
    more = [*nodelets, nodelet("/chain3/more", ">in=/chain3/t2", "out>=/chain3/x")]
    figure = figure_of_all(more)
    after = drawn(figure, before, are_laid_out=False)
    assert set(after.layout.curves) == set(figure.edges)
    check_boxes(after)


_SIZES = some.builds(Size, some.floats(10, 500), some.floats(10, 200))


@given(some.lists(_SIZES, min_size=1, max_size=40), some.floats(0.3, 3.0))
def test_packed_rectangles_do_not_meet_and_follow_each_other(sizes, shape):
    areas = [around(*each) for each in zip(pack(sizes, shape), [Size(0.0, 0.0)] * len(sizes))]
    areas = [a._replace(right=a.left + w, bottom=a.top + h) for a, (w, h) in zip(areas, sizes)]
    for before, after in zip(areas, areas[1:]):
        assert after.left > before.right or (after.top > before.top and after.left == 0.0)
    for number, area in enumerate(areas):
        assert not any(area.meets(other) for other in areas[:number])
