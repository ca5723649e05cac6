#pragma once

#include <cstddef>
#include <vector>

namespace pathfold::training {

/// Taps of B images. logits [B][channels][height][width]: those from channel `first` on, one for each tap.
/// source [B][4][rows][stride]: of pixel (y, x) tap t is at (y, x) + offsets[t], inside.
struct Taps {
    static constexpr size_t planes = 4; ///< three of values and their weight

    size_t images = 0, channels = 0, first = 0, height = 0, width = 0; ///< of logits
    size_t rows = 0, stride = 0;                                       ///< of source
    std::vector<size_t> offsets;                                       ///< dy * stride + dx

    size_t plane() const { return rows * stride; }
    size_t logit(size_t image) const { return (image * channels + first) * height * width; }
};

/// sums [B][4][height][width] = sum over t of exp(clamp(logit, -10, 10) - 5) * source. On at most so many
/// threads.
void sum_taps(const Taps &taps, int threads, const float *logits, const float *source, float *sums);

/// Gradients of both from that of the sums, which has their shape; an image at a time on each thread.
/// of_logits has all channels, and those of no tap stay: several calls fill it.
void spread_taps(const Taps &taps, int threads, const float *logits, const float *source,
                 const float *gradient, float *of_logits, float *of_source);

} // namespace pathfold::training
