#include "reconstruct.h"

#include <algorithm>
#include <cmath>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "reconstruct.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace pathfold::core {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<float>;

/// Adds the taps' shifts to the logits; returns the largest logit. A tap that is not valid has no weight,
/// whatever its logit.
template <bool shifted>
hn::Vec<D> LargestLogit(float *logits, const float *shifts, size_t stride, int size) {
    const D d;
    const auto never = hn::Set(d, -std::numeric_limits<float>::infinity());
    auto largest = hn::Set(d, std::numeric_limits<float>::lowest());
    for (int dy = 0; dy < size; ++dy)
        for (int dx = 0; dx < size; ++dx, logits += gather_block) {
            auto logit = hn::LoadU(d, logits);
            if constexpr (shifted) {
                const auto shift = hn::LoadU(d, shifts + dy * stride + dx);
                logit = hn::IfThenElse(hn::Eq(shift, never), never, hn::Add(logit, shift));
                hn::StoreU(logit, d, logits);
            }
            largest = hn::Max(largest, logit);
        }
    return largest;
}

/// Turns logits into weights, exp(logit - largest), and returns their sum.
hn::Vec<D> WeighTaps(float *logits, int taps, hn::Vec<D> largest) {
    const D d;
    auto sum = hn::Zero(d);
    for (int tap = 0; tap < taps; ++tap, logits += gather_block) {
        const auto weight = hn::Exp(d, hn::Sub(hn::LoadU(d, logits), largest));
        sum = hn::Add(sum, weight);
        hn::StoreU(weight, d, logits);
    }
    return sum;
}

/// Stores the first `count` lanes of total / sum.
void WriteMean(hn::Vec<D> total, hn::Vec<D> sum, size_t count, float *result) {
    const D d;
    HWY_ALIGN float lanes[hn::MaxLanes(d)];
    hn::Store(hn::Div(total, sum), d, lanes);
    std::copy_n(lanes, count, result);
}

/// Weighted means of `planes` (1 to 4) neighbouring planes.
template <int planes>
void Apply(const float *weights, hn::Vec<D> sum, const float *values, size_t plane_stride, size_t stride,
           int size, size_t count, float *result, size_t result_stride) {
    const D d;
    auto total0 = hn::Zero(d), total1 = total0, total2 = total0, total3 = total0;
    for (int dy = 0; dy < size; ++dy)
        for (int dx = 0; dx < size; ++dx, weights += gather_block) {
            const auto weight = hn::LoadU(d, weights);
            const float *value = values + dy * stride + dx;
            total0 = hn::MulAdd(weight, hn::LoadU(d, value), total0);
            if constexpr (planes > 1)
                total1 = hn::MulAdd(weight, hn::LoadU(d, value + plane_stride), total1);
            if constexpr (planes > 2)
                total2 = hn::MulAdd(weight, hn::LoadU(d, value + 2 * plane_stride), total2);
            if constexpr (planes > 3)
                total3 = hn::MulAdd(weight, hn::LoadU(d, value + 3 * plane_stride), total3);
        }
    WriteMean(total0, sum, count, result);
    if constexpr (planes > 1)
        WriteMean(total1, sum, count, result + result_stride);
    if constexpr (planes > 2)
        WriteMean(total2, sum, count, result + 2 * result_stride);
    if constexpr (planes > 3)
        WriteMean(total3, sum, count, result + 3 * result_stride);
}

/// One vector of pixels from (x, y) on, whose logits lie in `weights`, gather_block from tap to tap.
void GatherPixels(const Neighbourhood &source, int x, int y, size_t count, float *weights, float *result) {
    const D d;
    const int size = 2 * source.radius() + 1;
    const size_t stride = source.stride(), plane_stride = source.row(1, 0) - source.row(0, 0);
    const size_t result_stride = size_t(source.width()) * source.height();
    const float *shifts = source.shift_row(y - source.radius()) + x;
    const auto find = source.shifts(x, y, int(count)) ? LargestLogit<true> : LargestLogit<false>;
    const auto largest = find(weights, shifts, stride, size);
    const auto sum = WeighTaps(weights, size * size, largest);
    using ApplyPlanes = decltype(&Apply<1>);
    constexpr ApplyPlanes choices[] = {Apply<1>, Apply<2>, Apply<3>, Apply<4>};
    for (int plane = 0; plane < source.planes(); plane += 4) {
        const float *values = source.row(plane, y - source.radius()) + x;
        float *out = result + plane * result_stride + size_t(y) * source.width() + x;
        const ApplyPlanes apply = choices[std::min(source.planes() - plane, 4) - 1];
        apply(weights, sum, values, plane_stride, stride, size, count, out, result_stride);
    }
    // The largest weight is 1, so a sum of 0 comes from taps that are not valid, or from logits of NaN.
    if (!hn::AllFalse(d, hn::Eq(sum, hn::Zero(d))))
        for (size_t i = 0; i < count; ++i)
            if (source.invalid_taps(x + int(i), y, 1) == size * size)
                for (int plane = 0; plane < source.planes(); ++plane)
                    result[plane * result_stride + size_t(y) * source.width() + x + i] = 0;
}

