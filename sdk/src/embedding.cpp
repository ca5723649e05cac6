#include "embedding.h"

#include <algorithm>
#include <functional>

namespace pathfold::core {

void Embedding::reset(int64_t channels, int height, int width) {
    channels_ = channels;
    height_ = cells(height);
    width_ = cells(width);
    sums_.assign(size_t(channels) * height_ * width_, 0.0f);
}

void Embedding::add(const Rect &area, const float *sums) {
    const int width = cells(area.width);
    for (int64_t c = 0; c < channels_; ++c)
        for (int y = 0; y < cells(area.height); ++y, sums += width) {
            float *row = sums_.data() + offset(c, area.y / 2 + y) + area.x / 2;
            std::transform(sums, sums + width, row, row, std::plus<float>());
        }
}

void Embedding::copy(const Rect &window, float *out) const {
    const int width = cells(window.width);
    for (int64_t c = 0; c < channels_; ++c)
        for (int y = 0; y < cells(window.height); ++y, out += width)
            std::copy_n(sums_.data() + offset(c, window.y / 2 + y) + window.x / 2, width, out);
}

} // namespace pathfold::core
