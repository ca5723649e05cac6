#include "half.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "testing.h"

namespace pathfold::core {
namespace {

/// By the definition of binary16.
float naive_float(uint16_t half) {
    const int exponent = half >> 10 & 31, mantissa = half & 1023;
    const float sign = half >> 15 ? -1.0f : 1.0f;
    if (exponent == 31)
        return mantissa != 0 ? std::numeric_limits<float>::quiet_NaN()
                             : sign * std::numeric_limits<float>::infinity();
    if (exponent == 0)
        return sign * std::ldexp(float(mantissa), -24);
    return sign * std::ldexp(float(1024 + mantissa), exponent - 25);
}

std::vector<uint16_t> halves_of(const std::vector<float> &floats) {
    std::vector<uint16_t> halves(floats.size());
    float_to_half(floats.data(), floats.size(), halves.data());
    return halves;
}

} // namespace

TEST(Half, EveryHalfIsReadAndComesBack) {
    std::vector<uint16_t> halves(1 << 16);
    for (size_t i = 0; i < halves.size(); ++i)
        halves[i] = uint16_t(i);
    std::vector<float> floats(halves.size());
    half_to_float(halves.data(), halves.size(), floats.data());
    const std::vector<uint16_t> back = halves_of(floats);
    for (size_t i = 0; i < halves.size(); ++i) {
        const float right = naive_float(halves[i]);
        if (std::isnan(right)) {
            EXPECT_TRUE(std::isnan(floats[i])) << i;
            continue;
        }
        EXPECT_EQ(std::memcmp(&floats[i], &right, sizeof right), 0) << i; // 0 and -0 too
        if (std::isfinite(right)) {
            EXPECT_EQ(back[i], halves[i]) << i;
        }
    }
}

TEST(Half, TheNearestIsTakenAndTheLargestKept) {
    EXPECT_EQ(halves_of({1.0f + 0x1p-12f, 1.0f + 0x1.8p-11f, 1.0f + 0x1p-11f, 1.0f + 0x1.8p-10f}),
              (std::vector<uint16_t>{0x3c00, 0x3c01, 0x3c00, 0x3c02})); // ties to even
    EXPECT_EQ(halves_of({1e9f, -1e9f, 65504.0f, 65519.0f}),
              (std::vector<uint16_t>{0x7bff, 0xfbff, 0x7bff, 0x7bff}));
}

TEST(Half, AnyCountAtAnyPlace) {
    std::vector<float> floats(41);
    for (size_t i = 0; i < floats.size(); ++i)
        floats[i] = float(i) - 20.5f;
    for (size_t first = 0; first < 4; ++first)
        for (size_t count = 0; first + count <= floats.size(); ++count) {
            std::vector<uint16_t> halves(floats.size() + 1, 0x1234);
            float_to_half(floats.data() + first, count, halves.data() + first);
            std::vector<float> back(floats.size() + 1, 7);
            half_to_float(halves.data() + first, count, back.data() + first);
            for (size_t i = 0; i < floats.size(); ++i) {
                const bool inside = i >= first && i < first + count;
                ASSERT_EQ(back[i], inside ? floats[i] : 7.0f);
                ASSERT_TRUE(inside || halves[i] == 0x1234);
            }
        }
}

} // namespace pathfold::core