void GatherRow(const Logits &logits, const Neighbourhood &source, int y, float *scratch, float *result) {
    const size_t taps = size_t(2 * source.radius() + 1) * (2 * source.radius() + 1);
    const size_t width = size_t(source.width()), lanes = hn::Lanes(D());
    for (size_t x = 0; x < width; x += gather_block) {
        // The taps of a pixel lie far apart, each in a memory page of its own: fetch many pixels at a time.
        const float *from = logits.data + size_t(y) * logits.row_stride + x;
        for (size_t tap = 0; tap < taps; ++tap)
            std::copy_n(from + tap * logits.tap_stride, gather_block, scratch + tap * gather_block);
        for (size_t i = 0; i < gather_block && x + i < width; i += lanes)
            GatherPixels(source, int(x + i), y, std::min(lanes, width - x - i), scratch + i, result);
    }
}

} // namespace HWY_NAMESPACE
} // namespace pathfold::core
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pathfold::core {

HWY_EXPORT(GatherRow);

void Neighbourhood::reset(int planes, int height, int width, int radius, bool shifted) {
    planes_ = planes, height_ = height, width_ = width, radius_ = radius, shifted_ = shifted;
    stride_ = size_t(width) + 2 * size_t(radius);
    values_.assign((size_t(planes) + 1) * rows() * stride_ + gather_slack, 0.0f);
    std::fill_n(shift_row(-radius), rows() * stride_, -std::numeric_limits<float>::infinity());
}

void Neighbourhood::finish() {
    const size_t columns = stride_ + 1;
    invalid_.assign((rows() + 1) * columns, 0);
    for (size_t y = 0; y < rows(); ++y) {
        const float *shifts = shift_row(int(y) - radius_);
        int32_t in_row = 0;
        for (size_t x = 0; x < stride_; ++x) {
            in_row += shifts[x] == -std::numeric_limits<float>::infinity();
            invalid_[(y + 1) * columns + x + 1] = invalid_[y * columns + x + 1] + in_row;
        }
    }
}

int Neighbourhood::invalid_taps(int x, int y, int count) const {
    const size_t columns = stride_ + 1, size = 2 * size_t(radius_) + 1;
    const int32_t *above = invalid_.data() + size_t(y) * columns + x, *below = above + size * columns;
    const size_t right = size + size_t(count) - 1;
    return below[right] - below[0] - above[right] + above[0];
}

void gather(Threads &threads, const Logits &logits, const Neighbourhood &source, float *result) {
    const size_t size = 2 * size_t(source.radius()) + 1;
    const size_t scratch_size = size * size * gather_block;
    for_row_blocks(threads, 0, source.height(), [&](int begin, int end) {
        std::vector<float> scratch(scratch_size);
        for (int y = begin; y != end; ++y)
            HWY_DYNAMIC_DISPATCH(GatherRow)(logits, source, y, scratch.data(), result);
    });
}

void gather_image(Threads &threads, const ImageView &image, const float *logits, int radius,
                  const ImageView &result) {
    const int height = image.height(), width = image.width(), channels = image.channels();
    const size_t pixels = size_t(height) * width, taps = size_t(2 * radius + 1) * (2 * radius + 1);
    std::vector<float> row(size_t(width) * channels);
    Neighbourhood source;
    source.reset(channels, height, width, radius);
    for (int y = 0; y < height; ++y) {
        image.load_row(0, y, 0, width, row.data());
        for (int x = 0; x < width; ++x) {
            const float *pixel = row.data() + size_t(x) * channels;
            if (!std::all_of(pixel, pixel + channels, [](float value) { return std::isfinite(value); }))
                continue;
            source.shift_row(y)[radius + x] = 0;
            for (int c = 0; c < channels; ++c)
                source.row(c, y)[radius + x] = pixel[c];
        }
    }
    source.finish();
    std::vector<float> copy(logits, logits + taps * pixels), gathered(pixels * channels);
    copy.resize(copy.size() + gather_slack);
    gather(threads, {copy.data(), pixels, size_t(width)}, source, gathered.data());
    for (int y = 0; y < height; ++y) {
        for (int c = 0; c < channels; ++c)
            for (int x = 0; x < width; ++x)
                row[size_t(x) * channels + c] = gathered[size_t(c) * pixels + size_t(y) * width + x];
        result.store_row(y, 0, width, row.data());
    }
}

} // namespace pathfold::core
#endif
