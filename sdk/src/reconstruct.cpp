#include "reconstruct.h"

#include <algorithm>
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

/// Largest logit among the taps of the pixels from `logits` on; taps that are not valid do not count.
template <bool masked>
hn::Vec<D> LargestLogit(const float *logits, size_t tap_stride, const float *valid, size_t stride, int size) {
    const D d;
    const auto zero = hn::Zero(d);
    auto largest = hn::Set(d, std::numeric_limits<float>::lowest());
    for (int dy = 0; dy < size; ++dy)
        for (int dx = 0; dx < size; ++dx, logits += tap_stride) {
            const auto larger = hn::Max(largest, hn::LoadU(d, logits));
            if constexpr (masked)
                largest =
                    hn::IfThenElse(hn::Gt(hn::LoadU(d, valid + dy * stride + dx), zero), larger, largest);
            else
                largest = larger;
        }
    return largest;
}

/// Writes exp(logit - largest) of every tap to `weights`, 0 for taps that are not valid; returns their sum.
template <bool masked>
hn::Vec<D> Weights(const float *logits, size_t tap_stride, const float *valid, size_t stride, int size,
                   hn::Vec<D> largest, float *weights) {
    const D d;
    const auto zero = hn::Zero(d);
    auto sum = zero;
    for (int dy = 0; dy < size; ++dy)
        for (int dx = 0; dx < size; ++dx, logits += tap_stride, weights += hn::Lanes(d)) {
            auto weight = hn::Exp(d, hn::Sub(hn::LoadU(d, logits), largest));
            if constexpr (masked)
                weight = hn::IfThenElseZero(hn::Gt(hn::LoadU(d, valid + dy * stride + dx), zero), weight);
            sum = hn::Add(sum, weight);
            hn::StoreU(weight, d, weights);
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
        for (int dx = 0; dx < size; ++dx, weights += hn::Lanes(d)) {
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

void GatherRow(const Logits &logits, const Neighbourhood &source, int y, float *scratch, float *result) {
    const D d;
    const int size = 2 * source.radius() + 1, width = source.width();
    const size_t lanes = hn::Lanes(d), stride = source.stride();
    const size_t plane_stride = source.row(1, 0) - source.row(0, 0);
    const size_t result_stride = size_t(width) * source.height();
    for (int x = 0; x < width; x += int(lanes)) {
        const size_t count = std::min(lanes, size_t(width - x));
        const float *first = logits.data + y * logits.row_stride + x;
        const float *valid = source.valid_row(y - source.radius()) + x;
        const bool all = source.invalid_taps(x, y, int(count)) == 0;
        const auto largest = all ? LargestLogit<false>(first, logits.tap_stride, valid, stride, size)
                                 : LargestLogit<true>(first, logits.tap_stride, valid, stride, size);
        const auto sum = all ? Weights<false>(first, logits.tap_stride, valid, stride, size, largest, scratch)
                             : Weights<true>(first, logits.tap_stride, valid, stride, size, largest, scratch);
        for (int plane = 0; plane < source.planes(); plane += 4) {
            const float *values = source.row(plane, y - source.radius()) + x;
            float *out = result + plane * result_stride + size_t(y) * width + x;
            using ApplyPlanes = decltype(&Apply<1>);
            constexpr ApplyPlanes choices[] = {Apply<1>, Apply<2>, Apply<3>, Apply<4>};
            const ApplyPlanes apply = choices[std::min(source.planes() - plane, 4) - 1];
            apply(scratch, sum, values, plane_stride, stride, size, count, out, result_stride);
        }
        // The largest weight is 1, so a sum of 0 comes from taps that are not valid, or from logits of NaN.
        if (!hn::AllFalse(d, hn::Eq(sum, hn::Zero(d))))
            for (size_t i = 0; i < count; ++i)
                if (source.invalid_taps(x + int(i), y, 1) == size * size)
                    for (int plane = 0; plane < source.planes(); ++plane)
                        result[plane * result_stride + size_t(y) * width + x + i] = 0;
    }
}

/// Floats of scratch memory that GatherRow needs for each tap.
size_t LaneCount() { return hn::Lanes(D()); }

} // namespace HWY_NAMESPACE
} // namespace pathfold::core
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pathfold::core {

HWY_EXPORT(GatherRow);
HWY_EXPORT(LaneCount);

void Neighbourhood::reset(int planes, int height, int width, int radius) {
    planes_ = planes, height_ = height, width_ = width, radius_ = radius;
    stride_ = size_t(width) + 2 * size_t(radius);
    values_.assign((size_t(planes) + 1) * rows() * stride_ + gather_slack, 0.0f);
}

void Neighbourhood::finish() {
    const size_t columns = stride_ + 1;
    invalid_.assign((rows() + 1) * columns, 0);
    for (size_t y = 0; y < rows(); ++y) {
        const float *valid = valid_row(int(y) - radius_);
        int32_t in_row = 0;
        for (size_t x = 0; x < stride_; ++x) {
            in_row += valid[x] == 0.0f;
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
    const size_t scratch_size = size * size * HWY_DYNAMIC_DISPATCH(LaneCount)();
    threads.execute([&] {
        using Rows = oneapi::tbb::blocked_range<int>;
        oneapi::tbb::parallel_for(Rows(0, source.height()), [&](const Rows &rows) {
            std::vector<float> scratch(scratch_size);
            for (int y = rows.begin(); y != rows.end(); ++y)
                HWY_DYNAMIC_DISPATCH(GatherRow)(logits, source, y, scratch.data(), result);
        });
    });
}

} // namespace pathfold::core
#endif
