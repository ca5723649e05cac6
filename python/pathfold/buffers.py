"""The buffers of a pixel, by name: those that the SDK knows."""

from pathfold import _core

# With their channel counts, in the order they are reported.
BUFFERS = {name: channels for name, channels, per_sample in _core.buffers() if not per_sample}
