#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tiles.h"

namespace pathfold::core {

/// What a window is rounded up to where a network predicts at lower resolutions too.
constexpr int coarse_alignment = 16;

/// One axis of a tensor: a size, or a name ("H", "W", "S") where size is -1. "H/4" is a quarter of H rounded
/// up to a multiple of 16.
struct Dim {
    int64_t size = -1;
    std::string name;
};
using Shape = std::vector<Dim>;

/// The names that an axis may have.
const std::vector<std::string> &dim_names();

/// "[1, 3, H, W]".
std::string shape_text(const Shape &shape);

bool operator==(const Dim &a, const Dim &b);

/// The sizes for a window of so many samples per pixel.
std::vector<int64_t> sizes_of(const Shape &shape, const Rect &window, int64_t samples);

/// Floats for each pixel of a large window, rounded up; 0 for a scalar.
int64_t floats_per_pixel(const Shape &shape, int64_t samples);

} // namespace pathfold::core
