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

/// Where a scene ends: a depth from here on is a miss.
constexpr float farthest_depth = 1e9f;

/// A variance above says nothing: the deviation would be 1e18.
constexpr float largest_variance = 1e36f;

/// What the values of a buffer are brought into.
struct Range {
    float least, most;
};

/// What stands for a value that is not known: 0, or its neighbours' mean or largest.
enum class Missing { zero, mean, most };

/// What the values of a buffer mean that is no radiance.
struct Meaning {
    Range range;
    Missing missing; ///< what stands for what is not finite
    bool open;       ///< what lies above the range is not known either, else it is clamped
};

/// A buffer that networks are shown pixel by pixel, as it is.
struct Guide {
    const char *name;
    Meaning meaning;
    bool flagged; ///< a graph may ask by the input NAME.present whether the frame has it
};

/// All of them, each among the known buffers too.
const std::vector<Guide> &guides();

/// The guide of that name, or null.
const Guide *find_guide(const std::string &name);

/// Of a guide, of alpha and of variances.
Meaning meaning_of(const std::string &buffer);

} // namespace pathfold::core
