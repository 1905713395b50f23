"""The drawing of the graph: items, their scene, and the view of it."""
