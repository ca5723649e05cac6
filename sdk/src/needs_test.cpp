#include "needs.h"

#include "testing.h"

namespace pathfold::core {
namespace {

Prepared prepared_with(Planes values, bool demodulated) {
    Prepared prepared;
    prepared.signals.push_back({"color", 0, demodulated, std::move(values)});
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
    prepared.signals.push_back({"key", 0, false, layer});
    EXPECT_FALSE(is_idle(prepared, 0, tile, 2));
}

} // namespace pathfold::core
