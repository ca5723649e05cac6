#pragma once

#include <string>
#include <vector>

namespace pathfold::core {

/// A buffer that a frame may have: its name is the same in C, C++, Python, EXR, manifest and graph.
struct BufferKind {
    const char *name;
    int channels;
    bool per_sample;
};

/// All known buffers.
const std::vector<BufferKind> &buffer_kinds();

/// The kind of that name, or null.
const BufferKind *find_buffer(const std::string &name);

/// Their names, for messages.
std::string buffer_names();

} // namespace pathfold::core
