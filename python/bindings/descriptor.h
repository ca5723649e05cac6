// The facts of buffers and path descriptors, as pathfold.h states them.
#pragma once

#include <pybind11/pybind11.h>

void bind_descriptor(pybind11::module_ &module);
