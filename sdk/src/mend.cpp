#include "mend.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace pathfold::core {
namespace {

/// Known values of an area: their sum and number, and the largest.
struct Known {
    double sum = 0;
    int64_t count = 0;
    float most = -std::numeric_limits<float>::infinity();

    void add(float value) {
        if (!std::isnan(value))
            sum += value, ++count, most = std::max(most, value);
    }
    void add(const Known &other) {
        sum += other.sum, count += other.count, most = std::max(most, other.most);
    }
};

/// One channel in cells of 2, 4, 8, ... pixels, up to a single one.
class Cells {
public:
    Cells(const Planes &planes, int channel, Threads &threads) : planes_(planes), channel_(channel) {
        for (int height = planes.height(), width = planes.width(); height > 1 || width > 1;) {
            const int finer = int(levels_.size());
            height = (height + 1) / 2, width = (width + 1) / 2;
            Level level{height, width, std::vector<Known>(size_t(height) * width)};
            for_rows(threads, height, [&](int y) {
                for (int x = 0; x < width; ++x)
                    for (int cell = 0; cell < 4; ++cell)
                        add(level.cells[size_t(y) * width + x], finer, 2 * y + cell / 2, 2 * x + cell % 2);
            });
            levels_.push_back(std::move(level));
        }
    }

    Known around(int y, int x) const {
        Known known;
        for (int l = 0; l <= int(levels_.size()) && known.count == 0; ++l)
            for (int j = -1; j <= 1; ++j)
                for (int i = -1; i <= 1; ++i)
                    add(known, l, (y >> l) + j, (x >> l) + i);
        return known;
    }

private:
    struct Level {
        int height, width;
        std::vector<Known> cells;
    };

    /// Adds a cell of 2^l pixels, where there is one.
    void add(Known &known, int l, int y, int x) const {
        const int height = l == 0 ? planes_.height() : levels_[size_t(l) - 1].height;
        const int width = l == 0 ? planes_.width() : levels_[size_t(l) - 1].width;
        if (y < 0 || x < 0 || y >= height || x >= width)
            return;
        if (l == 0)
            known.add(planes_.row(channel_, y)[x]);
        else
            known.add(levels_[size_t(l) - 1].cells[size_t(y) * width + x]);
    }

    const Planes &planes_;
    int channel_;
    std::vector<Level> levels_;
};

} // namespace

void tally(Mended &mended, const std::string &buffer, const char *fault, int64_t pixels) {
    if (pixels > 0)
        mended[buffer][fault] += pixels;
}

void tally(Mended &mended, const Mended &other) {
    for (const auto &[buffer, faults] : other)
        for (const auto &[fault, pixels] : faults)
            mended[buffer][fault] += pixels;
}

bool all_within(const float *values, size_t count, float least, float most) {
    uint32_t out = 0; // every value alike, so that it runs as vectors
    for (size_t i = 0; i < count; ++i)
        out |= uint32_t(!(values[i] >= least)) | uint32_t(!(values[i] <= most));
    return out == 0;
}

void fill_unknown(Planes &planes, Missing by, float fallback, Threads &threads) {
    for (int c = 0; c < planes.channels(); ++c) {
        const float *values = planes.row(c, 0), *end = values + size_t(planes.height()) * planes.width();
        if (std::none_of(values, end, [](float value) { return std::isnan(value); }))
            continue;
        const Cells cells(planes, c, threads);
        // found first, so that none is made of another that was replaced
        std::vector<std::vector<std::pair<int, float>>> found(size_t(planes.height()));
        for_rows(threads, planes.height(), [&](int y) {
            for (int x = 0; x < planes.width(); ++x)
                if (std::isnan(planes.row(c, y)[x])) {
                    const Known known = cells.around(y, x);
                    const float value =
                        by == Missing::most ? known.most : float(known.sum / double(known.count));
                    found[size_t(y)].emplace_back(x, known.count > 0 ? value : fallback);
                }
        });
        for_rows(threads, planes.height(), [&](int y) {
            for (const auto &[x, value] : found[size_t(y)])
                planes.row(c, y)[x] = value;
        });
    }
}

} // namespace pathfold::core
