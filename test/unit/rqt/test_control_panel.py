# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tabs Active, Library, Create and Connect."""

from __future__ import annotations

import time

import pytest
from python_qt_binding.QtCore import QPoint, Qt
from unit.rqt.hands import (
    CEILING,
    TRACKER,
    cells_of,
    click,
    no_boxes,
    show,
    topic,
    until,
    vertex_keys,
)

from dyknow.model.graph import OUTDATED, PortRef
from dyknow.model.streams import StreamRequest
from dyknow_rqt.graph.changes import protect
from dyknow_rqt.graph.ways import read_way
from dyknow_rqt.panels.tables import KeyedTable, WayTree


def test_active_lists_and_destroys(qtbot, window, remote):
    table = window.active.table
    assert table.names() == sorted(each.name for each in remote.graph().nodelets)
    row = table.names().index("/nao1/subsampler")
    assert cells_of(table, row)[1:5] == ["subsampler", "1", "3", "running"]
    table.choose(["/nao1/bottom_camera"])
    assert not window.active.destroy.isEnabled()
    click(qtbot, window.active.protect)
    until(qtbot, window.active.destroy.isEnabled)
    click(qtbot, window.active.destroy)
    click(qtbot, window.line.yes)
    until(qtbot, lambda: "/nao1/bottom_camera" not in table.names())
    remote.client.alter("/nao1/resize", detail=f"{OUTDATED}its code changed")
    row = table.names().index("/nao1/resize")
    until(qtbot, lambda: cells_of(table, row)[4].startswith("outdated"))


def test_a_table_tells_of_picks_after_rows_that_it_could_not_show(qtbot, monkeypatch):
    table, picked = KeyedTable(("Name", "Count"), "Things"), []
    qtbot.addWidget(table)
    table.picked.connect(picked.append)
    table.show_rows([(("²", "10"), ""), (("10", ""), ""), (("9", ""), "")])
    assert table.names() == ["9", "10", "²"]
    with monkeypatch.context() as patch, pytest.raises(ZeroDivisionError):
        patch.setattr(table._rows, "replace", lambda rows: 1 / 0)
        table.show_rows([])
    table.choose(["10"])
    assert picked == [["10"]]


def test_a_table_with_a_selected_row_that_is_filtered_out_stays_where_it_is(qtbot):
    table = KeyedTable(("Name",), "Things")
    qtbot.addWidget(table)
    table.resize(200, 100)
    table.show()
    table.show_rows([((f"row {number:03}",), "") for number in range(100)] + [(("last",), "")])
    table.filter.setText("row")
    table.follow(["row 000", "last"])
    table.scrollToBottom()
    place = table.verticalScrollBar().value()
    table.follow(["row 000", "last"])
    assert table.chosen() == ["row 000"] and table.verticalScrollBar().value() == place > 0


