#include "tiles.h"

#include <algorithm>
#include <limits>

namespace pathfold::core {
namespace {

int64_t round_up(int64_t value, int64_t step) { return (value + step - 1) / step * step; }

/// One way to cut an axis: the core size, and the windows that follow from it.
struct Cut {
    int core = 0;
    int64_t largest = 0, sum = 0; // of the windows
};

Cut cut_axis(int size, int core, int overlap) {
    Cut cut{core};
    for (int begin = 0; begin < size; begin += core) {
        const int window = std::min(size, begin + core + overlap) - std::max(0, begin - overlap);
        cut.largest = std::max<int64_t>(cut.largest, window);
        cut.sum += window;
    }
    return cut;
}

/// The cuts into 1, 2, 3, ... aligned parts.
std::vector<Cut> possible_cuts(int size, int alignment, int overlap) {
    std::vector<Cut> cuts;
    for (int parts = 1; parts <= size; ++parts) {
        const int core = int(round_up((size + parts - 1) / parts, alignment));
        if (cuts.empty() || core < cuts.back().core)
            cuts.push_back(cut_axis(size, core, overlap));
        if (core <= alignment)
            break;
    }
    return cuts;
}

} // namespace

Rect grown(const Rect &rect, int margin, int width, int height) {
    const int x = std::max(0, rect.x - margin), y = std::max(0, rect.y - margin);
    return {x, y, std::min(width, rect.x + rect.width + margin) - x,
            std::min(height, rect.y + rect.height + margin) - y};
}

std::vector<Tile> plan_tiles(int width, int height, int alignment, int overlap, int64_t max_pixels,
                             int edge) {
    overlap = int(round_up(overlap, alignment));
    Cut across{edge}, down{edge};
    if (edge == 0) {
        int64_t least = std::numeric_limits<int64_t>::max();
        const std::vector<Cut> rows = possible_cuts(height, alignment, overlap);
        for (const Cut &x : possible_cuts(width, alignment, overlap))
            for (const Cut &y : rows)
                if (x.largest * y.largest <= max_pixels && x.sum * y.sum < least)
                    least = x.sum * y.sum, across = x, down = y;
        if (across.core == 0)
            return {};
    }
    std::vector<Tile> tiles;
    for (int y = 0; y < height; y += down.core)
        for (int x = 0; x < width; x += across.core) {
            const Rect core{x, y, std::min(across.core, width - x), std::min(down.core, height - y)};
            tiles.push_back({core, grown(core, overlap, width, height)});
        }
    return tiles;
}

} // namespace pathfold::core
