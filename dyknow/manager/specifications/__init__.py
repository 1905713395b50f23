"""What can run: transformations, as people write them, and the ontologies that they name."""
