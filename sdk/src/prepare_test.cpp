#include "prepare.h"

#include <cmath>
#include <limits>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();

/// What that model makes of the frame.
Prepared run(const Frame &frame, const std::string &model, float exposure, Threads &threads) {
    const Manifest manifest = Manifest::parse(read_text(model_folder(model) + "/manifest.json"));
    const Reads reads = decide_reads(frame, manifest, {});
    Guides guides(frame, reads, manifest.requires_, threads);
    return prepare(frame, reads, guides, exposure, manifest.exposure_key, threads);
}

float exposure_of(const Pixels &color) {
    const pathfold_image image = color.image();
    float exposure = 0;
    EXPECT_EQ(pathfold_auto_exposure(&image, &exposure), PATHFOLD_OK) << pathfold_last_error();
    return exposure;
}

struct SplitFrame {
    Pixels diffuse = noise(20, 30, 3, 1), specular = noise(20, 30, 3, 2), albedo = noise(20, 30, 3, 3);
    Frame frame;

    SplitFrame() {
        for (float &value : albedo.values)
            value = std::min(value, 1.0f);
    }
    void set() {
        const pathfold_image images[] = {diffuse.image(), specular.image(), albedo.image()};
        frame.set_input("diffuse", &images[0]);
        frame.set_input("specular", &images[1]);
        frame.set_input("diffuse.albedo", &images[2]);
    }
};

} // namespace

TEST(Exposure, OfAConstant) { EXPECT_NEAR(exposure_of(Pixels(50, 70, 3, 0.5f)), 0.36f, 1e-6); }

TEST(Exposure, IsTheLogAverageOfBins) {
    Pixels color(16, 32, 3, 1); // two bins: 1 and 16
    for (int y = 0; y < 16; ++y)
        for (int x = 16; x < 32; ++x)
            for (int c = 0; c < 3; ++c)
                color.at(y, x, c) = 16;
    EXPECT_NEAR(exposure_of(color), 0.18f / 4, 1e-6);
}

TEST(Exposure, ScalesWithTheImage) {
    const float exposure = exposure_of(noise(40, 60, 3, 1));
    for (float scale : {1e-30f, 1e-6f, 1e6f, 1e30f})
        EXPECT_NEAR(exposure_of(noise(40, 60, 3, 1, scale)) * scale / exposure, 1, 1e-5) << scale;
}

TEST(Exposure, OutlyingPixelsHardlyMoveIt) {
    for (float scale : {1e-12f, 1.0f, 1e6f}) {
        Pixels color = noise(64, 64, 3, 1, scale);
        const float calm = exposure_of(color);
        for (int c = 0; c < 3; ++c)
            color.at(20, 20, c) = 1e12f * scale;
        EXPECT_NEAR(exposure_of(color) / calm, 1, 0.25) << "one of 16 bins, scale " << scale;
        for (int y = 4; y < 64; y += 8)
            for (int x = 0; x < 64; x += 16)
                color.at(y, x, 1) = 1e12f * scale;
        EXPECT_GT(exposure_of(color) / calm, 1 / 20.0) << "all bins, scale " << scale;
    }
}

TEST(Exposure, TheSunIsNotTheScene) {
    Pixels color = noise(160, 160, 3, 1);
    const float calm = exposure_of(color);
    for (int y = 66; y < 72; ++y) // one of 100 bins
        for (int x = 66; x < 72; ++x)
            color.at(y, x, 1) = 1e12f;
    EXPECT_NEAR(exposure_of(color) / calm, 1, 0.05);
}

TEST(Exposure, ASmallLitPartInTheDarkCounts) {
    for (float dark : {0.0f, 1e-12f}) {
        Pixels color(160, 160, 3, dark);
        for (int y = 64; y < 80; ++y) // two of 100 bins
            for (int x = 64; x < 96; ++x)
                for (int c = 0; c < 3; ++c)
                    color.at(y, x, c) = 1;
        EXPECT_NEAR(exposure_of(color), 0.18f, 1e-6) << dark;
    }
    Pixels star(64, 64, 3); // a single lit pixel is all there is to go by
    star.at(9, 9, 1) = 256;
    EXPECT_NEAR(exposure_of(star), 0.18f / 0.715160f, 1e-5);
}

TEST(Exposure, BlackAndDamagedImages) {
    EXPECT_EQ(exposure_of(Pixels(8, 8, 3)), 1.0f);
    EXPECT_EQ(exposure_of(Pixels(8, 8, 3, nan)), 1.0f);
    Pixels color(16, 16, 3, 0.5f);
    color.at(3, 3, 1) = infinity;
    EXPECT_NEAR(exposure_of(color), 0.36f, 1e-6);
    EXPECT_TRUE(std::isnormal(exposure_of(Pixels(8, 8, 3, 1e-45f))));
    EXPECT_TRUE(std::isnormal(exposure_of(Pixels(8, 8, 3, 3e38f))));
}

