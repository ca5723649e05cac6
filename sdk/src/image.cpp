#include "image.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <utility>

#include "error.h"
#include "half.h"

namespace pathfold::core {
namespace {

constexpr int64_t max_edge = 1 << 16;
constexpr int64_t max_samples = 1 << 16;
constexpr int64_t max_channels = 64;

int64_t value_size(int32_t format) { return format == PATHFOLD_FLOAT16 ? 2 : 4; }

constexpr int64_t max_span = int64_t(1) << 48; // bytes: more than any process can address

/// How many steps of which size an axis of an image has.
struct Axis {
    int64_t count, stride;
};

std::array<Axis, 4> axes_of(const pathfold_image &image) {
    return {{{image.samples, image.sample_stride},
             {image.height, image.row_stride},
             {image.width, image.pixel_stride},
             {image.channels, image.channel_stride}}};
}

/// The bytes between which a view's values lie, from its first pixel: [first, second).
std::pair<int64_t, int64_t> reach(const pathfold_image &image) {
    int64_t low = 0, high = value_size(image.format);
    for (const Axis &axis : axes_of(image))
        (axis.stride < 0 ? low : high) += (axis.count - 1) * axis.stride;
    return {low, high};
}

void check_strides(const pathfold_image &image, const std::string &name) {
    int64_t span = 0;
    for (const Axis &axis : axes_of(image)) {
        int64_t bytes = 0;
        if (__builtin_mul_overflow(axis.count - 1, axis.stride, &bytes) || bytes > max_span ||
            bytes < -max_span)
            span = max_span;
        else
            span += std::abs(bytes);
        if (span >= max_span)
            fail(PATHFOLD_INVALID_ARGUMENT, name, ": a stride is ", axis.stride, " for ", axis.count,
                 " steps, further than memory reaches; give it in bytes");
    }
}

/// All sums of steps * stride, over some axes with bounds on the steps of each. A search that takes the axes
/// by falling strides: where these nest, as those of images do, hardly more than one number of steps comes
/// into question for each.
class Sums {
public:
    /// From `least` to `most` steps.
    void add(int64_t stride, int64_t least, int64_t most) {
        if (stride < 0)
            return add(-stride, -most, -least);
        Range &range = ranges_[stride];
        range.least += least;
        range.most += most;
    }

    /// Whether one lies in [low, high]. Says so, too, where that takes too long to find out.
    bool reach(int64_t low, int64_t high) {
        work_ = 0;
        return search(ranges_.begin(), low, high);
    }

private:
    struct Range {
        int64_t least = 0, most = 0;
    };
    using Ranges = std::map<int64_t, Range, std::greater<int64_t>>;

    static int64_t floor_of(int64_t value, int64_t by) { return value / by - (value % by < 0 ? 1 : 0); }

    bool search(Ranges::const_iterator at, int64_t low, int64_t high) {
        constexpr int most_work = 100000;
        if (at == ranges_.end())
            return low <= 0 && high >= 0;
        const auto [stride, range] = *at++;
        if (stride == 0)
            return search(at, low, high);
        int64_t rest_least = 0, rest_most = 0;
        for (auto rest = at; rest != ranges_.end(); ++rest) {
            rest_least += rest->first * rest->second.least;
            rest_most += rest->first * rest->second.most;
        }
        const int64_t first = std::max(range.least, -floor_of(rest_most - low, stride));
        const int64_t last = std::min(range.most, floor_of(high - rest_least, stride));
        for (int64_t steps = first; steps <= last; ++steps)
            if (++work_ > most_work || search(at, low - steps * stride, high - steps * stride))
                return true;
        return false;
    }

    Ranges ranges_;
    int work_ = 0;
};

} // namespace

ImageView::ImageView(const pathfold_image &image, const std::string &name) : image_(image) {
    if (image.format != PATHFOLD_FLOAT32 && image.format != PATHFOLD_FLOAT16)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": format is ", image.format,
             "; it must be PATHFOLD_FLOAT32 (0) or PATHFOLD_FLOAT16 (1)");
    if (image.samples < 1)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": samples is ", image.samples,
             "; it must be at least 1, which is what an image of pixels has");
    if (image.width < 1 || image.height < 1 || image.channels < 1)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": the image is ", size_text(),
             " (height x width x channels); it must have at least one pixel");
    if (image.width > max_edge || image.height > max_edge || image.channels > max_channels ||
        image.samples > max_samples)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": the image is ", size_text(), "; at most ", max_samples,
             " x ", max_edge, " x ", max_edge, " x ", max_channels, " is possible");
    check_strides(image, name);
}

void ImageView::expect_data(const std::string &name) const {
    if (image_.data == nullptr)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": data is a null pointer; give the first pixel's address");
    const auto base = reinterpret_cast<uintptr_t>(image_.data);
    const auto [low, high] = reach(image_);
    if (base + uintptr_t(low) > base || base + uintptr_t(high) < base)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": its strides lead out of memory; data is the address of the ",
             "first pixel, also where strides are negative");
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
    const auto address = [](const ImageView &view) {
        return static_cast<int64_t>(reinterpret_cast<uintptr_t>(view.image_.data));
    };
    const int64_t apart = address(*this) - address(other);
    const auto [low, high] = reach(image_);
    const auto [other_low, other_high] = reach(other.image_);
    if (apart + high <= other_low || apart + low >= other_high)
        return false; // the common case
    Sums sums;
    for (const Axis &axis : axes_of(image_))
        sums.add(axis.stride, 0, axis.count - 1);
    for (const Axis &axis : axes_of(other.image_))
        sums.add(axis.stride, 1 - axis.count, 0);
    return sums.reach(1 - value_size(image_.format) - apart, value_size(other.image_.format) - 1 - apart);
}

bool ImageView::overlaps_itself() const {
    const auto axes = axes_of(image_);
    const int64_t least = value_size(image_.format) - 1;
    // Two values differ in some axis first; in those after it by any number of steps.
    for (size_t first = 0; first < axes.size(); ++first) {
        Sums sums;
        if (axes[first].count == 1)
            continue;
        sums.add(axes[first].stride, 1, axes[first].count - 1);
        for (size_t i = first + 1; i < axes.size(); ++i)
            sums.add(axes[i].stride, 1 - axes[i].count, axes[i].count - 1);
        if (sums.reach(-least, least))
            return true;
    }
    return false;
}

} // namespace pathfold::core
