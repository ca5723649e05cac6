#include "pyramid.h"

#include <algorithm>
#include <cassert>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "pyramid.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <hwy/contrib/math/math-inl.h>

#ifndef PATHFOLD_PYRAMID_ROW
#define PATHFOLD_PYRAMID_ROW
namespace pathfold::core {

constexpr int kernel_taps = PyramidLogits::coarsest_channels, upsampling_taps = 4;
constexpr int blend_logit = kernel_taps + upsampling_taps, level_logits = PyramidLogits::channels;
constexpr size_t pyramid_block = pyramid_slack; // pixels of a row that are worked on at a time
constexpr float logit_limit = 10, least_trust = -9;
constexpr float logit_shift = -5; // cancels; keeps sums of the largest radiance finite

/// A part of a level's row to be filtered.
struct PyramidRow {
    const float *logits = nullptr; // of the row's first pixel
    size_t logit_stride = 0;       // from a logit to the next
    size_t phase_stride = 0;       // from even pixels to odd ones; 0 where every pixel has its own cell
    const Pyramid::Level *level = nullptr, *coarser = nullptr; // no coarser one: the coarsest
    int planes = 0, y = 0, begin = 0, end = 0;
    float *result = nullptr; // of the row's first pixel
    size_t result_stride = 0;
    float *known = nullptr; // gets 1 where the result is known; may be null
};

/// Scratch of one thread, rows of a block.
struct PyramidScratch {
    static constexpr size_t expanded = 3 * pyramid_block; // two rows of a coarser plane, with room to spare

    explicit PyramidScratch(int planes)
        : weights(level_logits * pyramid_block), own((planes + 1) * pyramid_block),
          coarse((planes + 1) * pyramid_block), below((planes + 1) * 2 * expanded) {}

    std::vector<float> weights, own, coarse, below;
};

} // namespace pathfold::core
#endif