TEST(Prepare, MasksAPixelInEveryPart) {
    SplitFrame split;
    split.diffuse.at(5, 6, 1) = nan;
    split.specular.at(7, 8, 0) = infinity;
    split.set();
    Threads threads;
    const Prepared prepared = run(split.frame, "split-5", 0, threads);
    ASSERT_EQ(prepared.signals.size(), 2u); // split
    for (const Signal &signal : prepared.signals)
        for (auto [y, x] : {std::pair(5, 6), {7, 8}})
            for (int c = 0; c < 3; ++c)
                EXPECT_EQ(signal.values.row(c, y)[x], 0.0f);
    EXPECT_EQ(prepared.valid[5 * 30 + 6] + prepared.valid[7 * 30 + 8], 0);
    const Mended mended = {{"diffuse", {{fault::rebuilt, 1}}}, {"specular", {{fault::rebuilt, 1}}}};
    EXPECT_EQ(prepared.mended, mended);
}

TEST(Prepare, NegativeRadianceAndCaps) {
    SplitFrame split;
    split.diffuse.at(1, 1, 0) = -3;
    split.specular.at(2, 2, 2) = 3e38f;
    split.set();
    Threads threads;
    const Prepared prepared = run(split.frame, "split-5", 10, threads);
    EXPECT_EQ(prepared.signals[0].values.row(0, 1)[1], 0.0f);
    EXPECT_FLOAT_EQ(prepared.signals[1].values.row(2, 2)[2], 1e30f);
    const Mended mended = {{"diffuse", {{fault::negative, 1}}}, {"specular", {{fault::capped, 1}}}};
    EXPECT_EQ(prepared.mended, mended);
    EXPECT_EQ(prepared.exposure, 10.0f);
}

TEST(Prepare, DepthScaleLeavesMissesOut) {
    const Pixels color = noise(10, 10, 3, 1);
    Pixels depth(10, 10, 1, 4);
    depth.at(0, 0, 0) = 0, depth.at(1, 1, 0) = infinity, depth.at(2, 2, 0) = nan, depth.at(3, 3, 0) = -1;
    Frame frame;
    const pathfold_image images[] = {color.image(), depth.image()};
    frame.set_input("color", &images[0]);
    frame.set_input("depth", &images[1]);
    Threads threads;
    EXPECT_FLOAT_EQ(run(frame, "split-5", 0, threads).depth_scale, 0.25f);
    EXPECT_EQ(run(frame, "single-3", 0, threads).depth_scale, 1.0f); // does not read it
}

TEST(Prepare, DepthScaleStaysAFloat) {
    const Pixels color = noise(4, 4, 3, 1);
    Threads threads;
    for (float value : {1e-45f, 3e38f}) {
        Pixels depth(4, 4, 1, value);
        depth.at(0, 0, 0) = 0; // times infinity would be NaN
        Frame frame;
        const pathfold_image images[] = {color.image(), depth.image()};
        frame.set_input("color", &images[0]);
        frame.set_input("depth", &images[1]);
        EXPECT_TRUE(std::isnormal(run(frame, "split-5", 0, threads).depth_scale)) << value;
    }
}

TEST(Prepare, RemodulationStaysAFloat) {
    SplitFrame split;
    split.albedo.at(3, 4, 0) = std::numeric_limits<float>::max();
    split.diffuse.at(5, 6, 1) = std::numeric_limits<float>::max();
    split.albedo.at(5, 6, 1) = 0;
    split.set();
    Threads threads;
    const Prepared prepared = run(split.frame, "split-5", 1e-6f, threads);
    const Planes &factor = prepared.factors[0];
    const float brightest = prepared.signals[0].values.row(1, 5)[6] / factor.row(1, 5)[6];
    EXPECT_TRUE(std::isfinite(brightest * factor.row(0, 3)[4]));
}

TEST(Prepare, AnUnsplitLayerMakesTheFrameUnsplit) {
    SplitFrame split;
    split.set();
    const Pixels color = noise(20, 30, 3, 4);
    const pathfold_image image = color.image();
    split.frame.set_layer("key", "color", &image);
    Threads threads;
    const Prepared prepared = run(split.frame, "split-5", 0, threads);
    ASSERT_EQ(prepared.signals.size(), 2u); // with the layer
    EXPECT_EQ(prepared.signals[0].name, "color");
    EXPECT_FLOAT_EQ(prepared.signals[0].values.row(1, 3)[4],
                    split.diffuse.at(3, 4, 1) + split.specular.at(3, 4, 1));
}

} // namespace pathfold::core
