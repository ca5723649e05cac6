#include "mend.h"

#include <cmath>
#include <limits>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();

/// A channel whose values are 10 y + x.
Planes ramp(int height, int width) {
    Planes planes(1, height, width);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            planes.row(0, y)[x] = float(10 * y + x);
    return planes;
}

} // namespace

TEST(Mend, AnUnknownValueIsOfItsNeighbours) {
    Threads threads;
    for (auto [by, right] : {std::pair(Missing::mean, 33.0f), {Missing::most, 44.0f}}) {
        Planes planes = ramp(6, 7);
        planes.row(0, 3)[3] = nan;
        fill_unknown(planes, by, -1, threads);
        EXPECT_EQ(planes.row(0, 3)[3], right);
        EXPECT_EQ(planes.row(0, 3)[4], 34);
    }
    Planes planes = ramp(3, 3); // in a corner
    planes.row(0, 0)[0] = nan;
    fill_unknown(planes, Missing::mean, -1, threads);
    EXPECT_FLOAT_EQ(planes.row(0, 0)[0], (1 + 10 + 11) / 3.0f);
}

TEST(Mend, TheAreaGrowsUntilOneIsKnown) {
    Threads threads;
    for (int side : {1, 2, 5, 33}) {
        Planes planes(2, side, side + 3);
        for (int c = 0; c < 2; ++c)
            std::fill_n(planes.row(c, 0), side * (side + 3), nan);
        planes.row(0, side - 1)[side + 2] = 7;
        fill_unknown(planes, Missing::mean, 0.5f, threads);
        for (int i = 0; i < side * (side + 3); ++i) {
            EXPECT_EQ(planes.row(0, 0)[i], 7);
            EXPECT_EQ(planes.row(1, 0)[i], 0.5f); // each channel by itself
        }
    }
}

TEST(Mend, NoneIsMadeOfAnotherThatWas) {
    Threads threads;
    Planes planes = ramp(1, 9);
    for (int x : {1, 2, 3})
        planes.row(0, 0)[x] = nan;
    fill_unknown(planes, Missing::most, 0, threads);
    EXPECT_EQ(planes.row(0, 0)[1], 0);
    EXPECT_EQ(planes.row(0, 0)[2], 5); // of cells 0-1, 2-3 and 4-5
    EXPECT_EQ(planes.row(0, 0)[3], 4);
}

TEST(Mend, ValuesWithin) {
    std::vector<float> values(37, 0.5f);
    EXPECT_TRUE(all_within(values.data(), values.size(), 0, 1));
    EXPECT_TRUE(all_within(values.data(), 0, 0, 0));
    for (float bad : {nan, -0.1f, 1.1f, std::numeric_limits<float>::infinity()}) {
        values[29] = bad;
        EXPECT_FALSE(all_within(values.data(), values.size(), 0, 1)) << bad;
    }
}

TEST(Mend, CountsAddUp) {
    Mended mended, other = {{"depth", {{fault::miss, 2}}}};
    tally(mended, "albedo", fault::above, 0);
    EXPECT_TRUE(mended.empty()); // what is in order is not told
    tally(mended, "albedo", fault::above, 3);
    tally(mended, "albedo", fault::above, 4);
    tally(mended, other);
    EXPECT_EQ(mended, (Mended{{"albedo", {{fault::above, 7}}}, {"depth", {{fault::miss, 2}}}}));
}

} // namespace pathfold::core
