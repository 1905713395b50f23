"""Transformation specifications, and the ontologies that they name."""
