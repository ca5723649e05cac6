#pragma once

#include <string>
#include <vector>

#include "pathfold/pathfold.h"

namespace pathfold::core {

/// Its name is the same in C, C++, Python, EXR, manifest and graph.
using BufferKind = pathfold_buffer;

/// All known buffers.
const std::vector<BufferKind> &buffer_kinds();

/// The kind of that name, or null.
const BufferKind *find_buffer(const std::string &name);

/// Their names, for messages.
std::string buffer_names();

} // namespace pathfold::core
