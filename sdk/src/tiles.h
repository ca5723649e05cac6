#pragma once

#include <cstdint>
#include <vector>

namespace pathfold::core {

struct Rect {
    int x = 0, y = 0, width = 0, height = 0;
};

/// A part of the image that is denoised at once: `core` is written, `window` is what the network sees.
struct Tile {
    Rect core, window;
};

/// Grows a rectangle by `margin` on every side, as far as the image reaches.
Rect grown(const Rect &rect, int margin, int width, int height);

/// Covers the image with tiles whose windows have at most `max_pixels` pixels, with as little overlap as can
/// be; windows start at multiples of `alignment` and reach `overlap` pixels beyond the core, or to the
/// image's border. `edge` > 0 asks for square cores of that size instead. Empty where no tile is small
/// enough.
std::vector<Tile> plan_tiles(int width, int height, int alignment, int overlap, int64_t max_pixels,
                             int edge = 0);

} // namespace pathfold::core
