#include "demodulation.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

namespace pathfold::core {
namespace {

constexpr int cell = Doubts::cell, reach = 2; // pixels, cells
constexpr int strip = 32;                     // rows of cells that are worked on at a time
constexpr double doubt = 2, explains = 0.5, flat = 1e-4, dark_channel = 0.05;

/// Sums over pixels, per channel: of the factor a, the radiance l and l / a.
struct Sums {
    double n = 0;
    std::array<double, 3> a{}, aa{}, l{}, ll{}, al{}, d{}, dd{};

    void add(int c, double factor, double light) {
        const double divided = light / factor;
        a[c] += factor, aa[c] += factor * factor, al[c] += factor * light;
        l[c] += light, ll[c] += light * light;
        d[c] += divided, dd[c] += divided * divided;
    }
    void operator+=(const Sums &other) {
        n += other.n;
        for (int c = 0; c < 3; ++c) {
            a[c] += other.a[c], aa[c] += other.aa[c], al[c] += other.al[c];
            l[c] += other.l[c], ll[c] += other.ll[c];
            d[c] += other.d[c], dd[c] += other.dd[c];
        }
    }
};

/// Variance over the squared mean, of all channels.
double relative(const std::array<double, 3> &sum, const std::array<double, 3> &squares, double n) {
    double variance = 0, level = 0;
    for (int c = 0; c < 3; ++c) {
        const double mean = sum[c] / n;
        variance += std::max(squares[c] / n - mean * mean, 0.0);
        level += mean * mean;
    }
    return level > 0 ? variance / level : 0;
}

/// A window about a cell: its sums, and how the light follows the factor in it.
class Window {
public:
    explicit Window(const Sums &sums) : sums_(sums) {
        const double all = (sums.l[0] + sums.l[1] + sums.l[2]) / (3 * sums.n);
        for (int c = 0; c < 3; ++c) {
            a_[c] = sums.a[c] / sums.n, l_[c] = sums.l[c] / sums.n;
            scale_[c] = std::max(l_[c], dark_channel * all);
            spread_ += std::max(sums.aa[c] / sums.n / (a_[c] * a_[c]) - 1, 0.0);
        }
    }

    /// Takes in a cell: by how much its light follows the factor more than with a slope of 1.
    void add(const Sums &part) {
        if (part.n == 0)
            return;
        double excess = 0;
        for (int c = 0; c < 3; ++c) {
            if (scale_[c] <= 0)
                continue;
            const double a = a_[c], l = l_[c];
            excess += (part.al[c] - a * part.l[c] - l * part.a[c] + part.n * a * l) / (a * scale_[c]) -
                      (part.aa[c] - 2 * a * part.a[c] + part.n * a * a) / (a * a);
        }
        total_ += excess, squares_ += excess * excess, ++count_;
    }

