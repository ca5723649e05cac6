"""Which channels of a file are which buffer (presets, mapping, convert), and its block of samples (samples)."""

from pathfold.channels.convert import complete_albedo, encoded
from pathfold.channels.find import describe
from pathfold.channels.mapping import ALL_LIGHT, Frame, load, match
from pathfold.channels.presets import Preset, detect, presets
from pathfold.channels.source import Source

__all__ = [
    "ALL_LIGHT",
    "Frame",
    "Preset",
    "Source",
    "complete_albedo",
    "describe",
    "detect",
    "encoded",
    "load",
    "match",
    "presets",
]
