#include "image.h"

#include <algorithm>
#include <random>
#include <set>

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

namespace {

/// A member of a struct of `size` bytes per pixel, `offset` bytes into it; rows may end in some more bytes.
ImageView member(std::vector<char> &memory, int size, int offset, int channels, int padding = 0) {
    pathfold_image image = pathfold_packed(memory.data() + offset, PATHFOLD_FLOAT32, 1, 7, 9, channels);
    image.pixel_stride = size;
    image.row_stride = 9 * size + padding;
    return {image, "member"};
}

} // namespace

TEST(Image, MembersOfAStructShareNoByte) {
    for (int padding : {0, 4, 13}) {
        std::vector<char> memory(7 * (9 * 32 + 16));
        const ImageView color = member(memory, 32, 0, 3, padding),
                        albedo = member(memory, 32, 12, 3, padding), late = member(memory, 32, 8, 3, padding),
                        byte = member(memory, 32, 11, 1, padding);
        EXPECT_FALSE(color.overlaps(albedo));
        EXPECT_FALSE(albedo.overlaps(color));
        EXPECT_TRUE(color.overlaps(late));
        EXPECT_TRUE(late.overlaps(albedo));
        EXPECT_TRUE(color.overlaps(byte)); // by one byte
        EXPECT_TRUE(color.overlaps(color));
    }
}

TEST(Image, OverlapsAreThoseOfBytes) {
    std::mt19937 random(3);
    const auto draw = [&](int least, int most) {
        return std::uniform_int_distribution<int>(least, most)(random);
    };
    int overlapping = 0;
    for (int trial = 0; trial < 4000; ++trial) {
        static char memory[1 << 12];
        std::vector<pathfold_image> images;
        std::vector<std::multiset<const char *>> bytes(2);
        for (std::multiset<const char *> &mine : bytes) {
            pathfold_image image{memory + 2048 + draw(-40, 40),
                                 draw(0, 1),
                                 1,
                                 draw(1, 4),
                                 draw(1, 4),
                                 draw(1, 3),
                                 0,
                                 draw(-60, 60),
                                 draw(-20, 20),
                                 draw(-8, 8)};
            images.push_back(image);
            for (int y = 0; y < image.height; ++y)
                for (int x = 0; x < image.width; ++x)
                    for (int c = 0; c < image.channels; ++c)
                        for (int b = 0; b < (image.format == PATHFOLD_FLOAT16 ? 2 : 4); ++b)
                            mine.insert(static_cast<char *>(image.data) + y * image.row_stride +
                                        x * image.pixel_stride + c * image.channel_stride + b);
        }
        const ImageView a(images[0], "a"), b(images[1], "b");
        const bool shared = std::any_of(bytes[0].begin(), bytes[0].end(),
                                        [&](const char *byte) { return bytes[1].count(byte) > 0; });
        const bool twice = std::any_of(bytes[0].begin(), bytes[0].end(),
                                       [&](const char *byte) { return bytes[0].count(byte) > 1; });
        ASSERT_EQ(a.overlaps(b), shared) << trial;
        ASSERT_EQ(a.overlaps_itself(), twice) << trial;
        overlapping += shared;
    }
    EXPECT_GT(overlapping, 400);
    EXPECT_LT(overlapping, 3600);
}

TEST(Image, StridesBeyondMemoryAreRefused) {
    float value = 0;
    pathfold_image image = pathfold_packed(&value, PATHFOLD_FLOAT32, 1, 4, 4, 3);
    for (int64_t stride : {INT64_MAX, INT64_MIN, INT64_MAX / 2, int64_t(1) << 47}) {
        for (auto member :
             {&pathfold_image::row_stride, &pathfold_image::pixel_stride, &pathfold_image::channel_stride}) {
            pathfold_image wild = image;
            wild.*member = stride;
            expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { ImageView(wild, "albedo"); }, "albedo", "stride");
        }
    }
    image.row_stride = INT64_MAX;
    image.height = 1; // of one row it does not matter
    EXPECT_FALSE(ImageView(image, "albedo").empty());
    image = pathfold_packed(reinterpret_cast<void *>(64), PATHFOLD_FLOAT32, 1, 4, 4, 3);
    image.row_stride = -image.row_stride;
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { ImageView(image, "albedo").expect_data("albedo"); },
        "out of memory");
}

TEST(Image, SamplesThatWereForgottenAreNamed) {
    float value = 0;
    pathfold_image image = pathfold_packed(&value, PATHFOLD_FLOAT32, 0, 4, 4, 3);
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { ImageView(image, "color"); }, "color: samples is 0");
}

} // namespace pathfold::core
