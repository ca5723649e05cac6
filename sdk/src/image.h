#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "pathfold/pathfold.h"

namespace pathfold::core {

/// A view of the caller's pixels: any strides, float32 or float16. Only this file knows either.
class ImageView {
public:
    ImageView() = default;

    /// Checks all but the data; `name` is what messages call it. Throws invalid-argument.
    ImageView(const pathfold_image &image, const std::string &name);

    /// Throws invalid-argument where there are no pixels yet.
    void expect_data(const std::string &name) const;

    bool empty() const { return image_.width == 0; } ///< whether it is no view of anything
    int64_t samples() const { return image_.samples; }
    int height() const { return int(image_.height); }
    int width() const { return int(image_.width); }
    int channels() const { return int(image_.channels); }

    /// Reads `count` pixels of row y from column x on, interleaved: out[pixel * channels + channel].
    void load_row(int64_t sample, int y, int x, int count, float *out) const;

    /// Writes the same way; values beyond half's range are clamped to it.
    void store_row(int y, int x, int count, const float *values) const;

    /// Whether a byte belongs to both views, told by their strides: views that lie between each other's
    /// pixels, as members of one struct do, share none.
    bool overlaps(const ImageView &other) const;

    /// Whether two of the view's own values share a byte: a stride is 0, or too small.
    bool overlaps_itself() const;

    /// "480 x 640 x 3", with samples in front where there is more than one.
    std::string size_text() const;

private:
    char *at(int64_t sample, int y, int x) const;
    bool packed() const; // pixels and channels of a row follow each other without gaps
    template <typename Value>
    void gather_values(const char *start, int count, Value *out) const;
    template <typename Value>
    void scatter_values(const Value *values, int count, char *start) const;

    pathfold_image image_{};
};

/// Planar float32 pixels of our own: values[channel][y][x].
class Planes {
public:
    Planes() = default;
    Planes(int channels, int height, int width)
        : channels_(channels), height_(height), width_(width),
          values_(size_t(channels) * size_t(height) * size_t(width)) {}

    int channels() const { return channels_; }
    int height() const { return height_; }
    int width() const { return width_; }
    float *row(int channel, int y) { return values_.data() + (size_t(channel) * height_ + y) * width_; }
    const float *row(int channel, int y) const {
        return values_.data() + (size_t(channel) * height_ + y) * width_;
    }

private:
    int channels_ = 0, height_ = 0, width_ = 0;
    std::vector<float> values_;
};

} // namespace pathfold::core
