#include "pyramid.h"

#include <cmath>
#include <limits>
#include <random>

#include "testing.h"

namespace pathfold::core {
namespace {

struct Prediction {
    int height, width; // rounded up
    std::vector<float> trust;
    std::array<std::vector<float>, 5> levels;

    Prediction(int h, int w, float spread, unsigned seed)
        : height(Pyramid::rounded_up(h)), width(Pyramid::rounded_up(w)) {
        std::mt19937 random(seed);
        std::normal_distribution<float> draw(0, spread);
        std::uniform_real_distribution<float> draw_trust(-9, 0);
        const size_t pixels = size_t(height) * width;
        trust.resize(pixels + pyramid_slack);
        for (float &value : trust)
            value = draw_trust(random);
        for (int l = 0; l < 5; ++l) {
            levels[l].resize((pixels >> (2 * l)) * (l < 4 ? 30 : 25) + pyramid_slack);
            for (float &value : levels[l])
                value = draw(random);
        }
    }
    PyramidLogits logits() const {
        return {trust.data(),
                {levels[0].data(), levels[1].data(), levels[2].data(), levels[3].data(), levels[4].data()}};
    }
    double trust_at(int y, int x) const {
        const size_t cell = size_t(y / 2) * (width / 2) + x / 2;
        const double t = trust[size_t(y % 2 * 2 + x % 2) * (size_t(height) * width / 4) + cell];
        return std::exp(std::clamp(t, -9.0, 0.0));
    }
    double logit(int l, int c, int y, int x) const {
        size_t at = (size_t(c) * (height >> l) + y) * (width >> l) + x;
        if (l == 0)
            at = (size_t(4 * c + y % 2 * 2 + x % 2) * (height / 2) + y / 2) * (width / 2) + x / 2;
        return std::clamp<double>(levels[l][at], -10, 10);
    }
};

/// One plane of doubles, 0 outside.
struct Plane {
    int height, width;
    std::vector<double> values;
    Plane(int h, int w) : height(h), width(w), values(size_t(h) * w) {}
    double &at(int y, int x) { return values[size_t(y) * width + x]; }
    double get(int y, int x) const {
        return y < 0 || x < 0 || y >= height || x >= width ? 0 : values[size_t(y) * width + x];
    }
};

/// The formulas in the header, pixel by pixel; 0 where nothing is known. NaN is not valid.
std::vector<double> naive(const Prediction &prediction, const Pixels &image, int channel, int levels = 5) {
    std::vector<Plane> numbers, weights;
    numbers.emplace_back(prediction.height, prediction.width);
    weights.emplace_back(prediction.height, prediction.width);
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x)
            if (const float value = image.at(y, x, channel); std::isfinite(value)) {
                weights[0].at(y, x) = prediction.trust_at(y, x);
                numbers[0].at(y, x) = prediction.trust_at(y, x) * value;
            }
    for (int l = 1; l < levels; ++l)
        for (auto *maps : {&numbers, &weights}) {
            Plane half(prediction.height >> l, prediction.width >> l);
            for (int y = 0; y < half.height; ++y)
                for (int x = 0; x < half.width; ++x)
                    half.at(y, x) =
                        (maps->back().get(2 * y, 2 * x) + maps->back().get(2 * y, 2 * x + 1) +
                         maps->back().get(2 * y + 1, 2 * x) + maps->back().get(2 * y + 1, 2 * x + 1)) /
                        4;
            maps->push_back(half);
        }
    Plane result(0, 0), known(0, 0);
    for (int l = levels - 1; l >= 0; --l) {
        Plane out(prediction.height >> l, prediction.width >> l), out_known = out;
        for (int y = 0; y < out.height; ++y)
            for (int x = 0; x < out.width; ++x) {
                double top = 0, bottom = 0, coarse_top = 0, coarse_bottom = 0, share = 0;
                for (int tap = 0; tap < 25; ++tap) {
                    const double k = std::exp(prediction.logit(l, tap, y, x));
                    top += k * numbers[l].get(y + tap / 5 - 2, x + tap % 5 - 2);
                    bottom += k * weights[l].get(y + tap / 5 - 2, x + tap % 5 - 2);
                }
                for (int j = 0; j < 4 && l < levels - 1; ++j) {
                    const int v = (y + 1) / 2 - 1 + j / 2, u = (x + 1) / 2 - 1 + j % 2;
                    const double k = std::exp(prediction.logit(l, 25 + j, y, x)) * known.get(v, u);
                    coarse_top += k * result.get(v, u);
                    coarse_bottom += k;
                }
                if (l < levels - 1)
                    share = 1 / (1 + std::exp(-prediction.logit(l, 29, y, x)));
                const double own = bottom > 0 ? 1 - share : 0, coarse = coarse_bottom > 0 ? share : 0;
                if (own + coarse == 0)
                    continue;
                out_known.at(y, x) = 1;
                out.at(y, x) = ((own > 0 ? own * top / bottom : 0) +
                                (coarse > 0 ? coarse * coarse_top / coarse_bottom : 0)) /
                               (own + coarse);
            }
        result = out, known = out_known;
    }
    return result.values;
}

/// With `known` the result has a channel more.
Pixels filtered(const Prediction &prediction, const Pixels &image, Rect core = {}, int levels = 5,
                bool known = false) {
    if (core.width == 0)
        core = {0, 0, image.width, image.height};
    Pyramid pyramid;
    Threads threads;
    pyramid.reset(image.channels, image.height, image.width, levels);
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x) {
            bool valid = true;
            for (int c = 0; c < image.channels; ++c)
                valid = valid && std::isfinite(image.at(y, x, c));
            for (int c = 0; c < image.channels && valid; ++c)
                pyramid.row(c, y)[x] = image.at(y, x, c);
            pyramid.valid_row(y)[x] = valid;
        }
    const int channels = image.channels + (known ? 1 : 0);
    std::vector<float> planar(size_t(core.height) * core.width * channels);
    pyramid.apply(threads, prediction.logits(), core, planar.data(),
                  known ? planar.data() + size_t(core.height) * core.width * image.channels : nullptr);
    Pixels result(core.height, core.width, channels);
    for (int c = 0; c < channels; ++c)
        for (int y = 0; y < core.height; ++y)
            for (int x = 0; x < core.width; ++x)
                result.at(y, x, c) = planar[(size_t(c) * core.height + y) * core.width + x];
    return result;
}

