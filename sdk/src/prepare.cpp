#include "prepare.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>

#include <oneapi/tbb/combinable.h>

#include "error.h"

namespace pathfold::core {
namespace {

constexpr int bin_size = 16;
constexpr double dark_bin = 1e-8; // of the bright level
constexpr double bright_bin = 16; // likewise: noise may leave most of a bin's light to few pixels
constexpr size_t outlying = 64;   // one in so many pixels of a bin, or bins, may be an outlier

/// Largest radiance: 1e30 after exposure, and small enough for a sum of kernel taps in float32.
float radiance_cap(float exposure) { return float(std::min(1e30 / double(exposure), 1e32)); }

double luminance(float r, float g, float b) { return 0.212671 * r + 0.715160 * g + 0.072169 * b; }

using RowCounts = oneapi::tbb::combinable<Counts>;

Counts total(RowCounts &counts) {
    Counts sum;
    counts.combine_each([&](const Counts &part) { sum += part; });
    return sum;
}

/// Reads a view into planes, row by row, through `clean(pixels, y, counts)`.
template <typename Clean>
Planes load(const ImageView &view, Threads &threads, Counts &counts, const Clean &clean) {
    Planes planes(view.channels(), view.height(), view.width());
    RowCounts row_counts;
    for_rows(threads, view.height(), [&](int y) {
        const int channels = view.channels(), width = view.width();
        std::vector<float> pixels(size_t(width) * size_t(channels));
        view.load_row(0, y, 0, width, pixels.data());
        clean(pixels.data(), y, row_counts.local());
        for (int c = 0; c < channels; ++c)
            for (int x = 0; x < width; ++x)
                planes.row(c, y)[x] = pixels[size_t(x) * channels + c];
    });
    counts += total(row_counts);
    return planes;
}

/// Interleaved pixels of one row, in place.
void sanitise_radiance(float *pixels, int count, int channels, bool keeps_sign, uint8_t *valid,
                       Counts &counts) {
    for (int i = 0; i < count; ++i) {
        float *pixel = pixels + size_t(i) * channels;
        if (!std::all_of(pixel, pixel + channels, [](float value) { return std::isfinite(value); })) {
            std::fill_n(pixel, channels, 0.0f);
            valid[i] = 0;
            ++counts.non_finite;
            continue;
        }
        bool negative = false;
        for (int c = 0; c < channels && !keeps_sign; ++c)
            if (pixel[c] < 0)
                pixel[c] = 0, negative = true;
        counts.negative += negative;
    }
}

/// Adds b to a, pixel by pixel.
void add(Planes &a, const Planes &b, Threads &threads) {
    for_rows(threads, a.height(), [&](int y) {
        for (int c = 0; c < a.channels(); ++c)
            std::transform(a.row(c, y), a.row(c, y) + a.width(), b.row(c, y), a.row(c, y),
                           std::plus<float>());
    });
}

void cap(Planes &planes, float most, Threads &threads, Counts &counts) {
    RowCounts row_counts;
    for_rows(threads, planes.height(), [&](int y) {
        for (int x = 0; x < planes.width(); ++x) {
            bool capped = false;
            for (int c = 0; c < planes.channels(); ++c)
                if (float &value = planes.row(c, y)[x]; std::abs(value) > most)
                    value = std::copysign(most, value), capped = true;
            row_counts.local().capped += capped;
        }
    });
    counts += total(row_counts);
}

/// What the exposure wants to know of 16 x 16 pixels: their mean luminance, with and without the brightest
/// few.
struct Bin {
    double mean = 0, robust = 0;
};

Bin summarise(std::vector<double> &pixels) {
    if (pixels.empty())
        return {};
    const size_t kept = pixels.size() - (pixels.size() + outlying - 1) / outlying;
    std::nth_element(pixels.begin(), pixels.begin() + kept, pixels.end());
    const double most = std::accumulate(pixels.begin(), pixels.begin() + kept, 0.0);
    const double sum = std::accumulate(pixels.begin() + kept, pixels.end(), most);
    return {sum / double(pixels.size()), kept > 0 ? most / double(kept) : 0};
}

/// How bright the image is where it is bright, outliers apart.
double bright_level(const std::vector<Bin> &bins) {
    std::vector<double> levels;
    double largest = 0;
    for (const Bin &bin : bins) {
        if (bin.robust > 0)
            levels.push_back(bin.robust);
        largest = std::max(largest, bin.mean);
    }
    if (levels.empty())
        return largest;
    const auto at = levels.end() - 1 - std::ptrdiff_t(levels.size() / outlying);
    std::nth_element(levels.begin(), at, levels.end());
    return *at;
}

/// Keeps a factor a normal float, whatever the image.
float within_floats(double factor) { return float(std::clamp(factor, 1e-37, 1e37)); }

/// exp(-mean(ln depth)) over finite depths > 0; 1 where there is none.
float find_depth_scale(const ImageView &depth, Threads &threads) {
    struct Sum {
        double logs = 0;
        int64_t count = 0;
    };
    std::vector<Sum> sums(size_t(depth.height()));
    for_rows(threads, depth.height(), [&](int y) {
        std::vector<float> row(size_t(depth.width()));
        depth.load_row(0, y, 0, depth.width(), row.data());
        for (float value : row)
            if (value > 0 && std::isfinite(value))
                sums[size_t(y)].logs += std::log(double(value)), ++sums[size_t(y)].count;
    });
    Sum all;
    for (const Sum &sum : sums)
        all.logs += sum.logs, all.count += sum.count;
    return all.count > 0 ? within_floats(std::exp(-all.logs / double(all.count))) : 1.0f;
}

/// What the branch divides radiance by, at every pixel.
Planes load_factor(const Frame &frame, const ActiveBranch &active, Threads &threads) {
    if (active.factor.empty())
        return {};
    Counts counted_by_packer;
    const ImageView &view = frame.input(active.factor);
    return load(view, threads, counted_by_packer, [&](float *pixels, int, Counts &) {
        sanitise_guide(pixels, view.width(), view.channels(), guide_range(active.factor));
        for (int i = 0; i < view.width() * view.channels(); ++i)
            pixels[i] += active.branch->epsilon;
    });
}

void add_branches(const Frame &frame, const Reads &reads, Prepared &prepared, Threads &threads) {
    const auto load_buffer = [&](const std::string &name) {
        return load_radiance(frame.input(name), false, prepared.valid, threads, prepared.counts);
    };
    for (const ActiveBranch &active : reads.branches) {
        const int index = int(prepared.factors.size());
        prepared.factors.push_back(load_factor(frame, active, threads));
        Planes radiance = load_buffer(active.parts[0]);
        for (size_t i = 1; i < active.parts.size(); ++i)
            add(radiance, load_buffer(active.parts[i]), threads);
        prepared.signals.push_back(
            {active.radiance, index, !active.factor.empty(), false, std::move(radiance)});
    }
}

/// Alpha and layers ride along with the beauty: what is wrong with them masks nothing.
Planes load_rider(const ImageView &view, bool keeps_sign, Prepared &prepared, Threads &threads) {
    std::vector<uint8_t> unused(prepared.valid.size());
    return load_radiance(view, keeps_sign, unused, threads, prepared.counts);
}

void add_layers(const Frame &frame, const Reads &reads, Prepared &prepared, Threads &threads) {
    for (const Layer &layer : frame.layers()) {
        // the beauty's own factor, so that layers add up to it
        const auto add_layer = [&](size_t branch, Planes values) {
            prepared.signals.push_back(
                {layer.name, int(branch), prepared.signals[branch].demodulated, true, std::move(values)});
        };
        if (reads.split) {
            for (size_t i = 0; i < reads.branches.size(); ++i)
                add_layer(i, load_rider(layer.parts.at(reads.branches[i].radiance), true, prepared, threads));
            continue;
        }
        auto part = layer.parts.begin();
        Planes values = load_rider(part->second, true, prepared, threads);
        if (++part != layer.parts.end())
            add(values, load_rider(part->second, true, prepared, threads), threads);
        add_layer(0, std::move(values));
    }
}

/// A pixel that one part of the beauty masks is masked in all of them.
void clear_masked(Prepared &prepared, Threads &threads) {
    for (Signal &signal : prepared.signals)
        for_rows(threads, signal.values.height(), [&](int y) {
            const uint8_t *valid = prepared.valid.data() + size_t(y) * signal.values.width();
            for (int c = 0; c < signal.values.channels(); ++c)
                for (int x = 0; x < signal.values.width(); ++x)
                    if (valid[x] == 0)
                        signal.values.row(c, y)[x] = 0;
        });
}

} // namespace

Counts &Counts::operator+=(const Counts &other) {
    non_finite += other.non_finite;
    negative += other.negative;
    capped += other.capped;
    samples_dropped += other.samples_dropped;
    repaired += other.repaired;
    return *this;
}

Counts sanitise_guide(float *pixels, int count, int channels, Range range) {
    Counts counts;
    for (int i = 0; i < count; ++i) {
        bool non_finite = false, negative = false;
        for (float *value = pixels + size_t(i) * channels, *end = value + channels; value != end; ++value) {
            if (!std::isfinite(*value))
                *value = 0, non_finite = true;
            negative = negative || (*value < 0 && range.least == 0);
            *value = std::clamp(*value, range.least, range.most);
        }
        counts.non_finite += non_finite;
        counts.negative += negative;
    }
    return counts;
}

Planes load_radiance(const ImageView &view, bool keeps_sign, std::vector<uint8_t> &valid, Threads &threads,
                     Counts &counts) {
    return load(view, threads, counts, [&](float *pixels, int y, Counts &row_counts) {
        sanitise_radiance(pixels, view.width(), view.channels(), keeps_sign,
                          valid.data() + size_t(y) * view.width(), row_counts);
    });
}

float auto_exposure(const std::vector<const Planes *> &parts, const std::vector<uint8_t> &valid, float key,
                    Threads &threads) {
    const int width = parts[0]->width(), height = parts[0]->height();
    const int across = (width + bin_size - 1) / bin_size, down = (height + bin_size - 1) / bin_size;
    std::vector<Bin> bins(size_t(across) * size_t(down));
    for_rows(threads, down, [&](int j) {
        std::vector<double> pixels;
        for (int i = 0; i < across; ++i) {
            // Bins of equal size, the way OIDN cuts them, rather than a narrow last one.
            pixels.clear();
            for (int y = int(int64_t(j) * height / down); y < int64_t(j + 1) * height / down; ++y)
                for (int x = int(int64_t(i) * width / across); x < int64_t(i + 1) * width / across; ++x)
                    if (valid[size_t(y) * width + x] != 0) {
                        double sum = 0;
                        for (const Planes *part : parts)
                            sum += luminance(part->row(0, y)[x], part->row(1, y)[x], part->row(2, y)[x]);
                        pixels.push_back(sum);
                    }
            bins[size_t(j) * across + i] = summarise(pixels);
        }
    });
    const double bright = bright_level(bins);
    double logs = 0;
    int64_t count = 0;
    for (const Bin &bin : bins)
        if (bin.mean > dark_bin * bright)
            logs += std::log2(std::min(bin.mean, bright_bin * bright)), ++count;
    if (count == 0)
        return 1.0f;
    return within_floats(key / std::exp2(logs / double(count)));
}

Prepared prepare(const Frame &frame, const Reads &reads, float exposure, float exposure_key,
                 Threads &threads) {
    Prepared prepared;
    prepared.valid.assign(size_t(frame.width()) * size_t(frame.height()), 1);
    const auto start = std::chrono::steady_clock::now();
    add_branches(frame, reads, prepared, threads);
    if (reads.has("alpha")) {
        const auto unsplit = std::find_if(reads.branches.begin(), reads.branches.end(),
                                          [](const ActiveBranch &active) { return active.branch->unsplit; });
        prepared.signals.push_back({"alpha", int(unsplit - reads.branches.begin()), false, false,
                                    load_rider(frame.input("alpha"), false, prepared, threads)});
    }
    add_layers(frame, reads, prepared, threads);
    prepared.load_ms =
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    for (const Signal &signal : prepared.signals)
        prepared.loaded += double(signal.values.channels()) * frame.width() * frame.height();
    clear_masked(prepared, threads);

    prepared.exposure = exposure;
    if (exposure <= 0) {
        std::vector<const Planes *> parts;
        for (size_t i = 0; i < reads.branches.size(); ++i)
            parts.push_back(&prepared.signals[i].values);
        prepared.exposure = auto_exposure(parts, prepared.valid, exposure_key, threads);
    }
    for (Signal &signal : prepared.signals)
        cap(signal.values, radiance_cap(prepared.exposure), threads, prepared.counts);
    if (reads.has("depth"))
        prepared.depth_scale = find_depth_scale(frame.input("depth"), threads);
    return prepared;
}

} // namespace pathfold::core
