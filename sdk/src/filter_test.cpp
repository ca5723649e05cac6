#include "filter.h"

#include <cmath>
#include <limits>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr int height = 6, width = 9;
const Tile tile{{4, 2, 4, 3}, {2, 0, 7, 6}};

/// Plus one, in place of a filter; where asked for, with a factor of its own.
class PlusOne : public Operator {
public:
    float factor = 0, last = 1;

    std::map<std::string, Shape> outputs() const override { return {}; }
    int reach() const override { return 0; }
    int least_overlap() const override { return 0; }
    int alignment() const override { return 1; }
    int64_t window_pixels() const override { return 1; }
    int64_t floats_per_pixel() const override { return 0; }
    void apply(Threads &, const Prediction &, Source &source, float *result) override {
        const Rect &core = source.tile.core, &window = source.tile.window;
        source.cleaned = Planes();
        if (factor != 0) {
            source.cleaned = Planes(3, window.height, window.width);
            for (int c = 0; c < 3; ++c)
                std::fill_n(source.cleaned.row(c, 0), window.height * window.width, factor);
        }
        for (size_t plane = 0; plane < source.planes.size(); ++plane)
            for (int y = 0; y < core.height; ++y, result += core.width) {
                source.copy_row(plane, core.x, core.y + y, core.width, result);
                for (int x = 0; x < core.width; ++x)
                    result[x] += last;
            }
    }
};

Planes planes_of(int channels, float value) {
    Planes planes(channels, height, width);
    for (int c = 0; c < channels; ++c)
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x)
                planes.row(c, y)[x] = value + float(c) + 0.5f * float(y * width + x);
    return planes;
}

/// Two branches, the first with a factor; alpha goes with the second one.
struct Filtered {
    Prepared prepared;
    std::vector<Filter> filters;
    Threads threads;
    Prediction prediction;
    PlusOne how;

    Filtered() {
        prepared.valid.assign(height * width, 1);
        prepared.factors = {planes_of(3, 2), Planes()};
        prepared.signals.push_back({"diffuse", 0, true, planes_of(3, 8)});
        prepared.signals.push_back({"specular", 1, false, planes_of(3, -60)});
        prepared.signals.push_back({"alpha", 1, false, planes_of(1, 1)});
        for (int branch : {0, 1})
            filters.emplace_back(prepared, branch, width, height);
    }
    void apply(int branch) { filters[size_t(branch)].apply(threads, how, prediction, tile); }
    float noisy(size_t signal, int c, int y, int x) const {
        return prepared.signals[signal].values.row(c, y)[x];
    }
    Pixels write(const std::vector<size_t> &signals, int channels, int64_t repaired = 0) {
        Pixels pixels(height, width, channels, -7);
        const pathfold_image image = pixels.image();
        EXPECT_EQ(write_tile(threads, prepared, filters, signals, tile.core, ImageView(image, "output")),
                  repaired);
        return pixels;
    }
    /// Calls check(y, x, c, whether it is in the tile's core) for all of an image.
    template <typename Check>
    static void for_all(int channels, const Check &check) {
        const Rect &core = tile.core;
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x)
                for (int c = 0; c < channels; ++c)
                    check(y, x, c,
                          y >= core.y && y < core.y + core.height && x >= core.x && x < core.x + core.width);
    }
};

} // namespace

TEST(Filter, DividesMeanwhile) {
    Filtered at;
    at.apply(0);
    const Pixels written = at.write({0}, 3);
    at.for_all(3, [&](int y, int x, int c, bool inside) {
        const float by = at.prepared.factors[0].row(c, y)[x];
        const float right = inside ? (at.noisy(0, c, y, x) / by + 1) * by : -7;
        EXPECT_EQ(written.at(y, x, c), right) << y << " " << x << " " << c;
    });
}

TEST(Filter, ACleanedFactorDividesAndMultiplies) {
    Filtered at;
    at.how.factor = 4;
    at.apply(0);
    Pixels written = at.write({0}, 3);
    at.for_all(3, [&](int y, int x, int c, bool inside) {
        EXPECT_EQ(written.at(y, x, c), inside ? at.noisy(0, c, y, x) + 4 : -7);
    });
    at.how.factor = 0; // of another tile: nothing of the last one stays
    at.apply(0);
    written = at.write({0}, 3);
    EXPECT_NE(written.at(2, 4, 0), at.noisy(0, 0, 2, 4) + 4);
}

TEST(Filter, BranchesAddUpWithTheirSign) {
    Filtered at;
    at.how.factor = 4;
    at.apply(0);
    at.filters[1].keep(tile);
    const Pixels written = at.write({0, 1}, 3);
    bool below = false;
    at.for_all(3, [&](int y, int x, int c, bool inside) {
        const float sum = at.noisy(0, c, y, x) + 4 + at.noisy(1, c, y, x);
        EXPECT_EQ(written.at(y, x, c), inside ? sum : -7);
        below = below || (inside && sum < 0);
    });
    EXPECT_TRUE(below);
}

TEST(Filter, RidersComeFromTheirBranch) {
    Filtered at;
    at.apply(1);
    const Pixels alpha = at.write({2}, 1);
    at.for_all(1, [&](int y, int x, int, bool inside) {
        EXPECT_EQ(alpha.at(y, x, 0), inside ? at.noisy(2, 0, y, x) + 1 : -7);
    });
}

TEST(Filter, WhereKernelsAreNotFiniteTheNoisyValueStays) {
    Filtered at;
    at.how.last = std::numeric_limits<float>::quiet_NaN();
    at.apply(0);
    const Pixels written = at.write({0}, 3, 4 * 3 * 3);
    at.for_all(3, [&](int y, int x, int c, bool inside) {
        EXPECT_EQ(written.at(y, x, c), inside ? at.noisy(0, c, y, x) : -7);
    });
}

} // namespace pathfold::core
