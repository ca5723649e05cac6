// The innermost loops of training on a CPU: a pyramid level's taps and their gradients, float32.
#include "taps.h"

#include <algorithm>

#include "parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "taps.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace pathfold::training {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<float>;
using V = hn::Vec<D>;

constexpr float limit = 10, shift = -5; // of logits, as bounded_exp in networks/reconstruct.py

/// `count` floats, fewer than a vector's at the end of a row.
V Read(const float *from, size_t count) {
    const D d;
    if (count == hn::Lanes(d))
        return hn::LoadU(d, from);
    HWY_ALIGN float part[hn::MaxLanes(d)] = {};
    std::copy_n(from, count, part);
    return hn::Load(d, part);
}

void Write(V value, float *to, size_t count) {
    const D d;
    if (count == hn::Lanes(d))
        return hn::StoreU(value, d, to);
    HWY_ALIGN float part[hn::MaxLanes(d)];
    hn::Store(value, d, part);
    std::copy_n(part, count, to);
}

V Weight(V logit) {
    const D d;
    return hn::Exp(d, hn::Add(hn::Clamp(logit, hn::Set(d, -limit), hn::Set(d, limit)), hn::Set(d, shift)));
}

/// One row of the sums.
void SumRow(const Taps &taps, size_t y, const float *logits, const float *source, float *sums) {
    const D d;
    const size_t lanes = hn::Lanes(d), width = taps.width, plane = taps.height * width, above = taps.plane();
    for (size_t x = 0; x < width; x += lanes) {
        const size_t count = std::min(lanes, width - x);
        V sum0 = hn::Zero(d), sum1 = sum0, sum2 = sum0, sum3 = sum0;
        for (size_t t = 0; t < taps.offsets.size(); ++t) {
            const V weight = Weight(Read(logits + t * plane + y * width + x, count));
            const float *value = source + y * taps.stride + x + taps.offsets[t];
            sum0 = hn::MulAdd(weight, Read(value, count), sum0);
            sum1 = hn::MulAdd(weight, Read(value + above, count), sum1);
            sum2 = hn::MulAdd(weight, Read(value + 2 * above, count), sum2);
            sum3 = hn::MulAdd(weight, Read(value + 3 * above, count), sum3);
        }
        float *to = sums + y * width + x;
        Write(sum0, to, count);
        Write(sum1, to + plane, count);
        Write(sum2, to + 2 * plane, count);
        Write(sum3, to + 3 * plane, count);
    }
}

void SpreadImage(const Taps &taps, const float *logits, const float *source, const float *gradient,
                 float *of_logits, float *of_source) {
    const D d;
    const size_t lanes = hn::Lanes(d), width = taps.width, plane = taps.height * width, above = taps.plane();
    for (size_t y = 0; y < taps.height; ++y)
        for (size_t t = 0; t < taps.offsets.size();
             ++t) // a row at a time: what was stored is read again later
            for (size_t x = 0; x < width; x += lanes) {
                const size_t count = std::min(lanes, width - x), here = y * width + x;
                const size_t there = y * taps.stride + x + taps.offsets[t];
                const V logit = Read(logits + t * plane + here, count), weight = Weight(logit);
                V slope = hn::Zero(d);
                for (size_t c = 0; c < Taps::planes; ++c) {
                    const V of_sum = Read(gradient + c * plane + here, count);
                    float *to = of_source + c * above + there;
                    slope = hn::MulAdd(of_sum, Read(source + c * above + there, count), slope);
                    Write(hn::MulAdd(weight, of_sum, Read(to, count)), to, count);
                }
                const auto inside = hn::Le(hn::Abs(logit), hn::Set(d, limit));
                Write(hn::IfThenElseZero(inside, hn::Mul(weight, slope)), of_logits + t * plane + here,
                      count);
            }
}

} // namespace HWY_NAMESPACE
} // namespace pathfold::training
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pathfold::training {

HWY_EXPORT(SumRow);
HWY_EXPORT(SpreadImage);

void sum_taps(const Taps &taps, int threads, const float *logits, const float *source, float *sums) {
    const size_t pixels = taps.height * taps.width, values = Taps::planes * taps.plane();
    core::Threads arena(std::max(threads, 1));
    core::for_rows(arena, int(taps.images * taps.height), [&](int row) {
        const size_t i = size_t(row) / taps.height, y = size_t(row) % taps.height;
        HWY_DYNAMIC_DISPATCH(SumRow)
        (taps, y, logits + taps.logit(i), source + i * values, sums + i * Taps::planes * pixels);
    });
}

void spread_taps(const Taps &taps, int threads, const float *logits, const float *source,
                 const float *gradient, float *of_logits, float *of_source) {
    const size_t pixels = taps.height * taps.width, values = Taps::planes * taps.plane();
    core::Threads arena(std::max(threads, 1));
    core::for_rows(arena, int(taps.images), [&](int image) { // rows of one add to the same values
        const size_t i = size_t(image);
        std::fill_n(of_source + i * values, values, 0.0f);
        HWY_DYNAMIC_DISPATCH(SpreadImage)
        (taps, logits + taps.logit(i), source + i * values, gradient + i * Taps::planes * pixels,
         of_logits + taps.logit(i), of_source + i * values);
    });
}

} // namespace pathfold::training
#endif
