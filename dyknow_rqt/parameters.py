# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A dialog with the parameters of a nodelet."""

from __future__ import annotations

import contextlib
from typing import Dict, Optional

from python_qt_binding.QtCore import Qt
from python_qt_binding.QtWidgets import QDialog, QDialogButtonBox, QLineEdit, QWidget

from dyknow.model.graph import NodeletStatus
from dyknow.model.placeholders import fill
from dyknow.model.transformation import Parameter, Transformation
from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.graph.changes import set_parameters
from dyknow_rqt.monitor import GraphMonitor
from dyknow_rqt.widgets import column_in, field_of, form_in


class ParametersDialog(QDialog):
    """Edits the parameters of a spawn, and those of the transformation."""

    def __init__(
        self,
        monitor: GraphMonitor,
        nodelet: NodeletStatus,
        transformation: Optional[Transformation],
        parent: QWidget,
    ) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WA_DeleteOnClose)
        self.setWindowTitle(f"Parameters of {nodelet.name}")
        self.report = monitor.report
        self._monitor, self._name = monitor, nodelet.name
        given = {each.name: each for each in nodelet.parameters}
        bound = {name: each.text for name, each in given.items()}
        self._before: Dict[str, Parameter] = {}
        for each in transformation.parameters if transformation is not None else ():
            with contextlib.suppress(KeyError, ValueError):  # it has been replaced since
                each = each._replace(text=fill(each.text, bound))
            self._before[each.name] = each
        self._before.update(given)
        self.fields: Dict[str, QLineEdit] = {}
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

    @qt_slot
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
            self.report(
                f"'{self.more.text()}' sets no parameter; expected NAME=VALUE, such as rate=5"
            )
            return
        if wanted:
            self._monitor.do(set_parameters(self._name, wanted, self._before))
        self.accept()
