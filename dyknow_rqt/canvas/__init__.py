"""The drawing of the graph: items, the scene that holds them, the view that is looked through."""