void expect_naive(const Prediction &prediction, const Pixels &image) {
    const Pixels result = filtered(prediction, image);
    for (int c = 0; c < image.channels; ++c) {
        const std::vector<double> right = naive(prediction, image, c);
        for (int y = 0; y < image.height; ++y)
            for (int x = 0; x < image.width; ++x) {
                const double value = right[size_t(y) * prediction.width + x];
                ASSERT_NEAR(result.at(y, x, c), value, 1e-5 * std::abs(value))
                    << image.height << "x" << image.width << ": " << y << ", " << x << ", " << c;
            }
    }
}

} // namespace

TEST(Pyramid, EqualsNaive) {
    for (auto [height, width] : {std::pair(1, 1), {1, 40}, {37, 3}, {64, 48}, {50, 150}})
        for (int channels : {1, 3, 4, 7})
            expect_naive(Prediction(height, width, 3, 1), noise(height, width, channels, 2));
}

TEST(Pyramid, SaturatedLogits) { expect_naive(Prediction(40, 70, 1e4f, 3), noise(40, 70, 3, 4, 1e6f)); }

TEST(Pyramid, BadPixelsAreNoTaps) {
    Pixels image = noise(48, 80, 1, 5);
    for (int y = 4; y < 30; ++y)
        for (int x = 10; x < 44; ++x)
            image.at(y, x, 0) = std::numeric_limits<float>::quiet_NaN();
    expect_naive(Prediction(48, 80, 2, 6), image);
    const Pixels nothing(20, 20, 3, std::numeric_limits<float>::quiet_NaN());
    for (float value : filtered(Prediction(20, 20, 2, 7), nothing).values)
        EXPECT_EQ(value, 0.0f);
}

TEST(Pyramid, ConstantsAreKeptAcrossAllMagnitudes) {
    for (float value :
         {0.0f, 1e-30f, 3.7f, 1e34f}) // 1e32 is the largest radiance, divided by an albedo of 0.01
        for (float kept : filtered(Prediction(33, 49, 1e3f, 8), Pixels(33, 49, 3, value)).values)
            EXPECT_NEAR(kept, value, 3e-6 * value);
}

TEST(Pyramid, OfThreeLevelsWithWhatIsKnown) {
    Pixels image = noise(41, 90, 3, 13);
    for (int y = 0; y < 36; ++y)
        for (int x = 20; x < 80; ++x)
            image.at(y, x, 0) = image.at(y, x, 1) = image.at(y, x, 2) =
                std::numeric_limits<float>::quiet_NaN();
    const Prediction prediction(41, 90, 3, 14);
    const Rect core{16, 0, 70, 41};
    const Pixels result = filtered(prediction, image, core, 3, true);
    int unknown = 0;
    for (int c = 0; c < 3; ++c) {
        const std::vector<double> right = naive(prediction, image, c, 3);
        for (int y = 0; y < core.height; ++y)
            for (int x = 0; x < core.width; ++x) {
                const double value = right[size_t(y) * prediction.width + core.x + x];
                ASSERT_NEAR(result.at(y, x, c), value, 1e-5 * value) << y << ", " << x << ", " << c;
                EXPECT_EQ(result.at(y, x, 3), value > 0 ? 1.0f : 0.0f) << y << ", " << x;
                unknown += value == 0;
            }
    }
    EXPECT_GT(unknown, 0);
}

TEST(Pyramid, StaysBetweenLeastAndLargest) {
    const Pixels image = noise(64, 64, 1, 9, 1e8f);
    const auto [least, most] = std::minmax_element(image.values.begin(), image.values.end());
    for (float value : filtered(Prediction(64, 64, 5, 10), image).values) {
        EXPECT_GE(value, *least * (1 - 1e-5f));
        EXPECT_LE(value, *most * (1 + 1e-5f));
    }
}

TEST(Pyramid, APartIsThatPartOfTheWhole) {
    const Pixels image = noise(90, 130, 3, 11);
    const Prediction prediction(90, 130, 3, 12);
    const Pixels whole = filtered(prediction, image), part = filtered(prediction, image, {32, 16, 77, 50});
    for (int y = 0; y < 50; ++y)
        for (int x = 0; x < 77; ++x)
            for (int c = 0; c < 3; ++c)
                EXPECT_EQ(part.at(y, x, c), whole.at(y + 16, x + 32, c));
}

} // namespace pathfold::core
