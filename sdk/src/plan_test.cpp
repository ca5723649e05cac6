#include "plan.h"

#include "scene.h"
#include "testing.h"

namespace pathfold::core {
namespace {

constexpr int64_t mebibyte = 1 << 20;

/// Of a frame of that size, all in color, by a test model.
Plan plan_of(const std::string &model, int height, int width, const Settings &settings) {
    const Pixels color(height, width, 3);
    const pathfold_image image = color.image();
    Frame frame;
    frame.set_input("color", &image);
    return Denoiser(std::make_shared<const Model>(model_folder(model), "cpu", 1)).plan(frame, settings);
}

} // namespace

TEST(Plan, MemoryBoundsTheTiles) {
    Settings settings;
    settings.memory_mb = 20;
    const Plan plan = plan_of("single-21", 200, 200, settings);
    EXPECT_GE(plan.tiles.size(), 4u); // of windows of 11700 pixels
    EXPECT_LE(plan.window_bytes, 20 * mebibyte);
    EXPECT_GT(plan.window_bytes, 10 * mebibyte);
    // Of each pixel 441 logits, and the network's three inputs twice.
    EXPECT_EQ(plan.window_bytes, plan.window_pixels * 4 * (441 + 2 * 3));
    int64_t pixels = 0;
    for (const Tile &tile : plan.tiles)
        pixels += tile.window.width * tile.window.height;
    EXPECT_EQ(plan.pixels, pixels);
    EXPECT_EQ(plan.frame_bytes, 200 * 200 * (3 * 4 + 1));
}

TEST(Plan, IsWhatARunDoes) {
    Scene scene = Scene::color(70, 90);
    scene.settings.tile = 16;
    scene.denoise("trust-5");
    const Plan plan = plan_of("trust-5", 70, 90, scene.settings);
    EXPECT_EQ(scene.report["tiles"], plan.tiles.size());
    EXPECT_EQ(scene.report["tile"], Json({16, 16}));
}

TEST(Plan, WhatCannotBe) {
    Settings settings;
    settings.tile = 6;
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { plan_of("single-21", 20, 20, settings); }, "tile is 6",
        "multiple of 4");
    settings.tile = 0;
    settings.memory_mb = 1;
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { plan_of("pyramid", 500, 500, settings); }, "memory_mb is 1",
        "too little for the smallest tile");
}

} // namespace pathfold::core
