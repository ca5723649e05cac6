#include "demodulation.h"

#include <cmath>
#include <functional>
#include <random>
#include <vector>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr int height = 70, width = 150; // more than a strip of cells in a smaller frame, and cut cells
constexpr float epsilon = 0.01f;

Planes filled(float value, int channels = 3) {
    Planes planes(channels, height, width);
    std::fill_n(planes.row(0, 0), size_t(channels) * height * width, value);
    return planes;
}

/// Squares of `side` pixels, from 0.05 to 0.95.
Planes texture(int side, unsigned seed = 1) {
    Planes planes(3, height, width);
    std::mt19937 numbers(seed);
    std::vector<float> tones(size_t(height) * width);
    for (float &tone : tones)
        tone = 0.05f + 0.9f * float(numbers()) / float(numbers.max());
    for (int c = 0; c < 3; ++c)
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x)
                planes.row(c, y)[x] = tones[size_t(c * 7 + y / side) * 151 % 9973 + size_t(x / side)];
    return planes;
}

Planes map(const Planes &planes, const std::function<float(float, int)> &change) {
    Planes result = planes;
    for (int i = 0; i < 3 * height * width; ++i)
        result.row(0, 0)[i] = change(planes.row(0, 0)[i], i);
    return result;
}

struct Demodulation : testing::Test {
    Threads threads{2};
    std::vector<uint8_t> valid = std::vector<uint8_t>(size_t(height) * width, 1);
    std::mt19937 numbers{3};

    Doubts find(const Planes &albedo, const Planes &radiance) {
        return find_doubts(map(albedo, [](float a, int) { return a + epsilon; }), radiance, valid, threads);
    }
    /// The mean share over the cells.
    double mean_share(const Planes &albedo, const Planes &radiance) {
        const Doubts doubts = find(albedo, radiance);
        const int count = doubts.share.height() * doubts.share.width();
        double sum = 0;
        for (int i = 0; i < count; ++i)
            sum += doubts.share.row(0, 0)[i];
        return sum / count;
    }
    /// One sample of light of which so large a part finds none.
    float noise(double dark) {
        return std::uniform_real_distribution<>()(numbers) < dark ? 0.0f : float(1 / (1 - dark));
    }
};

TEST_F(Demodulation, AnAlbedoThatExplainsTheLightIsLeftAlone) {
    for (int side : {1, 3, 12})
        for (double dark : {0.0, 0.5, 0.95}) {
            const Planes albedo = texture(side);
            const Planes light = map(albedo, [&](float a, int) { return 3 * a * noise(dark); });
            EXPECT_LT(mean_share(albedo, light), 0.01) << side << " " << dark;
        }
}

TEST_F(Demodulation, AFlatAlbedoIsLeftAloneToTheBit) {
    for (float value : {0.0f, 0.3f, 1.0f}) {
        const Planes albedo = filled(value);
        const Planes light = map(albedo, [&](float, int) { return noise(0.8); });
        EXPECT_FALSE(find(albedo, light).any()) << value;
        EXPECT_FALSE(find(albedo, filled(0)).any()) << "black";
    }
}

TEST_F(Demodulation, LightThatDoesNotFollowIsNotDivided) {
    for (int side : {1, 2}) { // larger squares leave a window few of them
        const Planes albedo = texture(side);
        Planes flat = albedo;
        const Doubts doubts = find(albedo, filled(2));
        const int64_t pixels = flatten(flat, doubts, epsilon, threads);
        EXPECT_GT(pixels, int64_t(height) * width * 9 / 10) << side;
        double before = 0, after = 0;
        for (int y = 0; y < height; ++y)
            for (int x = 1; x < width; ++x) {
                before += std::abs(albedo.row(0, y)[x] - albedo.row(0, y)[x - 1]);
                after += std::abs(flat.row(0, y)[x] - flat.row(0, y)[x - 1]);
            }
        EXPECT_LT(after, 0.3 * before) << side;
        EXPECT_GT(mean_share(albedo, texture(side, 2)), 0.15) << "of another picture";
    }
}

TEST_F(Demodulation, OnlyTheNeighbourhoodIsChanged) {
    const Planes albedo = texture(2);
    Planes light = map(albedo, [](float a, int) { return a; }), flat = albedo;
    for (int c = 0; c < 3; ++c)
        for (int y = 0; y < height; ++y)
            std::fill_n(light.row(c, y), width / 3, 0.5f);
    flatten(flat, find(albedo, light), epsilon, threads);
    for (int y = 0; y < height; ++y)
        for (int x = width / 3 + 24; x < width; ++x)
            EXPECT_EQ(flat.row(1, y)[x], albedo.row(1, y)[x]) << x << " " << y;
}

TEST_F(Demodulation, ScaleDoesNotMatterAndResultsStayInRange) {
    const Planes albedo = texture(1);
    const Planes light = map(albedo, [&](float, int) { return noise(0.3); });
    const double share = mean_share(albedo, light);
    for (float scale : {0x1p-120f, 0x1p100f}) {
        const Planes scaled = map(light, [&](float l, int) { return l * scale; });
        EXPECT_NEAR(mean_share(albedo, scaled), share, 1e-6);
        Planes flat = albedo;
        flatten(flat, find(albedo, scaled), epsilon, threads);
        for (int i = 0; i < 3 * height * width; ++i)
            EXPECT_TRUE(flat.row(0, 0)[i] >= 0 && flat.row(0, 0)[i] <= 1);
    }
}

TEST_F(Demodulation, WhatIsNotValidDoesNotCount) {
    const Planes albedo = texture(2);
    Planes light = map(albedo, [](float a, int) { return a; });
    for (int y = 0; y < height; y += 3)
        for (int x = 0; x < width; ++x) {
            valid[size_t(y) * width + x] = 0;
            light.row(0, y)[x] = 100;
        }
    EXPECT_LT(mean_share(albedo, light), 0.01);
    valid.assign(valid.size(), 0);
    EXPECT_FALSE(find(albedo, light).any());
}

} // namespace
} // namespace pathfold::core
