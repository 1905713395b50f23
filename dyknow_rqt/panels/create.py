# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tab Create, and the dialog with the parameters of a nodelet that runs."""

from __future__ import annotations

import contextlib
import shlex
from typing import Mapping

from python_qt_binding.QtCore import QSignalBlocker, QStringListModel, Qt
from python_qt_binding.QtWidgets import (
    QCheckBox,
    QComboBox,
    QCompleter,
    QDialog,
    QDialogButtonBox,
    QLabel,
    QLineEdit,
    QPushButton,
    QWidget,
)

from dyknow import names
from dyknow.errors import InvalidParameters
from dyknow.manager.specifications.given import filling_variables, variables
from dyknow.model.graph import NodeletStatus, SpawnRequest
from dyknow.model.placeholders import fill
from dyknow.model.transformation import Parameter, Transformation
from dyknow_rqt.graph.changes import set_parameters, spawn
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph.wiring import free_name
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.panels.tables import Panel
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import column_in, field_of, form_in


class GivenFields(QWidget):
    """A field for each variable and each parameter, by name; empty fields are not given.

    ``more`` is for parameters that the transformation does not name; None without one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.fields: dict[str, QLineEdit] = {}
        self.more: QLineEdit | None = None
        self._form = form_in(self)
        self._form.setContentsMargins(0, 0, 0, 0)
        self._shown: Transformation | None = None

    def show_transformation(self, transformation: Transformation | None) -> None:
        """Offer the fields of a transformation; they are kept while it stays the same."""
        if transformation == self._shown:
            return
        self._shown = transformation
        self.fields.clear()
        self.more = None
        while self._form.rowCount():
            self._form.removeRow(0)
        if transformation is None:
            return
        needed = filling_variables(transformation)
        for variable in sorted(variables(transformation)):
            placeholder, tip = "a name", "Fills parameters: expected a name"
            if variable not in needed:
                placeholder = "as connected"
                tip = "Follows from the streams at the in-ports, unless a name is given"
            self.fields[variable] = self._add(variable, placeholder, tip)
        for parameter in transformation.parameters:
            tip = f"{parameter.type}; empty: as it is shown"
            self.fields[parameter.name] = self._add(parameter.name, parameter.text, tip)
        tip = "Parameters that the transformation does not name; quoted as in a shell"
        self.more = self._add("More", "rate=5 frame=map", tip)

    def given(self) -> tuple[Parameter, ...]:
        """The given parameters, with the types left to the manager, or InvalidParameters."""
        texts = [(name, field.text().strip()) for name, field in self.fields.items()]
        found = [Parameter(name, "", text) for name, text in texts if text]
        if self.more is not None and self._shown is not None:
            for word in _words(self.more.text(), self._shown.label):
                name, equals, text = word.partition("=")
                if not name or not equals:
                    problem = f"'{word}': expected NAME=VALUE, such as rate=5"
                    raise InvalidParameters(self._shown.label, [problem])
                found.append(Parameter(name, "", text))
        return tuple(found)

    def _add(self, name: str, placeholder: str, tip: str) -> QLineEdit:
        field = field_of(placeholder, tip, name)
        self._form.addRow(f"{name.replace('&', '&&')}:", field)
        return field


def _words(text: str, label: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InvalidParameters(label, [f"'{text}': {error}"]) from error


_ANY = "(the manager's choice)"


class CreatePanel(Panel):
    """Edits transformation, name, protection, process, variables and parameters."""

    def __init__(self, monitor: GraphMonitor, line: StatusLine) -> None:
        super().__init__(monitor, line)
        self.name = field_of("/robot/ball_detector")
        self.label = QComboBox(editable=True, minimumContentsLength=12)
        self._labels = QStringListModel(self)
        self.label.setModel(self._labels)
        self.label.setInsertPolicy(QComboBox.NoInsert)
        self.label.setSizeAdjustPolicy(QComboBox.AdjustToMinimumContentsLengthWithIcon)
        self.label.completer().setCompletionMode(QCompleter.PopupCompletion)
        self.label.completer().setFilterMode(Qt.MatchContains)
        self.label.setCurrentText("")
        self.is_protected = QCheckBox("&Protected from being destroyed")
        self.isolated = QCheckBox("In a process of its o&wn", toggled=self._follow)
        self.manager = QComboBox(editable=True)
        self.manager.addItem(_ANY)
        self.ports = QLabel(textFormat=Qt.PlainText, wordWrap=True)
        self.given = GivenFields()
        self.create = QPushButton("Create", clicked=self._create)
        #: The name of a nodelet that is being made.
        self._made = ""
        form = form_in()
        form.addRow("&Transformation:", self.label)
        form.addRow("Na&me:", self.name)
        form.addRow("", self.is_protected)
        form.addRow("", self.isolated)
        form.addRow("Nodelet manager:", self.manager)
        form.addRow("Ports:", self.ports)
        form.addRow("Parameters:", self.given)
        form.addRow("", self.create)
        column_in(self.page, form).addStretch(1)
        monitor.library_changed.connect(self._show_library)
        monitor.changed.connect(self._show_managers)
        monitor.settled.connect(self._follow)
        self.name.returnPressed.connect(self._create)
        self.name.textChanged.connect(self._follow)
        self.label.currentTextChanged.connect(self._follow)
        self._follow()

    def begin(self, label: str = "") -> None:
        if label:
            self.label.setCurrentText(label)
            self.name.setText(free_name(self._monitor.snapshot, label))
            self.name.setFocus()
            self.name.selectAll()
        else:
            self.label.setFocus()

    def _create(self) -> None:
        if not self.create.isEnabled():
            return
        text, manager = self.name.text(), self.manager.currentText().strip()
        request = SpawnRequest(
            self.label.currentText().strip(),
            names.check(text.strip()),
            is_protected=self.is_protected.isChecked(),
            isolated=self.isolated.isChecked(),
            manager="" if manager == _ANY or self.isolated.isChecked() else manager,
            parameters=self.given.given(),
        )
        self._made = text
        self._monitor.do(spawn(request), lambda: self._clear(text))
        self._follow()

    def _clear(self, name: str) -> None:
        """Clear the name of a nodelet that was made, unless the user has typed another one."""
        if self.name.text() == name:
            self.name.clear()

    def _follow(self) -> None:
        library = self._monitor.library
        transformation = library.get(self.label.currentText().strip())
        name, self._made = self.name.text(), self._made if self._monitor.is_changing else ""
        is_made = bool(self._made) and name == self._made
        self.create.setText("Creating …" if is_made else "Create")
        self.create.setEnabled(transformation is not None and bool(name.strip()) and not is_made)
        self.manager.setEnabled(not self.isolated.isChecked())
        self.given.show_transformation(transformation)
        lines = []
        for port in transformation.ports if transformation is not None else ():
            lines.append(f"{port.direction}  {port.name}  {port.datatype}".rstrip())
            lines += [f"        {tag}" for tag in port.tags]
        self.ports.setText("\n".join(lines) or "–")

    def _show_library(self, library: Mapping[str, Transformation]) -> None:
        text = self.label.currentText()
        with QSignalBlocker(self.label):
            labels = sorted(label for label, each in library.items() if not each.is_described)
            self._labels.setStringList(labels)
            self.label.setCurrentText(text)
        self._follow()

    def _show_managers(self, snapshot: Snapshot) -> None:
        found = sorted(
            {each.manager for each in snapshot.nodelets if each.manager and not each.isolated}
        )
        if found != [self.manager.itemText(i) for i in range(1, self.manager.count())]:
            text = self.manager.currentText()
            self.manager.clear()
            self.manager.addItems([_ANY, *found])
            self.manager.setCurrentText(text)


class ParametersDialog(QDialog):
    """Edits the parameters of a spawn, and those of the transformation."""

    def __init__(self, monitor: GraphMonitor, nodelet: NodeletStatus, parent: QWidget) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WA_DeleteOnClose)
        self.setWindowTitle(f"Parameters of {nodelet.name}")
        self._monitor, self._name = monitor, nodelet.name
        given = {each.name: each for each in nodelet.parameters}
        bound = {name: each.text for name, each in given.items()}
        self._before: dict[str, Parameter] = {}
        transformation = monitor.library.get(nodelet.transformation)
        for each in transformation.parameters if transformation is not None else ():
            with contextlib.suppress(KeyError, ValueError):  # it has been replaced since
                each = each._replace(text=fill(each.text, bound))
            self._before[each.name] = each
        self._before.update(given)
        self.fields: dict[str, QLineEdit] = {}
        self.more = field_of("rate=5", "A parameter that is not named here: NAME=VALUE")
        form = form_in()
        for name, parameter in self._before.items():
            self.fields[name] = field = QLineEdit(parameter.text, accessibleName=name)
            field.setReadOnly(name.startswith("?"))  # a variable is bound for life
            form.addRow(f"{name.replace('&', '&&')}:", field)
        form.addRow("Another:", self.more)
        self.buttons = QDialogButtonBox(QDialogButtonBox.Ok | QDialogButtonBox.Cancel)
        self.buttons.accepted.connect(self._set)
        self.buttons.rejected.connect(self.reject)
        column_in(self, form, self.buttons)

    def _set(self) -> None:
        """Set the parameters whose values were edited."""
        texts = {name: field.text() for name, field in self.fields.items()}
        wanted = [
            Parameter(name, self._before[name].type, text)
            for name, text in texts.items()
            if text != self._before[name].text
        ]
        name, equals, text = self.more.text().partition("=")
        if name.strip() and equals:
            wanted.append(Parameter(name.strip(), "", text.strip()))
        elif self.more.text().strip():
            self._monitor.failed.emit(
                f"'{self.more.text()}' sets no parameter; expected NAME=VALUE, such as rate=5"
            )
            return
        if wanted:
            self._monitor.do(set_parameters(self._name, wanted, self._before))
        self.accept()
