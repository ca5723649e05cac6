#pragma once

#include "pathfold/pathfold.h"

namespace pathfold::core {

/// Fills the channels of one path of `vertices` recorded vertices, see pathfold_describe_path. Throws
/// invalid-argument.
void describe_path(const pathfold_path &path, int vertices, float *descriptor, float *density);

/// Spreads `count` descriptors of some vertices, side by side and in place, to those of all: what is not
/// given no path has.
void add_vertices(float *descriptors, int count, int vertices);

/// Makes a descriptor of all vertices that of a path of which nothing is known.
void clear_descriptor(float *descriptor);

} // namespace pathfold::core
