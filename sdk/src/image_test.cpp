#include "image.h"

#include <cmath>
#include <cstring>
#include <limits>

#include "half.h"
#include "testing.h"

namespace pathfold::core {

TEST(Image, StridesOfEveryKind) {
    Pixels packed = noise(5, 7, 3, 1);
    const pathfold_image dense = packed.image();

    pathfold_image upside_down = dense;
    upside_down.data = packed.values.data() + 4 * 7 * 3;
    upside_down.row_stride = -dense.row_stride;

    std::vector<float> planes(5 * 7 * 3);
    pathfold_image planar = dense;
    planar.data = planes.data();
    planar.channel_stride = 5 * 7 * 4, planar.row_stride = 7 * 4, planar.pixel_stride = 4;
    for (int i = 0; i < 5 * 7 * 3; ++i)
        planes[size_t(i % 3) * 35 + i / 3] = packed.values[i];

    for (int y = 0; y < 5; ++y) {
        float a[21], b[21], c[21];
        ImageView(dense, "a").load_row(0, y, 2, 4, a);
        ImageView(upside_down, "b").load_row(0, 4 - y, 2, 4, b);
        ImageView(planar, "c").load_row(0, y, 2, 4, c);
        for (int i = 0; i < 12; ++i) {
            EXPECT_EQ(a[i], packed.at(y, 2 + i / 3, i % 3));
            EXPECT_EQ(b[i], a[i]);
            EXPECT_EQ(c[i], a[i]);
        }
    }
}

TEST(Image, EveryHalfSurvivesTheWayThere) {
    std::vector<uint16_t> halves(65536), back(65536);
    for (size_t i = 0; i < halves.size(); ++i)
        halves[i] = uint16_t(i);
    std::vector<float> floats(halves.size());
    half_to_float(halves.data(), halves.size(), floats.data());
    EXPECT_EQ(floats[0x3c00], 1.0f);
    EXPECT_EQ(floats[0x0001], std::ldexp(1.0f, -24));
    EXPECT_EQ(floats[0xfbff], -65504.0f);
    EXPECT_TRUE(std::isinf(floats[0x7c00]));
    EXPECT_TRUE(std::isnan(floats[0x7e00]));
    float_to_half(floats.data(), floats.size(), back.data());
    for (size_t i = 0; i < halves.size(); ++i)
        if (std::isfinite(floats[i])) {
            EXPECT_EQ(back[i], halves[i]);
        }
}

TEST(Image, TooLargeForHalfIsClamped) {
    const float values[] = {1e9f, -1e9f, 65519.0f};
    uint16_t halves[3];
    float_to_half(values, 3, halves);
    EXPECT_EQ(halves[0], 0x7bff);
    EXPECT_EQ(halves[1], 0xfbff);
    EXPECT_EQ(halves[2], 0x7bff);
}

TEST(Image, StridedHalvesAreWritten) {
    std::vector<uint16_t> memory(4 * 6 * 5, 0xffff);
    pathfold_image image = pathfold_packed(memory.data(), PATHFOLD_FLOAT16, 1, 4, 6, 5);
    image.channels = 3; // the other two of five are not ours
    const float row[] = {1, 2, 3, 4, 5, 6};
    ImageView(image, "image").store_row(1, 2, 2, row);
    float read[6];
    ImageView(image, "image").load_row(0, 1, 2, 2, read);
    EXPECT_EQ(std::memcmp(row, read, sizeof(row)), 0);
    EXPECT_EQ(memory[(6 + 2) * 5 + 3], 0xffff);
}

TEST(Image, Complaints) {
    float value = 0;
    const auto make = [&](pathfold_image image) { return [=] { ImageView(image, "albedo"); }; };
    pathfold_image image = pathfold_packed(&value, PATHFOLD_FLOAT32, 1, 0, 4, 3);
    expect_error(PATHFOLD_INVALID_ARGUMENT, make(image), "albedo", "0 x 4 x 3", "at least one pixel");
    const ImageView sizes(pathfold_packed(nullptr, PATHFOLD_FLOAT32, 1, 4, 4, 3),
                          "albedo"); // is enough to plan
    EXPECT_FALSE(sizes.empty());
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { sizes.expect_data("albedo"); }, "albedo", "null pointer");
    image = pathfold_packed(&value, PATHFOLD_FLOAT32, 1, 4, 4, 3);
    image.format = 7;
    expect_error(PATHFOLD_INVALID_ARGUMENT, make(image), "format is 7");
    image = pathfold_packed(&value, PATHFOLD_FLOAT32, 1, 1 << 20, 4, 3);
    expect_error(PATHFOLD_INVALID_ARGUMENT, make(image), "65536");
}

TEST(Image, Overlaps) {
    Pixels a(4, 4, 3), b(4, 4, 3);
    const ImageView whole(a.image(), "a"), other(b.image(), "b");
    pathfold_image part = a.image();
    part.data = a.values.data() + 4 * 3;
    part.height = 1;
    EXPECT_TRUE(whole.overlaps(ImageView(part, "part")));
    EXPECT_FALSE(whole.overlaps(other));
}

} // namespace pathfold::core
