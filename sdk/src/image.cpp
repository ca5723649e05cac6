#include "image.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <utility>

#include "error.h"
#include "half.h"

namespace pathfold::core {
namespace {

constexpr int64_t max_edge = 1 << 16;
constexpr int64_t max_samples = 1 << 16;
constexpr int64_t max_channels = 64;

int64_t value_size(int32_t format) { return format == PATHFOLD_FLOAT16 ? 2 : 4; }

/// The bytes between which a view's values lie: [first, last).
std::pair<uintptr_t, uintptr_t> extent(const pathfold_image &image) {
    int64_t low = 0, high = value_size(image.format);
    const std::pair<int64_t, int64_t> axes[] = {{image.samples, image.sample_stride},
                                                {image.height, image.row_stride},
                                                {image.width, image.pixel_stride},
                                                {image.channels, image.channel_stride}};
    for (auto [count, stride] : axes)
        (stride < 0 ? low : high) += (count - 1) * stride;
    const auto base = reinterpret_cast<uintptr_t>(image.data);
    return {base + uintptr_t(low), base + uintptr_t(high)};
}

} // namespace

ImageView::ImageView(const pathfold_image &image, const std::string &name) : image_(image) {
    if (image.format != PATHFOLD_FLOAT32 && image.format != PATHFOLD_FLOAT16)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": format is ", image.format,
             "; it must be PATHFOLD_FLOAT32 (0) or PATHFOLD_FLOAT16 (1)");
    if (image.width < 1 || image.height < 1 || image.channels < 1 || image.samples < 1)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": the image is ", size_text(),
             " (height x width x channels); it must have at least one pixel");
    if (image.width > max_edge || image.height > max_edge || image.channels > max_channels ||
        image.samples > max_samples)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": the image is ", size_text(), "; at most ", max_samples,
             " x ", max_edge, " x ", max_edge, " x ", max_channels, " is possible");
}

void ImageView::expect_data(const std::string &name) const {
    if (image_.data == nullptr)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": data is a null pointer; give the first pixel's address");
}

std::string ImageView::size_text() const {
    const std::string size = text(image_.height, " x ", image_.width, " x ", image_.channels);
    return image_.samples > 1 ? text(image_.samples, " x ", size) : size;
}

char *ImageView::at(int64_t sample, int y, int x) const {
    return static_cast<char *>(image_.data) + sample * image_.sample_stride + y * image_.row_stride +
           x * image_.pixel_stride;
}

bool ImageView::packed() const {
    const int64_t size = value_size(image_.format);
    return (image_.channel_stride == size || image_.channels == 1) &&
           image_.pixel_stride == size * image_.channels;
}

void ImageView::load_row(int64_t sample, int y, int x, int count, float *out) const {
    const char *start = at(sample, y, x);
    const size_t values = size_t(count) * size_t(image_.channels);
    if (image_.format == PATHFOLD_FLOAT32) {
        if (packed())
            std::memcpy(out, start, values * sizeof(float));
        else
            gather_values(start, count, out);
        return;
    }
    thread_local std::vector<uint16_t> halves; // in order, so that they convert as vectors
    halves.resize(values);
    if (packed())
        std::memcpy(halves.data(), start, values * sizeof(uint16_t));
    else
        gather_values(start, count, halves.data());
    half_to_float(halves.data(), values, out);
}

void ImageView::store_row(int y, int x, int count, const float *values) const {
    char *start = at(0, y, x);
    const size_t all = size_t(count) * size_t(image_.channels);
    if (image_.format == PATHFOLD_FLOAT32) {
        scatter_values(values, count, start);
        return;
    }
    thread_local std::vector<uint16_t> halves;
    halves.resize(all);
    float_to_half(values, all, halves.data());
    scatter_values(halves.data(), count, start);
}

/// Channel by channel, since planar views, whose channels are far apart, are the common kind that is not
/// packed.
template <typename Value>
void ImageView::gather_values(const char *start, int count, Value *out) const {
    for (int64_t c = 0; c < image_.channels; ++c)
        for (int64_t i = 0; i < count; ++i)
            std::memcpy(out + i * image_.channels + c,
                        start + i * image_.pixel_stride + c * image_.channel_stride, sizeof(Value));
}

template <typename Value>
void ImageView::scatter_values(const Value *values, int count, char *start) const {
    for (int64_t c = 0; c < image_.channels; ++c)
        for (int64_t i = 0; i < count; ++i)
            std::memcpy(start + i * image_.pixel_stride + c * image_.channel_stride,
                        values + i * image_.channels + c, sizeof(Value));
}

bool ImageView::overlaps(const ImageView &other) const {
    const auto [begin, end] = extent(image_);
    const auto [other_begin, other_end] = extent(other.image_);
    return begin < other_end && other_begin < end;
}

} // namespace pathfold::core
