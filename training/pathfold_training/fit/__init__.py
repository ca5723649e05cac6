"""Training: presets, batches of views, the task, its checkpoints."""