def _sort(qtbot, table, column):
    header = table.horizontalHeader()
    place = header.sectionViewportPosition(column) + header.sectionSize(column) // 2
    header = header.viewport()
    qtbot.mouseClick(header, Qt.LeftButton, pos=QPoint(place, header.height() // 2))


def test_buttons_act_on_the_selected_rows_of_a_sorted_or_filtered_table(
    qtbot, window, remote, tmp_path, monkeypatch
):
    path = tmp_path / "out.xml"
    chosen = str(path), ""
    monkeypatch.setattr("dyknow_rqt.panels.lists.QFileDialog.getSaveFileName", lambda *_: chosen)
    panel = show(window, window.library)
    panel.table.choose(["recorder", "tracker"], "tracker")
    _sort(qtbot, panel.table, 1)
    assert sorted(panel.table.chosen()) == ["recorder", "tracker"]
    row = panel.table.currentIndex().row()
    assert panel.table.names()[row] == "tracker"
    click(qtbot, panel.export)
    assert all(f"<label>{label}</label>" in path.read_text() for label in ("recorder", "tracker"))
    qtbot.keyClicks(panel.table.filter, "track")
    assert panel.table.chosen() == ["tracker"]
    assert "recorder" not in panel.specification.toPlainText()
    panel.table.filter.setText("camera")
    assert not (panel.export.isEnabled() or panel.delete.isEnabled() or panel.create.isEnabled())
    assert panel.specification.toPlainText() == ""

    panel, name = show(window, window.active), "/nao1/subsampler"
    panel.table.choose([name])
    _sort(qtbot, panel.table, 1)
    assert panel.table.chosen() == window.selection.nodelets == [name]
    panel.table.filter.setText("camera")
    assert panel.table.chosen() == [] and window.selection.nodelets == [name]
    panel.table.filter.clear()
    assert panel.table.chosen() == [name]


def test_streams_that_are_filtered_out_are_not_released(qtbot, window, remote):
    tags = ("Track(ball)", "FieldPosition(ball)")
    claims = {tag: remote.client.acquire_stream(StreamRequest(tag)).claim_id for tag in tags}
    panel = show(window, window.streams)
    until(qtbot, lambda: len(panel.table.names()) == 2)
    panel.table.choose([claims["Track(ball)"]])
    _sort(qtbot, panel.table, 1)
    assert panel.table.chosen() == [claims["Track(ball)"]] and panel.release.isEnabled()
    panel.table.filter.setText("FieldPosition")
    assert not (panel.release.isEnabled() or panel.replan.isEnabled())
    qtbot.keyClick(panel.table, Qt.Key_Delete)
    assert not window.monitor.is_changing
    panel.table.filter.clear()
    assert panel.table.chosen() == [claims["Track(ball)"]] and panel.release.isEnabled()


def test_a_tree_of_other_ways_picks_nothing(qtbot):
    tree, picked = WayTree("Plan"), []
    qtbot.addWidget(tree)
    tree.picked.connect(picked.append)
    tree.show_ways(read_way("Track(ball)\none"))
    tree.topLevelItem(0).child(0).setSelected(True)
    assert picked == [[]]
    tree.show_ways(read_way("Track(ball)\nanother"))
    assert picked == [[]] and not tree.selectedItems()


def test_a_column_grows_with_its_names_unless_a_hand_has_set_its_width(qtbot):
    table = KeyedTable(("Name", "Type"), "Things")
    qtbot.addWidget(table)
    table.show_rows([(("/one", "relay"), "")])
    narrow = table.columnWidth(0)
    table.show_rows([(("/subsampler", "relay"), "")])
    assert table.columnWidth(0) > max(narrow, table.sizeHintForColumn(0))
    table.show_rows([(("/one", "relay"), "")])
    assert table.columnWidth(0) > narrow, "nothing jumps back"
    table.setColumnWidth(0, 40)
    table.show_rows([(("/subsampler_2", "subsamp"), "")])
    assert table.columnWidth(0) == 40 and table.columnWidth(1) > table.sizeHintForColumn(1)


def test_library_shows_imports_exports_and_deletes(qtbot, window, remote, tmp_path):
    panel = show(window, window.library)
    panel.table.choose(["tracker"])
    assert "<label>tracker</label>" in panel.specification.toPlainText()
    path = tmp_path / "out.xml"
    panel.export_file(str(path))
    click(qtbot, panel.delete)
    assert window.line.text == "Delete tracker from the library?"
    click(qtbot, window.line.yes)
    until(qtbot, lambda: "tracker" not in panel.table.names())
    panel.import_file(str(path))
    until(qtbot, lambda: "tracker" in panel.table.names())
    qtbot.keyClicks(panel.table.filter, "CAM")
    assert panel.table.names() == ["camera(nao1, bottom)", "camera(nao1, top)", "ceiling_camera"]


def test_a_library_of_a_hundred_thousand_does_not_hold_up_the_window(qtbot, window, monkeypatch):
    from dyknow.model.transformation import Transformation

    monkeypatch.setattr(window.monitor, "_take_library", lambda *unused: None)
    library = {f"t{i}": Transformation(f"t{i}", "p/C") for i in range(100_000)}
    window.tabs.setCurrentWidget(window.library)
    start = time.thread_time()
    window.monitor.library = library
    window.monitor.library_changed.emit(library)
    qtbot.wait(1)
    qtbot.keyClicks(window.library.table.filter, "t99999")
    assert window.library.table.names() == ["t99999"]
    assert time.thread_time() - start < 30.0


def test_an_import_that_is_not_utf8_says_so(window, tmp_path, monkeypatch):
    path = tmp_path / "latin.xml"
    path.write_bytes("<transformation><label>caméra</label></transformation>".encode("latin-1"))
    chosen = str(path), ""
    monkeypatch.setattr("dyknow_rqt.panels.lists.QFileDialog.getOpenFileName", lambda *_: chosen)
    window.library.import_.click()
    assert window.line.text == f"{path}: is not UTF-8; expected XML in UTF-8"


def test_a_refused_import_shows_the_words_of_the_manager(qtbot, window, tmp_path):
    path = tmp_path / "bad.xml"
    path.write_text("<transformation>\n<label>x</label>\n<sauce>p/C</sauce></transformation>")
    window.library.import_file(str(path))
    until(qtbot, lambda: window.line.text.startswith("import bad.xml: specification:"))
    assert no_boxes()
    click(qtbot, window.line.dismiss)
    assert window.line.text == ""


def test_create_makes_a_nodelet(qtbot, window, remote):
    panel = show(window, window.create_)
    assert not panel.create.isEnabled()
    panel.begin("tracker")
    assert panel.name.text() == "/tracker"
    panel.name.clear()
    qtbot.keyClicks(panel.name, "/field/second")
    qtbot.mouseClick(panel.is_protected, Qt.LeftButton, pos=QPoint(8, 8))
    qtbot.keyClick(panel.name, Qt.Key_Return)
    until(qtbot, lambda: "n_/field/second" in vertex_keys(window))
    assert remote.graph().nodelet("/field/second").is_protected
    until(qtbot, lambda: panel.name.text() == "")
    panel.begin("tracker")
    panel.name.setText("/field/second")
    click(qtbot, panel.create)
    until(qtbot, lambda: "a nodelet named '/field/second' is already" in window.line.text)
    panel.name.setText("no name")
    click(qtbot, panel.create)
    assert "'no name' is not a valid" in window.line.text
    panel.begin("tracker")
    remote.client.answers.clear()
    click(qtbot, panel.create)
    window.monitor.library_changed.emit(window.monitor.library)
    window.monitor.do(protect("/field/tracker", True))
    assert not panel.create.isEnabled() and panel.create.text() == "Creating …"
    panel.name.setText("/next")
    assert panel.create.isEnabled() and panel.create.text() == "Create"
    remote.client.answers.set()
    until(qtbot, lambda: remote.graph().nodelet("/tracker") and not window.monitor.is_changing)
    assert panel.name.text() == "/next", "a name that is typed meanwhile stays"


def test_create_gives_names_for_variables_and_parameters(qtbot, window, remote):
    remote.client.add_transformation(
        "<transformation><label>eye</label><source>soccer/Eye</source><params>"
        '<param name="frame" type="string">${?camera}_link</param>'
        '<param name="rate" type="double">30</param></params>'
        '<ports><port type="in">in</port><port type="in">other</port></ports><tags>'
        '<tag port="in">Image(?camera)</tag><tag port="other">Lens(?lens)</tag></tags>'
        "</transformation>"
    )
    panel = show(window, window.create_)
    until(qtbot, lambda: "eye" in window.monitor.library)
    panel.begin("eye")
    fields = panel.given.fields
    placeholders = {name: field.placeholderText() for name, field in fields.items()}
    assert placeholders == {
        "?camera": "a name",
        "?lens": "as connected",
        "frame": "${?camera}_link",
        "rate": "30",
    }
    click(qtbot, panel.create)
    until(qtbot, lambda: "nothing says what ?camera in the parameter 'frame'" in window.line.text)
    qtbot.keyClicks(fields["?camera"], "left")
    qtbot.keyClicks(fields["rate"], "5")
    qtbot.keyClicks(panel.given.more, "speed")
    click(qtbot, panel.create)
    until(qtbot, lambda: "'speed': expected NAME=VALUE" in window.line.text)
    qtbot.keyClicks(panel.given.more, "=3 place='the field'")
    click(qtbot, panel.create)
    until(qtbot, lambda: "n_/eye" in vertex_keys(window))
    given = {each.name: each.text for each in remote.graph().nodelet("/eye").parameters}
    assert given == {"?camera": "left", "rate": "5", "speed": "3", "place": "the field"}
    panel.begin("tracker")
    assert panel.given.fields == {}
    item = next(i for i in window.graph.view.scene().items() if "n_/eye" in str(_key(i)))
    tip = window.graph.view.scene().facts.tip_of(item)
    assert "?camera=left place=the field rate=5 speed=3" in tip


def _key(item):
    return getattr(getattr(item, "vertex", None), "key", "")


def test_connect_offers_only_what_fits(qtbot, window, remote):
    panel = show(window, window.connect_)
    panel.source.nodelet.setCurrentText("/field/ceiling_camera")
    sinks = {panel.sink.nodelet.itemText(i) for i in range(panel.sink.nodelet.count())}
    assert sinks == {"/field/tracker", "/nao1/localization"}
    panel.sink.nodelet.setCurrentText("/field/tracker")
    replaced = "replaces /field/ball at /field/tracker:position"
    assert panel.topic_chosen.text() == f"/field/ceiling_camera/field_position\n{replaced}"
    click(qtbot, panel.connect)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")
    until(qtbot, lambda: "connected already" in panel.topic_chosen.text())
    assert not panel.connect.isEnabled()


def test_connect_takes_a_topic_by_name(qtbot, window, remote):
    panel = show(window, window.connect_)
    panel.begin("/field/tracker", "position")
    assert panel.now.text() == "/field/ball"
    panel.topic.setText("~other")
    assert panel.replaced.text() == "replaces /field/ball at /field/tracker:position"
    panel.topic.clear()
    click(qtbot, panel.disconnect_port)
    until(qtbot, lambda: panel.now.text() == "not connected")
    assert panel.replaced.text() == ""
    qtbot.keyClicks(panel.topic, "/somewhere")
    click(qtbot, panel.connect_topic)
    until(qtbot, lambda: panel.now.text() == "/somewhere")
    assert topic(remote, TRACKER) == "/somewhere"


@pytest.mark.parametrize("lost", [TRACKER, CEILING])
def test_connect_waits_for_a_chosen_nodelet_that_goes(qtbot, window, remote, lost):
    panel = show(window, window.connect_)
    panel.begin(CEILING.nodelet, CEILING.port)
    panel.sink.choose(TRACKER)
    panel.single.choose(TRACKER)
    request = remote.graph().nodelet(lost.nodelet).request
    remote.client.destroy(lost.nodelet)
    until(qtbot, lambda: window.monitor.snapshot.nodelet(lost.nodelet) is None)
    assert (panel.single.ref is None) is (lost == TRACKER)
    assert panel.disconnect_port.isEnabled() is (lost == CEILING)
    assert panel.sink.ref is None and not panel.connect.isEnabled()
    resize = window.monitor.snapshot.nodelet("/nao1/resize")
    panel.single.offer(*[{TRACKER.nodelet: (), resize.name: resize.ports}] * 2)  # it is loaded
    assert panel.single.ref is None
    remote.client.spawn_nodelet(request)
    choices = (panel.source, panel.sink, panel.single)
    until(qtbot, lambda: [choice.ref for choice in choices] == [CEILING, TRACKER, TRACKER])
    panel.source.choose(PortRef("/nao1/resize", "resized"))
    panel.single.nodelet.setCurrentText("/nao1/resize")
    assert panel.sink.ref is not None and panel.single.ref == PortRef("/nao1/resize", "image")
