# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Fields for what is given to a nodelet when it is made: names for variables, and parameters."""

from __future__ import annotations

from typing import Dict, Optional, Tuple

from python_qt_binding.QtWidgets import QFormLayout, QLineEdit, QWidget

from dyknow.manager.specifications.given import filling_variables, variables
from dyknow.model.transformation import Parameter, Transformation


class GivenFields(QWidget):
    """A field for each variable and each parameter; what stays empty is not given.

    Attributes:
        fields: by name, those of the transformation.
    """

    def __init__(self, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self.fields: Dict[str, QLineEdit] = {}
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
        while self._form.rowCount():
            self._form.removeRow(0)
        if transformation is None:
            return
        needed = filling_variables(transformation)
        for variable in sorted(variables(transformation)):
            is_needed = variable in needed
            self._add(
                variable,
                "a name" if is_needed else "as connected",
                "Fills parameters: expected a name"
                if is_needed
                else "Follows from the streams at the in-ports, unless a name is given",
            )
        for parameter in transformation.parameters:
            self._add(parameter.name, parameter.text, f"{parameter.type}; empty: as it is shown")

    def given(self) -> Tuple[Parameter, ...]:
        """Return what was given, with the types left to the manager."""
        texts = {name: field.text().strip() for name, field in self.fields.items()}
        return tuple(Parameter(name, "", text) for name, text in texts.items() if text)

    def _add(self, name: str, placeholder: str, tip: str) -> None:
        field = QLineEdit()
        field.setPlaceholderText(placeholder)
        field.setToolTip(tip)
        field.setAccessibleName(name)
        self.fields[name] = field
        self._form.addRow(f"{name.replace('&', '&&')}:", field)
