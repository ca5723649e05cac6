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

/// A path descriptor has 6 channels for the path and 5 for each of up to 6 vertices.
constexpr int descriptor_vertices = 6;

/// The vertices that a descriptor of so many channels describes; 0 where it is none.
constexpr int vertices_of(int channels) {
    const int vertices = (channels - 6) / 5;
    return channels == 6 + 5 * vertices && vertices >= 1 && vertices <= descriptor_vertices ? vertices : 0;
}

/// All known buffers.
const std::vector<BufferKind> &buffer_kinds();

/// The kind of that name, or null.
const BufferKind *find_buffer(const std::string &name);

/// Their names, for messages.
std::string buffer_names();

} // namespace pathfold::core
