#include "reconstruct.h"

#include <cmath>
#include <limits>
#include <numeric>

#include <oneapi/tbb/global_control.h>

#include "naive.h"
#include "testing.h"

namespace pathfold::core {
namespace {

Pixels gather_pixels(const Pixels &image, const std::vector<float> &logits, int size) {
    Pixels result(image.height, image.width, image.channels);
    const pathfold_image in = image.image(), out = result.image();
    EXPECT_EQ(pathfold_gather(&in, logits.data(), size, &out), PATHFOLD_OK) << pathfold_last_error();
    return result;
}

std::vector<float> random_logits(int taps, int pixels, float spread, unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<float> draw(0, spread);
    std::vector<float> logits(size_t(taps) * pixels);
    for (float &logit : logits)
        logit = draw(random);
    return logits;
}

} // namespace

TEST(Gather, EqualsNaive) {
    for (int size : {1, 3, 5, 21})
        for (auto [height, width] : {std::pair(1, 1), {1, 40}, {37, 3}, {23, 35}})
            for (int channels : {1, 3, 4, 7}) {
                const Pixels image = noise(height, width, channels, 1);
                const std::vector<float> logits = random_logits(size * size, height * width, 3, 2);
                expect_near(gather_pixels(image, logits, size), naive_gather(image, logits, size), 2e-6);
            }
}

TEST(Gather, MaskedPixelsAreNoTaps) {
    Pixels image = noise(20, 30, 3, 3);
    image.at(4, 5, 1) = std::numeric_limits<float>::quiet_NaN();
    image.at(0, 0, 0) = std::numeric_limits<float>::infinity();
    for (int x = 10; x < 20; ++x)
        image.at(12, x, 2) = -std::numeric_limits<float>::infinity();
    const std::vector<float> logits = random_logits(25, 600, 3, 4);
    expect_near(gather_pixels(image, logits, 5), naive_gather(image, logits, 5), 2e-6);
}

TEST(Gather, NoValidTapGivesZero) {
    Pixels image(9, 9, 3, std::numeric_limits<float>::quiet_NaN());
    image.at(8, 8, 0) = image.at(8, 8, 1) = image.at(8, 8, 2) = 5;
    const Pixels result = gather_pixels(image, random_logits(9, 81, 1, 5), 3);
    EXPECT_EQ(result.at(0, 0, 0), 0.0f);
    EXPECT_EQ(result.at(7, 7, 0), 5.0f);
}

TEST(Gather, SaturatedLogits) {
    const Pixels image = noise(16, 33, 3, 6, 1e6f);
    const std::vector<float> logits = random_logits(49, 16 * 33, 1e4f, 7);
    expect_near(gather_pixels(image, logits, 7), naive_gather(image, logits, 7), 2e-6);
}

TEST(Gather, LogitsOfNaNAreNotHidden) {
    std::vector<float> logits(9 * 64, 0.0f);
    for (int tap = 0; tap < 9; ++tap)
        logits[size_t(tap) * 64 + 20] = std::numeric_limits<float>::quiet_NaN();
    const Pixels result = gather_pixels(Pixels(8, 8, 1, 2), logits, 3);
    EXPECT_TRUE(std::isnan(result.values[20]));
    EXPECT_EQ(result.values[21], 2.0f);
}

TEST(Gather, AMaskedLargestLogitDoesNotCount) {
    Pixels image(3, 3, 1, 2);
    image.at(1, 1, 0) = std::numeric_limits<float>::quiet_NaN();
    std::vector<float> logits(81, 0.0f);
    for (int tap = 0; tap < 9; ++tap)
        for (int i = 0; i < 9; ++i)
            logits[size_t(tap) * 9 + i] = tap == 4 ? 1e4f : -1e4f;
    EXPECT_EQ(gather_pixels(image, logits, 3).at(1, 1, 0), 2.0f);
}

TEST(Gather, StaysBetweenLeastAndLargestOfTheWindow) {
    const Pixels image = noise(24, 40, 3, 8, 1e8f);
    const Pixels result = gather_pixels(image, random_logits(49, 24 * 40, 8, 9), 7);
    for (int y = 0; y < 24; ++y)
        for (int x = 0; x < 40; ++x)
            for (int c = 0; c < 3; ++c) {
                float least = std::numeric_limits<float>::max(), most = 0;
                for (int v = std::max(0, y - 3); v <= std::min(23, y + 3); ++v)
                    for (int u = std::max(0, x - 3); u <= std::min(39, x + 3); ++u) {
                        least = std::min(least, image.at(v, u, c));
                        most = std::max(most, image.at(v, u, c));
                    }
                EXPECT_GE(result.at(y, x, c), least * (1 - 1e-5f));
                EXPECT_LE(result.at(y, x, c), most * (1 + 1e-5f));
            }
}

// Constants come out as they are: leaving constant tiles out relies on it.
TEST(Gather, ConstantsAreKept) {
    const std::vector<float> logits = random_logits(441, 30 * 30, 5, 10);
    for (float value : {0.0f, 1.0f, 3.7e-12f, 8.1e20f}) {
        const Pixels result = gather_pixels(Pixels(30, 30, 2, value), logits, 21);
        for (float kept : result.values)
            EXPECT_NEAR(kept, value, 3e-6 * value);
    }
}

TEST(Gather, ThreadsDoNotMatter) {
    const Pixels image = noise(50, 61, 3, 11);
    const std::vector<float> logits = random_logits(81, 50 * 61, 3, 12);
    const Pixels all = gather_pixels(image, logits, 9);
    const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
    EXPECT_EQ(gather_pixels(image, logits, 9).values, all.values);
}

// Sizes, magnitudes, masks and logits at random: within the window's least and largest value, as naive.
TEST(Gather, RandomCases) {
    for (unsigned seed = 0; seed < 60; ++seed) {
        SCOPED_TRACE(testing::Message() << "seed " << seed);
        std::mt19937 random(seed);
        const auto draw = [&](int least, int most) {
            return std::uniform_int_distribution<int>(least, most)(random);
        };
        const int size = 2 * draw(0, 4) + 1, height = draw(1, 20), width = draw(1, 70);
        Pixels image = noise(height, width, draw(1, 5), seed, std::ldexp(1.0f, draw(-60, 60)));
        for (int masked = draw(0, height * width); masked > 0; --masked)
            image.at(draw(0, height - 1), draw(0, width - 1), 0) = std::numeric_limits<float>::quiet_NaN();
        const float spread = std::pow(10.0f, float(draw(-2, 4)));
        const auto logits = random_logits(size * size, height * width, spread, seed);
        const Pixels result = gather_pixels(image, logits, size);
        expect_near(result, naive_gather(image, logits, size), 2e-6);
        const float most =
            std::accumulate(image.values.begin(), image.values.end(), 0.0f,
                            [](float a, float b) { return std::isfinite(b) ? std::max(a, b) : a; });
        for (float value : result.values)
            ASSERT_TRUE(value >= 0 && value <= most * (1 + 1e-5f));
    }
}

} // namespace pathfold::core