HWY_BEFORE_NAMESPACE();
namespace pathfold::core {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<float>;

/// s = exp(trust) of a row, times everything in it.
void WeighRow(Pyramid::Level &level, int planes, const float *trust, size_t phase_stride, int y) {
    const D d;
    const size_t lanes = hn::Lanes(d), width = size_t(level.width);
    HWY_ALIGN float s[2 * hn::MaxLanes(d)];
    for (size_t x = 0; x < width; x += 2 * lanes) {
        hn::StoreInterleaved2(hn::LoadU(d, trust + x / 2), hn::LoadU(d, trust + x / 2 + phase_stride), d, s);
        const size_t count = std::min(2 * lanes, width - x);
        for (size_t i = 0; i < 2 * lanes; i += lanes) {
            const auto clamped = hn::Clamp(hn::Load(d, s + i), hn::Set(d, least_trust), hn::Zero(d));
            hn::Store(hn::Exp(d, clamped), d, s + i);
        }
        for (int plane = 0; plane <= planes; ++plane) {
            float *value = level.source_row(plane, y) + x;
            for (size_t i = 0; i < count; ++i)
                value[i] *= s[i];
        }
    }
}

/// A row of the next coarser level: the mean of 2 x 2 cells.
void HalveRow(const Pyramid::Level &fine, Pyramid::Level &coarse, int planes, int y) {
    const D d;
    const size_t lanes = hn::Lanes(d), width = size_t(coarse.width);
    HWY_ALIGN float mean[hn::MaxLanes(d)];
    for (int plane = 0; plane <= planes; ++plane) {
        const float *upper = fine.source_row(plane, 2 * y), *lower = fine.source_row(plane, 2 * y + 1);
        for (size_t x = 0; x < width; x += lanes) {
            hn::Vec<D> a, b, e, f;
            hn::LoadInterleaved2(d, upper + 2 * x, a, b);
            hn::LoadInterleaved2(d, lower + 2 * x, e, f);
            const auto sum = hn::Add(hn::Add(a, b), hn::Add(e, f));
            hn::Store(hn::Mul(sum, hn::Set(d, 0.25f)), d, mean);
            std::copy_n(mean, std::min(lanes, width - x), coarse.source_row(plane, y) + x);
        }
    }
}

/// Brings a block's logits together and makes weights of them, and of the last one the coarser level's weight
/// where the own one's is 1: of a share a, 1 - a would lose most of its digits where it is small.
void FetchWeights(const PyramidRow &row, size_t x, int count, float *weights) {
    const D d;
    const size_t lanes = hn::Lanes(d);
    for (int c = 0; c < count; ++c) {
        const float *from = row.logits + size_t(c) * row.logit_stride;
        float *to = weights + size_t(c) * pyramid_block;
        if (row.phase_stride == 0)
            std::copy_n(from + x, pyramid_block, to);
        else
            for (size_t i = 0; i < pyramid_block; i += 2 * lanes) {
                const float *even = from + (x + i) / 2;
                hn::StoreInterleaved2(hn::LoadU(d, even), hn::LoadU(d, even + row.phase_stride), d, to + i);
            }
        const auto most = hn::Set(d, logit_limit), least = hn::Set(d, -logit_limit);
        const auto shift = hn::Set(d, c == blend_logit ? 0.0f : logit_shift);
        for (size_t i = 0; i < pyramid_block; i += lanes) {
            const auto logit = hn::Clamp(hn::LoadU(d, to + i), least, most);
            hn::StoreU(hn::Exp(d, hn::Add(logit, shift)), d, to + i);
        }
    }
}

/// Two rows of the coarser result at this level's resolution, from two pixels before x on.
void ExpandCoarser(const PyramidRow &row, size_t x, float *below) {
    const D d;
    const size_t lanes = hn::Lanes(d);
    for (int plane = 0; plane <= row.planes; ++plane)
        for (int j = 0; j < 2; ++j, below += PyramidScratch::expanded) {
            const float *from = row.coarser->result_row(plane, ((row.y + 1) >> 1) - 1 + j) + x / 2 - 1;
            for (size_t i = 0; i < pyramid_block / 2 + 2; i += lanes) {
                const auto value = hn::LoadU(d, from + i);
                hn::StoreInterleaved2(value, value, d, below + 2 * i);
            }
        }
}

/// sums[plane] = sum over taps of weight * value, for `planes` (1 to 4) planes of one vector of pixels.
template <int planes>
void SumTaps(const float *weights, const size_t *offsets, int taps, const float *values, size_t plane_stride,
             float *sums) {
    const D d;
    auto total0 = hn::Zero(d), total1 = total0, total2 = total0, total3 = total0;
    for (int tap = 0; tap < taps; ++tap, weights += pyramid_block) {
        const auto weight = hn::LoadU(d, weights);
        const float *value = values + offsets[tap];
        total0 = hn::MulAdd(weight, hn::LoadU(d, value), total0);
        if constexpr (planes > 1)
            total1 = hn::MulAdd(weight, hn::LoadU(d, value + plane_stride), total1);
        if constexpr (planes > 2)
            total2 = hn::MulAdd(weight, hn::LoadU(d, value + 2 * plane_stride), total2);
        if constexpr (planes > 3)
            total3 = hn::MulAdd(weight, hn::LoadU(d, value + 3 * plane_stride), total3);
    }
    hn::StoreU(total0, d, sums);
    if constexpr (planes > 1)
        hn::StoreU(total1, d, sums + pyramid_block);
    if constexpr (planes > 2)
        hn::StoreU(total2, d, sums + 2 * pyramid_block);
    if constexpr (planes > 3)
        hn::StoreU(total3, d, sums + 3 * pyramid_block);
}

void SumAllTaps(const float *weights, const size_t *offsets, int taps, const float *values,
                size_t plane_stride, int planes, float *sums) {
    using Sum = decltype(&SumTaps<1>);
    constexpr Sum choices[] = {SumTaps<1>, SumTaps<2>, SumTaps<3>, SumTaps<4>};
    for (int plane = 0; plane < planes; plane += 4)
        choices[std::min(planes - plane, 4) - 1](weights, offsets, taps,
                                                 values + size_t(plane) * plane_stride, plane_stride,
                                                 sums + size_t(plane) * pyramid_block);
}

/// Blends own and coarser sums of one vector of pixels, x + i on, and stores `count` results.
void Blend(const PyramidRow &row, const PyramidScratch &scratch, size_t x, size_t i, size_t count) {
    const D d;
    const auto zero = hn::Zero(d), one = hn::Set(d, 1.0f);
    const size_t weight_row = size_t(row.planes) * pyramid_block + i;
    const auto own_weight = hn::LoadU(d, scratch.own.data() + weight_row);
    const auto own_known = hn::Gt(own_weight, zero);
    auto of_own = one, of_coarse = zero, coarse_weight = one;
    auto known = own_known;
    if (row.coarser != nullptr) {
        const auto odds = hn::LoadU(d, scratch.weights.data() + blend_logit * pyramid_block + i);
        coarse_weight = hn::LoadU(d, scratch.coarse.data() + weight_row);
        const auto coarse_known = hn::Gt(coarse_weight, zero);
        of_own = hn::IfThenElseZero(own_known, one);
        of_coarse = hn::IfThenElseZero(coarse_known, odds);
        const auto total = hn::Add(of_own, of_coarse);
        of_own = hn::Div(of_own, total);
        of_coarse = hn::IfThenElseZero(coarse_known, hn::Div(of_coarse, hn::Mul(total, coarse_weight)));
        known = hn::Or(own_known, coarse_known);
    }
    of_own = hn::IfThenElseZero(own_known, hn::Div(of_own, own_weight));
    HWY_ALIGN float lanes[hn::MaxLanes(d)];
    for (int plane = 0; plane < row.planes; ++plane) {
        const size_t at = size_t(plane) * pyramid_block + i;
        auto value = hn::Mul(of_own, hn::LoadU(d, scratch.own.data() + at));
        if (row.coarser != nullptr)
            value = hn::MulAdd(of_coarse, hn::LoadU(d, scratch.coarse.data() + at), value);
        hn::Store(value, d, lanes);
        std::copy_n(lanes, count, row.result + size_t(plane) * row.result_stride + x + i);
    }
    if (row.known != nullptr) {
        hn::Store(hn::IfThenElseZero(known, one), d, lanes);
        std::copy_n(lanes, count, row.known + x + i);
    }
}

void FilterRow(const PyramidRow &row, PyramidScratch &scratch) {
    const size_t lanes = hn::Lanes(D()), stride = row.level->stride();
    size_t kernel[kernel_taps], upsampling[upsampling_taps];
    for (int tap = 0; tap < kernel_taps; ++tap)
        kernel[tap] = size_t(tap / 5) * stride + size_t(tap % 5);
    for (int tap = 0; tap < upsampling_taps; ++tap) // the pixels to the left and to the right, in other cells
        upsampling[tap] = size_t(tap / 2) * PyramidScratch::expanded + (tap % 2 == 0 ? 1 : 3);
    for (size_t x = size_t(row.begin); x < size_t(row.end); x += pyramid_block) {
        const bool coarsest = row.coarser == nullptr;
        FetchWeights(row, x, coarsest ? kernel_taps : level_logits, scratch.weights.data());
        if (!coarsest)
            ExpandCoarser(row, x, scratch.below.data());
        for (size_t i = 0; i < pyramid_block && x + i < size_t(row.end); i += lanes) {
            const float *weights = scratch.weights.data() + i;
            SumAllTaps(weights, kernel, kernel_taps, row.level->source_row(0, row.y - 2) + x + i - 2,
                       row.level->plane_stride(), row.planes + 1, scratch.own.data() + i);
            if (!coarsest)
                SumAllTaps(weights + kernel_taps * pyramid_block, upsampling, upsampling_taps,
                           scratch.below.data() + i, 2 * PyramidScratch::expanded, row.planes + 1,
                           scratch.coarse.data() + i);
            Blend(row, scratch, x, i, std::min(lanes, size_t(row.end) - x - i));
        }
    }
}

} // namespace HWY_NAMESPACE
} // namespace pathfold::core
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pathfold::core {

HWY_EXPORT(WeighRow);
HWY_EXPORT(HalveRow);
HWY_EXPORT(FilterRow);

void Pyramid::reset(int planes, int height, int width, int count) {
    assert(count >= 2 && count <= levels);
    planes_ = planes, count_ = count;
    for (int l = 0; l < count; ++l) {
        level_[l].height = rounded_up(height) >> l;
        level_[l].width = rounded_up(width) >> l;
        // vectors are read a little past the last row
        const size_t size = size_t(planes + 1) * level_[l].plane_stride() + 2 * pyramid_block;
        level_[l].source.assign(size, 0.0f);
        if (l > 0)
            level_[l].result.assign(size, 0.0f);
    }
}

void Pyramid::weigh(Threads &threads, const float *trust) {
    const size_t width = size_t(level_[1].width), plane = width * level_[1].height;
    if (trust != nullptr)
        for_rows(threads, level_[0].height, [&](int y) {
            const float *row = trust + size_t(y % 2) * 2 * plane + size_t(y / 2) * width;
            HWY_DYNAMIC_DISPATCH(WeighRow)(level_[0], planes_, row, plane, y);
        });
    for (int l = 1; l < count_; ++l)
        for_rows(threads, level_[l].height,
                 [&](int y) { HWY_DYNAMIC_DISPATCH(HalveRow)(level_[l - 1], level_[l], planes_, y); });
}

void Pyramid::filter(Threads &threads, const PyramidLogits &logits, int l, const Rect &area, float *result,
                     float *known) {
    const Level &cells = level_[std::max(l, 1)]; // the finest level's logits lie in the cells of the next
    const size_t plane = size_t(cells.width) * cells.height;
    for_row_blocks(threads, area.y, area.y + area.height, [&](int begin, int end) {
        PyramidScratch scratch(planes_);
        for (int y = begin; y != end; ++y) {
            PyramidRow row;
            row.level = &level_[l];
            row.coarser = l + 1 < count_ ? &level_[l + 1] : nullptr;
            row.planes = planes_, row.y = y, row.begin = area.x, row.end = area.x + area.width;
            if (l == 0) {
                row.logits = logits.levels[0] + size_t(y % 2) * 2 * plane + size_t(y / 2) * cells.width;
                row.logit_stride = 4 * plane, row.phase_stride = plane;
                row.result = result + size_t(y - area.y) * area.width - area.x;
                row.result_stride = size_t(area.width) * area.height;
                row.known = known == nullptr ? nullptr : known + size_t(y - area.y) * area.width - area.x;
            } else {
                row.logits = logits.levels[l] + size_t(y) * cells.width;
                row.logit_stride = plane;
                row.result = level_[l].result_row(0, y);
                row.result_stride = level_[l].plane_stride();
                row.known = level_[l].result_row(planes_, y);
            }
            HWY_DYNAMIC_DISPATCH(FilterRow)(row, scratch);
        }
    });
}

void Pyramid::apply(Threads &threads, const PyramidLogits &logits, const Rect &core, float *result,
                    float *known) {
    weigh(threads, logits.trust);
    for (int l = count_ - 1; l > 0; --l)
        filter(threads, logits, l, {0, 0, level_[l].width, level_[l].height}, nullptr, nullptr);
    filter(threads, logits, 0, core, result, known);
}

} // namespace pathfold::core
#endif
