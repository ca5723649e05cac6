#include "tiles.h"

#include <gtest/gtest.h>

namespace pathfold::core {
namespace {

void expect_cover(const std::vector<Tile> &tiles, int width, int height, int alignment, int overlap) {
    std::vector<int> covered(size_t(width) * height);
    for (const auto &[core, window] : tiles) {
        for (int y = core.y; y < core.y + core.height; ++y)
            for (int x = core.x; x < core.x + core.width; ++x)
                ++covered[size_t(y) * width + x];
        EXPECT_EQ(window.x % alignment, 0);
        EXPECT_EQ(window.y % alignment, 0);
        EXPECT_TRUE(window.x == 0 || core.x - window.x >= overlap);
        EXPECT_TRUE(window.y == 0 || core.y - window.y >= overlap);
        const int right = window.x + window.width, bottom = window.y + window.height;
        EXPECT_TRUE(right == width || right - core.x - core.width >= overlap);
        EXPECT_TRUE(bottom == height || bottom - core.y - core.height >= overlap);
        EXPECT_LE(right, width);
        EXPECT_LE(bottom, height);
    }
    for (int count : covered)
        ASSERT_EQ(count, 1);
}

} // namespace

TEST(Tiles, CoverEveryPixelOnce) {
    for (auto [width, height] : {std::pair(1, 1), {1, 777}, {333, 5}, {320, 213}, {64, 64}, {1000, 701}})
        for (auto [alignment, overlap] : {std::pair(1, 0), {4, 6}, {8, 17}, {16, 68}})
            for (int64_t pixels : {40000, 100000, 1 << 30}) {
                SCOPED_TRACE(testing::Message()
                             << width << " x " << height << " " << alignment << " " << overlap);
                const std::vector<Tile> tiles = plan_tiles(width, height, alignment, overlap, pixels);
                ASSERT_FALSE(tiles.empty());
                expect_cover(tiles, width, height, alignment, overlap);
                for (const Tile &tile : tiles)
                    EXPECT_LE(int64_t(tile.window.width) * tile.window.height, pixels);
            }
}

TEST(Tiles, OneTileWhereItFits) { EXPECT_EQ(plan_tiles(640, 480, 4, 68, 640 * 480).size(), 1u); }

TEST(Tiles, SmallOverlapWhereManyAreNeeded) {
    int64_t seen = 0;
    for (const Tile &tile : plan_tiles(1920, 1080, 4, 20, 150000))
        seen += int64_t(tile.window.width) * tile.window.height;
    EXPECT_LT(double(seen), 1.3 * 1920 * 1080);
}

TEST(Tiles, EdgeIsObeyed) {
    const std::vector<Tile> tiles = plan_tiles(100, 60, 4, 8, 1, 32);
    EXPECT_EQ(tiles.size(), 4u * 2u);
    expect_cover(tiles, 100, 60, 4, 8);
}

TEST(Tiles, NoneWhereNoneIsSmallEnough) { EXPECT_TRUE(plan_tiles(500, 500, 4, 68, 1000).empty()); }

} // namespace pathfold::core
