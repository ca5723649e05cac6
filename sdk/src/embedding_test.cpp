#include "embedding.h"

#include <numeric>

#include <gtest/gtest.h>

namespace pathfold::core {
namespace {

std::vector<float> counted(int64_t channels, const Rect &area) {
    std::vector<float> values(size_t(channels) * Embedding::cells(area.height) *
                              Embedding::cells(area.width));
    std::iota(values.begin(), values.end(), 1.0f);
    return values;
}

TEST(Embedding, CellsFillTheAlignment) {
    EXPECT_EQ(Embedding::cells(1), 8);
    EXPECT_EQ(Embedding::cells(16), 8);
    EXPECT_EQ(Embedding::cells(17), 16);
}

TEST(Embedding, PartsOfTheFrameMakeTheFrame) {
    const Rect top{0, 0, 35, 32}, bottom{0, 32, 35, 5}, whole{0, 0, 35, 37};
    Embedding embedding;
    embedding.reset(2, whole.height, whole.width);
    const std::vector<float> all = counted(2, whole);
    const int width = Embedding::cells(35); // 24; 16 rows above, 8 below
    std::vector<float> above, below;
    for (int c = 0; c < 2; ++c) {
        const float *channel = all.data() + size_t(c) * 24 * width;
        above.insert(above.end(), channel, channel + size_t(16) * width);
        below.insert(below.end(), channel + size_t(16) * width, channel + size_t(24) * width);
    }
    embedding.add(bottom, below.data());
    embedding.add(top, above.data());
    std::vector<float> out(all.size());
    embedding.copy(whole, out.data());
    EXPECT_EQ(out, all);
    std::vector<float> part(size_t(2) * 8 * 16);
    embedding.copy({16, 16, 19, 16}, part.data());
    EXPECT_EQ(part[0], all[size_t(8) * width + 8]);
    EXPECT_EQ(part.back(), all[size_t(24 + 15) * width + 23]);
}

TEST(Embedding, PartsOfTheSamplesAddUpAndAResetForgetsThem) {
    const Rect area{0, 0, 16, 16};
    Embedding embedding;
    embedding.reset(1, 16, 16);
    const std::vector<float> ones(64, 1.0f);
    embedding.add(area, ones.data());
    embedding.add(area, ones.data());
    std::vector<float> out(64);
    embedding.copy(area, out.data());
    EXPECT_EQ(out, std::vector<float>(64, 2.0f));
    embedding.reset(1, 16, 16);
    embedding.copy(area, out.data());
    EXPECT_EQ(out, std::vector<float>(64, 0.0f));
}

} // namespace
} // namespace pathfold::core
