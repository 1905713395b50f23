# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ontologies in OWL: their files, the classes and instances in them, and what is ignored."""
