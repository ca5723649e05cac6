"""Picture files: the parts, layers and channels of an EXR, read as arrays and written back with the rest
untouched.
"""

from pathfold.images.errors import ImageError, OutputError, why
from pathfold.images.layers import Layer, views
from pathfold.images.read import ImageFile
from pathfold.images.replace import check_output, check_writable, replacing
from pathfold.images.window import Window, lay
from pathfold.images.write import HALF_MAX, MAX_CHANNELS, NewPart, save_as, write_parts, writing_mb

__all__ = [
    "HALF_MAX",
    "MAX_CHANNELS",
    "ImageError",
    "ImageFile",
    "Layer",
    "NewPart",
    "OutputError",
    "Window",
    "check_output",
    "check_writable",
    "lay",
    "replacing",
    "save_as",
    "views",
    "why",
    "write_parts",
    "writing_mb",
]
