#include "needs.h"

#include "testing.h"

namespace pathfold::core {
namespace {

Prepared prepared_with(Planes values, bool demodulated) {
    Prepared prepared;
    prepared.branches.resize(1);
    prepared.signals.push_back({"color", 0, demodulated, false, std::move(values)});
    return prepared;
}

Planes constant(float value) {
    Planes planes(3, 40, 40);
    for (int c = 0; c < 3; ++c)
        for (int y = 0; y < 40; ++y)
            std::fill_n(planes.row(c, y), 40, value);
    return planes;
}

const Tile tile{{8, 8, 8, 8}, {0, 0, 24, 24}};

} // namespace

TEST(Needs, ConstantTilesAreIdle) {
    EXPECT_TRUE(is_idle(prepared_with(constant(0), false), 0, tile, 2));
    EXPECT_TRUE(is_idle(prepared_with(constant(3), false), 0, tile, 2));
    EXPECT_TRUE(is_idle(prepared_with(constant(0), true), 0, tile, 2));
    EXPECT_FALSE(is_idle(prepared_with(constant(3), true), 0, tile, 2)); // albedo may vary
}

TEST(Needs, WhatAKernelReachesMatters) {
    Planes values = constant(0);
    values.row(1, 17)[12] = 1; // two pixels below the tile
    EXPECT_FALSE(is_idle(prepared_with(values, false), 0, tile, 2));
    EXPECT_TRUE(is_idle(prepared_with(values, false), 0, tile, 1));
}

TEST(Needs, LayersKeepABranchBusy) {
    Prepared prepared = prepared_with(constant(0), false);
    Planes layer = constant(0);
    layer.row(0, 9)[9] = -1;
    prepared.signals.push_back({"key", 0, false, true, layer});
    EXPECT_FALSE(is_idle(prepared, 0, tile, 2));
}

TEST(Needs, PathsWhereTheManifestSaysSo) {
    const Pixels color = noise(4, 4, 3, 1);
    std::vector<float> values(size_t(4) * 4 * 4 * 36);
    const pathfold_image image = color.image(),
                         paths = pathfold_packed(values.data(), PATHFOLD_FLOAT32, 4, 4, 4, 36);
    Frame frame;
    frame.set_input("color", &image);
    Manifest manifest;
    manifest.uses = {"samples.descriptor"};
    manifest.without_paths = 4;
    EXPECT_FALSE(does_without_paths(frame, manifest, 4)); // there are none
    frame.set_input("samples.descriptor", &paths);
    EXPECT_TRUE(does_without_paths(frame, manifest, 4));
    EXPECT_FALSE(does_without_paths(frame, manifest, 3));
    EXPECT_FALSE(frame.without_samples().has("samples.descriptor"));
    EXPECT_TRUE(frame.without_samples().has("color"));
    manifest.without_paths = 0;
    EXPECT_FALSE(does_without_paths(frame, manifest, 4));
    manifest.without_paths = 4;
    manifest.requires_ = {"samples.descriptor"};
    EXPECT_FALSE(does_without_paths(frame, manifest, 4));
}

TEST(Needs, UnreadBuffers) {
    const Pixels color = noise(4, 4, 3, 1);
    const pathfold_image image = color.image();
    Frame frame;
    for (const char *name : {"color", "albedo", "normal"})
        frame.set_input(name, &image);
    const Manifest single = Manifest::parse(read_text(model_folder("single-3") + "/manifest.json"));
    const Manifest split = Manifest::parse(read_text(model_folder("split-5") + "/manifest.json"));
    EXPECT_EQ(unread_buffers(frame, single, false), (std::vector<std::string>{"albedo", "normal"}));
    EXPECT_EQ(unread_buffers(frame, split, false), std::vector<std::string>{});
    frame.set_input("diffuse", &image);
    EXPECT_EQ(unread_buffers(frame, split, false), std::vector<std::string>{"diffuse"});
}

} // namespace pathfold::core
