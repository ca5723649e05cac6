#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "parallel.h"
#include "tiles.h"

namespace pathfold::core {

/// What a network predicted for a window whose height and width are rounded up to multiples of 16.
///
/// `trust` [4][H/2][W/2]: of each pixel, in [-9, 0]; channel 2 * (y % 2) + x % 2. Null: 0 everywhere.
/// `levels[0]` [4 * 30][H/2][W/2]: the finest level, channel 4 * c + 2 * (y % 2) + x % 2 for its logit c;
/// `levels[l]` [30][H/2^l][W/2^l], the last one that is used [25]. A level's logits: 25 of the 5 x 5 kernel,
/// row by row, 4 of the 2 x 2 upsampling, row by row, and the blend. Arrays may be read up to pyramid_slack
/// floats past their end.
struct PyramidLogits {
    static constexpr int level_count = 5;
    static constexpr int coarsest_channels = 25, channels = 25 + 4 + 1;

    const float *trust = nullptr;
    std::array<const float *, level_count> levels{};
};

constexpr size_t pyramid_slack = 64;

/// The trusted gather pyramid. With s = exp(trust) and D the average of 2 x 2 cells:
/// N_0 = s * value, W_0 = s, 0 where nothing is valid; N_l+1 = D N_l, W_l+1 = D W_l;
/// F_l = sum_d k_l(d) N_l(p + d) / sum_d k_l(d) W_l(p + d), k = exp(logit), logits clamped to [-10, 10];
/// O_l = (1 - a_l) F_l + a_l * weighted mean of the 2 x 2 nearest cells of O_l+1; a = sigmoid(logit).
/// So every result is a convex combination of valid values. A side without a valid tap leaves the result to
/// the other one; without any it is 0. As networks/reconstruct.py, gather_pyramid.
class Pyramid {
public:
    static constexpr int levels = PyramidLogits::level_count;
    static constexpr int alignment = 1 << (levels - 1);
    static constexpr int factor_levels = 3; ///< of the pyramid that cleans what radiance is divided by

    /// A result of `count` levels depends on values at most so many pixels away: two of the coarsest cells
    /// and what upsampling adds.
    static constexpr int reach(int count = levels) { return (4 << (count - 1)) - 2; }

    static constexpr int rounded_up(int size) { return (size + alignment - 1) / alignment * alignment; }

    /// Starts a window of so many levels, 2 at least, with everything 0 and not valid; keeps its memory.
    void reset(int planes, int height, int width, int count = levels);

    int planes() const { return planes_; }
    float *row(int plane, int y) { return level_[0].source_row(plane, y); }
    float *valid_row(int y) { return row(planes_, y); } ///< 1 where the pixel is valid, else 0

    /// result[plane][y][x] of the part `core` of the window, whose corner lies at a multiple of 16;
    /// `known[y][x]`, unless null, becomes 1 where there is a result, else 0. Uses up the values that were
    /// filled in.
    void apply(Threads &threads, const PyramidLogits &logits, const Rect &core, float *result,
               float *known = nullptr);

    /// One resolution: planes and then their weight, with a margin of zeros.
    struct Level {
        static constexpr int margin = 2;
        int height = 0, width = 0;
        std::vector<float> source, result;

        size_t stride() const { return size_t(width) + 2 * margin; }
        size_t plane_stride() const { return stride() * (size_t(height) + 2 * margin); }
        size_t offset(int plane, int y) const {
            return size_t(plane) * plane_stride() + size_t(y + margin) * stride() + margin;
        }
        float *source_row(int plane, int y) { return source.data() + offset(plane, y); }
        const float *source_row(int plane, int y) const { return source.data() + offset(plane, y); }
        float *result_row(int plane, int y) { return result.data() + offset(plane, y); }
        const float *result_row(int plane, int y) const { return result.data() + offset(plane, y); }
    };

private:
    void weigh(Threads &threads, const float *trust);
    void filter(Threads &threads, const PyramidLogits &logits, int level, const Rect &area, float *result,
                float *known);

    int planes_ = 0, count_ = levels;
    std::array<Level, levels> level_;
};

} // namespace pathfold::core
