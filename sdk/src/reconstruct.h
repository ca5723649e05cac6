#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "image.h"
#include "parallel.h"

namespace pathfold::core {

/// The pixels that the kernels of one tile reach: the tile and `radius` more on every side. What lies outside
/// the image, or is masked, is not valid and holds 0. Each pixel may shift the logit of every tap that falls
/// on it.
class Neighbourhood {
public:
    /// Starts afresh with everything 0 and not valid; keeps its memory. `shifted`: valid pixels may shift by
    /// other than 0.
    void reset(int planes, int height, int width, int radius, bool shifted = false);

    int planes() const { return planes_; }
    int height() const { return height_; } ///< of the tile
    int width() const { return width_; }
    int radius() const { return radius_; }
    size_t stride() const { return stride_; } ///< from a row to the next, in floats

    /// First value of a row, at x = -radius; y counts from -radius too.
    float *row(int plane, int y) { return values_.data() + (size_t(plane) * rows() + y + radius_) * stride_; }
    const float *row(int plane, int y) const { return const_cast<Neighbourhood *>(this)->row(plane, y); }

    /// What a tap's pixel adds to the tap's logit: minus infinity where it is not valid; laid out as a plane.
    float *shift_row(int y) { return row(planes_, y); }
    const float *shift_row(int y) const { return row(planes_, y); }

    /// To be called when all rows are filled.
    void finish();

    /// How many of the taps that `count` pixels, side by side from (x, y) on, reach together are not valid.
    int invalid_taps(int x, int y, int count) const;

    /// Whether a tap of these pixels has another shift than 0.
    bool shifts(int x, int y, int count) const { return shifted_ || invalid_taps(x, y, count) > 0; }

private:
    size_t rows() const { return size_t(height_) + 2 * size_t(radius_); }

    int planes_ = 0, height_ = 0, width_ = 0, radius_ = 0;
    size_t stride_ = 0;
    bool shifted_ = false;
    std::vector<float> values_;    // planes, then the shifts
    std::vector<int32_t> invalid_; // summed over all rows above and all columns to the left
};

/// Logits of a window, [tap][window height][window width]; points at the tile's first pixel.
struct Logits {
    const float *data = nullptr;
    size_t tap_stride = 0, row_stride = 0;
};

/// Pixels of a row that are worked on at a time.
constexpr size_t gather_block = 64;

/// Floats that may be read past the end of a logits array.
constexpr size_t gather_slack = gather_block;

/// Applies the kernels: result[plane][y][x] = sum over valid taps of softmax(logits + shifts) * value,
/// correlation, taps row by row, size 2 * radius + 1. A pixel without a valid tap becomes 0; one whose logits
/// are all NaN, or of which one is infinite, becomes NaN.
void gather(Threads &threads, const Logits &logits, const Neighbourhood &source, float *result);

/// The same for a whole image whose pixels are valid where their values are finite; packed logits
/// [tap][height][width]. The result has the image's size and channels.
void gather_image(Threads &threads, const ImageView &image, const float *logits, int radius,
                  const ImageView &result);

} // namespace pathfold::core
