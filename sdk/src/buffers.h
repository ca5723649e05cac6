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

/// What the values of a buffer are brought into.
struct Range {
    float least, most;
};

/// A buffer that networks are shown pixel by pixel, as it is.
struct Guide {
    const char *name;
    Range range;
    bool flagged; ///< a graph may ask by the input NAME.present whether the frame has it
};

/// All of them, each among the known buffers too.
const std::vector<Guide> &guides();

/// The guide of that name, or null.
const Guide *find_guide(const std::string &name);

/// The range of a guide; of any other buffer that must not be negative, >= 0.
Range guide_range(const std::string &buffer);

} // namespace pathfold::core
