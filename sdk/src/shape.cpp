#include "shape.h"

#include <string>

namespace pathfold::core {
namespace {

/// Pixels from one entry to the next: 4 for "H/4".
int64_t step_of(const Dim &dim) { return dim.name.size() > 2 ? std::stoi(dim.name.substr(2)) : 1; }

int64_t size_of(const Dim &dim, const Rect &window, int64_t samples) {
    if (dim.size >= 0)
        return dim.size;
    if (dim.name == "S")
        return samples;
    const int64_t edge = dim.name[0] == 'H' ? window.height : window.width, step = step_of(dim);
    return step > 1 ? (edge + coarse_alignment - 1) / coarse_alignment * coarse_alignment / step : edge;
}

} // namespace

const std::vector<std::string> &dim_names() {
    static const std::vector<std::string> names = {"H",   "W",   "S",   "H/2",  "W/2", "H/4",
                                                   "W/4", "H/8", "W/8", "H/16", "W/16"};
    return names;
}

std::string shape_text(const Shape &shape) {
    std::string joined;
    for (const Dim &dim : shape)
        joined += (joined.empty() ? "" : ", ") + (dim.size >= 0 ? std::to_string(dim.size) : dim.name);
    return "[" + joined + "]";
}

bool operator==(const Dim &a, const Dim &b) { return a.size == b.size && a.name == b.name; }

std::vector<int64_t> sizes_of(const Shape &shape, const Rect &window, int64_t samples) {
    std::vector<int64_t> sizes;
    for (const Dim &dim : shape)
        sizes.push_back(size_of(dim, window, samples));
    return sizes;
}

int64_t floats_per_pixel(const Shape &shape, int64_t samples) {
    if (shape.size() < 2)
        return 0;
    int64_t floats = 1, pixels = 1;
    for (const Dim &dim : shape) {
        floats *= dim.size >= 0 ? dim.size : dim.name == "S" ? samples : 1;
        pixels *= step_of(dim);
    }
    return (floats + pixels - 1) / pixels;
}

} // namespace pathfold::core
