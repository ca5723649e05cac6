#include "descriptor.h"

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr float dead = PATHFOLD_DEAD_LOG;
constexpr float nan = std::numeric_limits<float>::quiet_NaN();

/// Diffuse, glass, a light sample at something unknown.
std::vector<pathfold_vertex> three() {
    return {{{0.5f, 0.25f, 0}, PATHFOLD_KIND_DIFFUSE_REFLECTION, 1, 0.3f},
            {{1, 1, 1}, PATHFOLD_KIND_DELTA_TRANSMISSION, 0, 0.9f},
            {{2, 1e-35f, 1}, PATHFOLD_KIND_GENERIC, 0.4f, 4}};
}

pathfold_path path_of(const std::vector<pathfold_vertex> &vertices, std::array<float, 3> light) {
    return {{light[0], light[1], light[2]}, int32_t(vertices.size()), vertices.data()};
}

std::vector<float> described(const pathfold_path &path, int vertices, float *density = nullptr) {
    std::vector<float> channels(size_t(pathfold_descriptor_layout(vertices).channels), 7.0f);
    describe_path(path, vertices, channels.data(), density);
    return channels;
}

} // namespace

TEST(Descriptor, LayoutsFollowEachOther) {
    for (int vertices = 1; vertices <= PATHFOLD_MAX_VERTICES; ++vertices) {
        const pathfold_layout layout = pathfold_descriptor_layout(vertices);
        EXPECT_EQ(layout.light, layout.radiance + 3);
        EXPECT_EQ(layout.attenuation, layout.light + 3);
        EXPECT_EQ(layout.kind, layout.attenuation + 3 * vertices);
        EXPECT_EQ(layout.roughness, layout.kind + vertices);
        EXPECT_EQ(layout.channels, layout.roughness + vertices);
        EXPECT_EQ(pathfold_descriptor_vertices(layout.channels), vertices);
    }
    for (int64_t channels : {-4, 0, 6, 10, 12, 35, 37, 41})
        EXPECT_EQ(pathfold_descriptor_vertices(channels), 0) << channels;
}

TEST(Descriptor, APathIsFilledIn) {
    const std::vector<pathfold_vertex> vertices = three();
    float density = 0;
    const std::vector<float> channels = described(path_of(vertices, {8, 3, 5}), 6, &density);
    const pathfold_layout at = pathfold_descriptor_layout(6);
    const auto log_of = [](double value) { return float(std::log(value)); };
    EXPECT_NEAR(channels[at.radiance], log_of(8 * 0.5 * 2), 1e-5);
    EXPECT_EQ(channels[at.radiance + 1], log_of(1e-30f)); // too little for more
    EXPECT_EQ(channels[at.radiance + 2], dead);           // a vertex lets no blue through
    EXPECT_NEAR(channels[at.light + 1], log_of(3), 1e-6);
    EXPECT_NEAR(channels[at.attenuation + 1], log_of(0.25), 1e-6);
    EXPECT_EQ(channels[at.attenuation + 2], dead);
    EXPECT_EQ(channels[at.attenuation + 7], log_of(1e-30f));
    const std::vector<float> kinds(channels.begin() + at.kind, channels.begin() + at.roughness);
    EXPECT_EQ(kinds, (std::vector<float>{5, 18, 3, 0, 0, 0}));
    const std::vector<float> roughness(channels.begin() + at.roughness, channels.end());
    EXPECT_EQ(roughness, (std::vector<float>{1, 0, 0.4f, 0, 0, 0}));
    for (int i = at.attenuation + 9; i < at.kind; ++i)
        EXPECT_EQ(channels[i], dead);
    EXPECT_NEAR(density, log_of(0.3 * 0.9 * 4), 1e-5);
}

TEST(Descriptor, LaterVerticesAreLeftOut) {
    const std::vector<pathfold_vertex> vertices = three(), first(vertices.begin(), vertices.begin() + 2);
    float all = 0, some = 0;
    EXPECT_EQ(described(path_of(vertices, {8, 3, 5}), 2, &all),
              described(path_of(first, {8, 3, 5}), 2, &some));
    EXPECT_EQ(all, some);
}

TEST(Descriptor, NothingIsKnownOfAnEmptyPath) {
    std::vector<float> channels = described(path_of({}, {0, 0, 0}), 6), cleared(channels.size(), 7.0f);
    clear_descriptor(cleared.data());
    EXPECT_EQ(channels, cleared);
    EXPECT_EQ(channels[0], dead);
    EXPECT_EQ(channels[24], 0);
}

TEST(Descriptor, WhatIsNotFiniteStaysSo) {
    std::vector<pathfold_vertex> vertices = three();
    vertices[1].attenuation[0] = nan;
    EXPECT_TRUE(std::isnan(described(path_of(vertices, {8, 3, 5}), 6)[9]));
    vertices = three();
    vertices[0].attenuation[0] = -1;
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { described(path_of(vertices, {1, 1, 1}), 6); }, "attenuation is -1");
    vertices[0] = vertices[1];
    vertices[0].kind = 4;
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { described(path_of(vertices, {1, 1, 1}), 6); }, "kind is 4");
    vertices[0].kind = PATHFOLD_KIND_NONE;
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { described(path_of(vertices, {1, 1, 1}), 6); }, "kind is 0");
    vertices[0] = vertices[1];
    for (float roughness : {-1.0f, 7.0f}) {
        vertices[0].roughness = roughness;
        expect_error(
            PATHFOLD_INVALID_ARGUMENT, [&] { described(path_of(vertices, {1, 1, 1}), 6); }, "roughness is");
    }
    vertices[0] = vertices[1];
    vertices[0].density = -2;
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { described(path_of(vertices, {1, 1, 1}), 6); }, "density is -2");
    float channels[64];
    for (int count : {-1, 0, 7, std::numeric_limits<int>::max()})
        expect_error(
            PATHFOLD_INVALID_ARGUMENT,
            [&] { describe_path(path_of({}, {1, 1, 1}), count, channels, nullptr); }, "vertices is");
}

TEST(Descriptor, FewerVerticesAreSpread) {
    const std::vector<pathfold_vertex> vertices = three();
    const std::vector<float> right = described(path_of(vertices, {8, 3, 5}), 6);
    std::vector<float> both = described(path_of(vertices, {8, 3, 5}), 3);
    const std::vector<float> once = both;
    both.insert(both.end(), once.begin(), once.end());
    both.resize(2 * right.size());
    add_vertices(both.data(), 2, 3);
    EXPECT_TRUE(std::equal(right.begin(), right.end(), both.begin()));
    EXPECT_TRUE(std::equal(right.begin(), right.end(), both.begin() + right.size()));
}

} // namespace pathfold::core
