# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Fields for what is given to a nodelet when it is made: names for variables, and parameters."""

from __future__ import annotations

import shlex
from typing import Dict, List, Optional, Tuple

from python_qt_binding.QtWidgets import QFormLayout, QLineEdit, QWidget

from dyknow.errors import InvalidParameters
from dyknow.manager.specifications.given import filling_variables, variables
from dyknow.model.transformation import Parameter, Transformation


class GivenFields(QWidget):
    """A field for each variable and each parameter; what stays empty is not given.

    Attributes:
        fields: by name, those of the transformation.
        more: for parameters that the transformation does not name; None without a transformation.
    """

    def __init__(self, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self.fields: Dict[str, QLineEdit] = {}
        self.more: Optional[QLineEdit] = None
        self._form = QFormLayout(self)
        self._form.setContentsMargins(0, 0, 0, 0)
        self._form.setFieldGrowthPolicy(QFormLayout.AllNonFixedFieldsGrow)
        self._shown: Optional[Transformation] = None

    def show_transformation(self, transformation: Optional[Transformation]) -> None:
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
            is_needed = variable in needed
            self.fields[variable] = self._add(
                variable,
                "a name" if is_needed else "as connected",
                "Fills parameters: expected a name"
                if is_needed
                else "Follows from the streams at the in-ports, unless a name is given",
            )
        for parameter in transformation.parameters:
            tip = f"{parameter.type}; empty: as it is shown"
            self.fields[parameter.name] = self._add(parameter.name, parameter.text, tip)
        tip = "Parameters that the transformation does not name; quoted as in a shell"
        self.more = self._add("More", "rate=5 frame=map", tip)

    def given(self) -> Tuple[Parameter, ...]:
        """Return what was given, with the types left to the manager.

        Raises:
            InvalidParameters: what was written for further parameters is something else.
        """
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
        field = QLineEdit()
        field.setPlaceholderText(placeholder)
        field.setToolTip(tip)
        field.setAccessibleName(name)
        self._form.addRow(f"{name.replace('&', '&&')}:", field)
        return field


def _words(text: str, label: str) -> List[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InvalidParameters(label, [f"'{text}': {error}"]) from error
