"""Training of pathfold models: scenes, rendering, networks, export."""
