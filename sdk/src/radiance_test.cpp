#include "radiance.h"

#include <cmath>
#include <limits>

#include "naive.h"
#include "scene.h"
#include "testing.h"

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();

Planes load(const Pixels &pixels, Threads &threads) {
    return load_radiance(ImageView(pixels.image(), "color"), threads);
}

struct Sanitised {
    Planes radiance;
    std::vector<uint8_t> valid;
    Mended mended;

    explicit Sanitised(const Pixels &pixels) : valid(size_t(pixels.height) * pixels.width, 1) {
        Threads threads;
        radiance = load(pixels, threads);
        sanitise_radiance(radiance, "color", valid, threads, mended);
    }
    std::vector<float> at(int y, int x) const {
        return {radiance.row(0, y)[x], radiance.row(1, y)[x], radiance.row(2, y)[x]};
    }
};

void set(Pixels &pixels, int y, int x, const std::vector<float> &values) {
    std::copy(values.begin(), values.end(), &pixels.at(y, x, 0));
}

using Values = std::vector<float>;

} // namespace

TEST(Radiance, ColoursOutsideOfTheGamutKeepTheirSign) {
    Pixels pixels = noise(8, 9, 3, 1);
    const Values green = {-0.6218f, 1.1408f, -0.1290f}, cyan = {-0.617f, 0.614f, 0.222f}; // AP1's; 500 nm
    set(pixels, 2, 3, green);
    set(pixels, 4, 5, cyan);
    const Sanitised sanitised(pixels);
    EXPECT_EQ(sanitised.at(2, 3), green);
    EXPECT_EQ(sanitised.at(4, 5), cyan);
    EXPECT_TRUE(sanitised.mended.empty());
}

TEST(Radiance, NegativeLightIsNone) {
    Pixels pixels = noise(8, 9, 3, 1);
    set(pixels, 1, 1, {-1e30f, 0.5f, 0.25f});
    set(pixels, 2, 2, {-1, -2, -3});
    set(pixels, 3, 3, {-0.5f, -1e9f, 1});
    const Sanitised sanitised(pixels);
    EXPECT_EQ(sanitised.at(1, 1), (Values{0, 0.5f, 0.25f}));
    EXPECT_EQ(sanitised.at(2, 2), (Values{0, 0, 0}));
    EXPECT_EQ(sanitised.at(3, 3), (Values{-0.5f, 0, 1}));
    EXPECT_EQ(sanitised.mended, (Mended{{"color", {{fault::negative, 3}}}}));
}

TEST(Radiance, WhatIsNotFiniteIsMasked) {
    Pixels pixels = noise(8, 9, 3, 1);
    pixels.at(1, 1, 0) = nan, pixels.at(2, 2, 1) = infinity, pixels.at(3, 3, 2) = -infinity;
    const Sanitised sanitised(pixels);
    for (int i : {1, 2, 3}) {
        EXPECT_EQ(sanitised.at(i, i), (Values{0, 0, 0}));
        EXPECT_EQ(sanitised.valid[size_t(i) * 9 + i], 0);
    }
    EXPECT_EQ(std::count(sanitised.valid.begin(), sanitised.valid.end(), 0), 3);
    EXPECT_EQ(sanitised.mended, (Mended{{"color", {{fault::rebuilt, 3}}}}));
}

TEST(Radiance, APictureThatIsNotKnownAnywhereIsBlackAndToldSo) {
    Scene scene = Scene::color(16, 20);
    Pixels &color = scene.buffers.at("color");
    color = Pixels(16, 20, 3, nan);
    EXPECT_EQ(scene.denoise("single-3").values, Pixels(16, 20, 3).values);
    EXPECT_EQ(scene.report["notes"], Json::array({"no pixel's radiance is finite: the picture is black"}));
    color.values[0] = color.values[1] = color.values[2] = 1; // known by one pixel
    scene.denoise("single-3");
    EXPECT_EQ(scene.report["notes"], Json::array());
}

TEST(Radiance, PartsThatAddUpStay) {
    Threads threads;
    Mended mended;
    const Planes diffuse = load(noise(8, 9, 3, 1), threads), specular = load(noise(8, 9, 3, 2), threads);
    Planes color(3, 8, 9), one = diffuse, other = specular;
    for (int c = 0; c < 3; ++c)
        for (int i = 0; i < 8 * 9; ++i) // as halves round
            color.row(c, 0)[i] = (diffuse.row(c, 0)[i] + specular.row(c, 0)[i]) * (i % 2 ? 1.0005f : 0.9995f);
    color.row(0, 1)[2] = color.row(1, 1)[2] = color.row(2, 1)[2] = nan; // not known: it says nothing
    EXPECT_EQ(make_parts_of(color, one, other, threads, mended), 0);
    EXPECT_TRUE(mended.empty());
    for (int i = 0; i < 3 * 8 * 9; ++i) {
        EXPECT_EQ(one.row(0, 0)[i], diffuse.row(0, 0)[i]);
        EXPECT_EQ(other.row(0, 0)[i], specular.row(0, 0)[i]);
    }
}