    double share() const {
        const double error = std::sqrt(std::max(squares_ - total_ * total_ / count_, 0.0));
        const double slope = 1 + (total_ + doubt * error) / sums_.n / (spread_ + flat);
        const double unexplained = std::clamp((explains - slope) / explains, 0.0, 1.0);
        const double worse =
            (relative(sums_.d, sums_.dd, sums_.n) + flat) / (relative(sums_.l, sums_.ll, sums_.n) + flat);
        return unexplained * std::clamp(std::log2(worse), 0.0, 1.0);
    }

private:
    const Sums &sums_;
    std::array<double, 3> a_{}, l_{}, scale_{};
    double spread_ = 0, total_ = 0, squares_ = 0, count_ = 0;
};

int cells(int pixels) { return (pixels + cell - 1) / cell; }

/// A row of cells.
std::vector<Sums> sum_cells(const Planes &factor, const Planes &radiance, const std::vector<uint8_t> &valid,
                            int row) {
    const int width = factor.width();
    std::vector<Sums> sums(size_t(cells(width)));
    for (int y = row * cell; y < std::min((row + 1) * cell, factor.height()); ++y)
        for (int x = 0; x < width; ++x) {
            if (valid[size_t(y) * width + x] == 0)
                continue;
            Sums &at = sums[size_t(x / cell)];
            ++at.n;
            for (int c = 0; c < 3; ++c)
                at.add(c, factor.row(c, y)[x], std::max(radiance.row(c, y)[x], 0.0f));
        }
    return sums;
}

using Rows = std::vector<std::vector<Sums>>;

/// The cell (i, j) of `rows`, whose first one is the frame's `top`.
void judge(const Rows &rows, int top, int i, int j, Doubts &doubts) {
    const int across = doubts.share.width();
    const auto each = [&](const auto &visit) {
        for (int y = std::max(j - reach, top); y <= std::min(j + reach, top + int(rows.size()) - 1); ++y)
            for (int x = std::max(i - reach, 0); x <= std::min(i + reach, across - 1); ++x)
                visit(rows[size_t(y - top)][size_t(x)]);
    };
    Sums sums;
    each([&](const Sums &part) { sums += part; });
    if (sums.n == 0)
        return;
    Window window(sums);
    each([&](const Sums &part) { window.add(part); });
    doubts.share.row(0, j)[i] = float(window.share());
    for (int c = 0; c < 3; ++c)
        doubts.level.row(c, j)[i] = float(sums.a[c] / sums.n);
}

/// Where a pixel lies between the centres of two cells.
struct Between {
    int low, high;
    float part;

    Between(int pixel, int count) {
        const float at = std::clamp((float(pixel) + 0.5f) / cell - 0.5f, 0.0f, float(count - 1));
        low = int(at), high = std::min(low + 1, count - 1), part = at - float(low);
    }
};

float mix(const Planes &planes, int channel, const Between &y, const Between &x) {
    const float *above = planes.row(channel, y.low), *below = planes.row(channel, y.high);
    const float top = above[x.low] + x.part * (above[x.high] - above[x.low]);
    return top + y.part * (below[x.low] + x.part * (below[x.high] - below[x.low]) - top);
}

} // namespace

bool Doubts::any() const {
    const float *first = share.row(0, 0), *last = first + size_t(share.height()) * share.width();
    return std::any_of(first, last, [](float value) { return value > 0; });
}

Doubts find_doubts(const Planes &factor, const Planes &radiance, const std::vector<uint8_t> &valid,
                   Threads &threads) {
    const int down = cells(factor.height()), across = cells(factor.width());
    Doubts doubts{Planes(1, down, across), Planes(3, down, across)};
    for_rows(threads, (down + strip - 1) / strip, [&](int part) {
        const int first = part * strip, last = std::min(first + strip, down);
        const int top = std::max(first - reach, 0), bottom = std::min(last + reach, down);
        Rows rows;
        for (int j = top; j < bottom; ++j)
            rows.push_back(sum_cells(factor, radiance, valid, j));
        for (int j = first; j < last; ++j)
            for (int i = 0; i < across; ++i)
                judge(rows, top, i, j, doubts);
    });
    return doubts;
}

int64_t flatten(Planes &albedo, const Doubts &doubts, float epsilon, Threads &threads) {
    std::atomic<int64_t> changed{0};
    std::vector<Between> columns;
    for (int x = 0; x < albedo.width(); ++x)
        columns.emplace_back(x, doubts.share.width());
    for_rows(threads, albedo.height(), [&](int y) {
        const Between row(y, doubts.share.height());
        int64_t count = 0;
        for (int x = 0; x < albedo.width(); ++x) {
            const float share = mix(doubts.share, 0, row, columns[size_t(x)]);
            if (share <= 0)
                continue;
            count += share > 0.5f;
            for (int c = 0; c < 3; ++c) {
                float &value = albedo.row(c, y)[x];
                value += share * (mix(doubts.level, c, row, columns[size_t(x)]) - epsilon - value);
                value = std::max(value, 0.0f); // levels are means, rounded
            }
        }
        changed += count;
    });
    return changed;
}

} // namespace pathfold::core
