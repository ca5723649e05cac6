#include "half.h"

#include <algorithm>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "half.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace pathfold::core {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void HalfToFloat(const uint16_t *halves, size_t count, float *floats) {
    const hn::ScalableTag<float> d;
    const hn::Rebind<hwy::float16_t, decltype(d)> dh;
    const size_t lanes = hn::Lanes(d);
    const auto *in = reinterpret_cast<const hwy::float16_t *>(halves);
    size_t i = 0;
    for (; i + lanes <= count; i += lanes)
        hn::StoreU(hn::PromoteTo(d, hn::LoadU(dh, in + i)), d, floats + i);
    if (i == count)
        return;
    HWY_ALIGN hwy::float16_t rest[hn::MaxLanes(dh)] = {};
    HWY_ALIGN float out[hn::MaxLanes(d)];
    std::memcpy(static_cast<void *>(rest), in + i, (count - i) * sizeof(*in));
    hn::Store(hn::PromoteTo(d, hn::Load(dh, rest)), d, out);
    std::copy_n(out, count - i, floats + i);
}

void FloatToHalf(const float *floats, size_t count, uint16_t *halves) {
    const hn::ScalableTag<float> d;
    const hn::Rebind<hwy::float16_t, decltype(d)> dh;
    const size_t lanes = hn::Lanes(d);
    const auto most = hn::Set(d, 65504.0f), least = hn::Set(d, -65504.0f);
    HWY_ALIGN float in[hn::MaxLanes(d)] = {};
    HWY_ALIGN hwy::float16_t out[hn::MaxLanes(dh)];
    for (size_t i = 0; i < count; i += lanes) {
        const size_t n = std::min(lanes, count - i);
        std::copy_n(floats + i, n, in);
        hn::Store(hn::DemoteTo(dh, hn::Clamp(hn::Load(d, in), least, most)), dh, out);
        std::memcpy(halves + i, out, n * sizeof(*out));
    }
}

} // namespace HWY_NAMESPACE
} // namespace pathfold::core
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pathfold::core {

HWY_EXPORT(HalfToFloat);
HWY_EXPORT(FloatToHalf);

void half_to_float(const uint16_t *halves, size_t count, float *floats) {
    HWY_DYNAMIC_DISPATCH(HalfToFloat)(halves, count, floats);
}

void float_to_half(const float *floats, size_t count, uint16_t *halves) {
    HWY_DYNAMIC_DISPATCH(FloatToHalf)(floats, count, halves);
}

} // namespace pathfold::core
#endif