TEST(Radiance, PartsAreMadeToAddUp) {
    struct {
        float color, diffuse, specular, right_diffuse, right_specular;
    } const cases[] = {
        {1, 0.6f, 0.2f, 0.6f, 0.4f}, // emission forgotten
        {1, 0, 0, 0, 1},             // no parts
        {1, 2.5f, 0, 1, 0},          // diffuse light counted twice
        {1, 0.75f, 0.5f, 0.75f, 0.25f},
        {1, -0.3f, 0, 0, 1},
        {1, -0.8f, 1.8f, 0, 1}, // they add up, but light is not negative
        {1, 1.5f, -0.5f, 1, 0},
        {1, nan, 0.5f, 0, 1}, // one is not known
        {1, 0.25f, nan, 0.25f, 0.75f},
        {-0.5f, 0.25f, 0.25f, 0, -0.5f}, // out of gamut
        {0, 0.5f, 0.5f, 0, 0},
    };
    Threads threads;
    for (const auto &at : cases) {
        Pixels color(2, 2, 3, 1), diffuse(2, 2, 3, 0.5f), specular(2, 2, 3, 0.5f);
        set(color, 1, 0, Values(3, at.color));
        set(diffuse, 1, 0, Values(3, at.diffuse));
        set(specular, 1, 0, Values(3, at.specular));
        Planes one = load(diffuse, threads), other = load(specular, threads);
        Mended mended;
        EXPECT_EQ(make_parts_of(load(color, threads), one, other, threads, mended), 1);
        for (int c = 0; c < 3; ++c) {
            EXPECT_FLOAT_EQ(one.row(c, 1)[0], at.right_diffuse);
            EXPECT_FLOAT_EQ(other.row(c, 1)[0], at.right_specular);
            EXPECT_EQ(one.row(c, 0)[0] + other.row(c, 1)[1], 1);
        }
        EXPECT_EQ(mended, (Mended{{"diffuse + specular", {{fault::apart, 1}}}}));
    }
}

TEST(Radiance, PartsThatAreNotColorAddNoLight) {
    Scene scene = Scene::full(40, 44);
    const Pixels color = sum(scene.buffers.at("diffuse"), scene.buffers.at("specular"));
    const Pixels right = scene.denoise("split-5");
    scene.buffers.emplace("color", color);
    EXPECT_EQ(scene.denoise("split-5").values, right.values); // they are
    EXPECT_EQ(scene.report["notes"], Json::array());
    const Pixels specular = scene.buffers.at("specular");
    for (float part : {0.0f, 0.5f, 3.0f}) {
        for (size_t i = 0; i < specular.values.size(); ++i)
            scene.buffers.at("specular").values[i] = part * specular.values[i] + 0.25f;
        expect_near(scene.denoise("split-5"), right, 1e-4);
        EXPECT_EQ(scene.report["notes"].size(), 1u);
        scene.buffers.at("specular").values[7] = nan; // known by the others
        expect_near(scene.denoise("split-5"), right, 1e-4);
    }
    scene.buffers.at("specular") = specular;
    scene.buffers.at("color") = Pixels(40, 44, 3); // says nothing
    EXPECT_EQ(scene.denoise("split-5").values, right.values);
    EXPECT_EQ(scene.report["notes"].size(), 1u);
}

TEST(Radiance, ColoursOutsideOfTheGamutComeBack) {
    Scene scene = Scene::color(40, 44);
    for (int i = 0; i < 40 * 44; ++i)
        scene.buffers.at("color").values[size_t(i) * 3] = -0.5f;
    for (int i = 0; i < 40 * 44; ++i)
        scene.buffers.at("color").values[size_t(i) * 3 + 1] += 0.5f;
    const Pixels &result = scene.denoise("single-3");
    for (int i = 0; i < 40 * 44; ++i)
        EXPECT_NEAR(result.values[size_t(i) * 3], -0.5f, 1e-6);
    EXPECT_EQ(scene.report["sanitised"], Json::object());
}

TEST(Radiance, UnknownAlphaAndLayersAreOfTheirNeighbours) {
    Scene scene = Scene::full(40, 44);
    scene.buffers.at("alpha") = Pixels(40, 44, 1, 1);
    scene.buffers.at("alpha").at(5, 6, 0) = nan, scene.buffers.at("alpha").at(7, 8, 0) = 3;
    Pixels key(40, 44, 3, 0.5f);
    key.at(9, 9, 1) = infinity, key.at(11, 11, 0) = -1e30f;
    scene.layers["key"].emplace("color", key);
    scene.denoise("split-5");
    for (float value : scene.results.at("alpha").values)
        EXPECT_NEAR(value, 1, 1e-5);
    const Json sanitised = {{"alpha", {{fault::rebuilt, 1}, {fault::above, 1}}},
                            {"key", {{fault::rebuilt, 1}, {fault::negative, 1}}}};
    EXPECT_EQ(scene.report["sanitised"], sanitised);
    EXPECT_NEAR(scene.results.at("key").at(9, 9, 1), 0.5f, 1e-5);
}

TEST(Radiance, AnyExposureLeavesThePicture) {
    Scene scene = Scene::color(20, 24);
    for (float exposure : {1e-36f, 1e37f}) {
        scene.settings.exposure = exposure;
        const Pixels &result = scene.denoise("single-3");
        double in = 0, out = 0;
        for (size_t i = 0; i < result.values.size(); ++i)
            in += scene.buffers.at("color").values[i], out += result.values[i];
        EXPECT_NEAR(out / in, 1, 0.2);
    }
}

} // namespace pathfold::core
