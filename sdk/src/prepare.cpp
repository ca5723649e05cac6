#include "prepare.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <map>
#include <numeric>

#include "demodulation.h"
#include "error.h"
#include "radiance.h"

namespace pathfold::core {
namespace {

constexpr int bin_size = 16;
constexpr double dark_bin = 1e-8; // of the bright level
constexpr double bright_bin = 16; // likewise: noise may leave most of a bin's light to few pixels
constexpr size_t outlying = 64;   // one in so many pixels of a bin, or bins, may be an outlier

constexpr double brightest = 1e30;    // and small enough for a sum of kernel taps in float32
constexpr double darkest_layer = 1e6; // below 0, after exposure: no difference of lights is so large

double luminance(float r, float g, float b) { return 0.212671 * r + 0.715160 * g + 0.072169 * b; }

/// Adds b to a, pixel by pixel.
void add(Planes &a, const Planes &b, Threads &threads) {
    for_rows(threads, a.height(), [&](int y) {
        for (int c = 0; c < a.channels(); ++c)
            std::transform(a.row(c, y), a.row(c, y) + a.width(), b.row(c, y), a.row(c, y),
                           std::plus<float>());
    });
}

/// Brings values up to `most`; what lies below `least` becomes 0 where that is not as far as `most`.
void cap(Signal &signal, float least, float most, Threads &threads, Mended &mended) {
    Planes &planes = signal.values;
    std::atomic<int64_t> capped{0}, negative{0};
    for_rows(threads, planes.height(), [&](int y) {
        bool usual = true;
        for (int c = 0; c < planes.channels(); ++c)
            usual = usual && all_within(planes.row(c, y), size_t(planes.width()), least, most);
        for (int x = 0; x < planes.width() && !usual; ++x) {
            bool above = false, below = false;
            for (int c = 0; c < planes.channels(); ++c)
                if (float &value = planes.row(c, y)[x]; value > most)
                    value = most, above = true;
                else if (value < least)
                    value = 0, below = true;
            capped += above, negative += below;
        }
    });
    tally(mended, signal.name, fault::capped, capped);
    tally(mended, signal.name, fault::negative, negative);
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

/// What the branch divides radiance by, at every pixel.
Planes load_factor(const Guides &guides, const std::string &buffer, float epsilon, int height, int width,
                   Threads &threads) {
    if (buffer.empty())
        return {};
    Planes factor(3, height, width);
    for_rows(threads, height, [&](int y) {
        std::vector<float> pixels(size_t(width) * 3);
        guides.load_row(buffer, y, 0, width, pixels.data());
        for (int c = 0; c < 3; ++c)
            for (int x = 0; x < width; ++x)
                factor.row(c, y)[x] = pixels[size_t(x) * 3 + c] + epsilon;
    });
    return factor;
}

/// Radiance is filtered undivided where its albedo does not explain it: that is flattened there.
void flatten_factors(const Frame &frame, const Reads &reads, Guides &guides, Prepared &prepared,
                     Threads &threads) {
    const int height = frame.height(), width = frame.width();
    for (size_t i = 0; i < reads.branches.size(); ++i) {
        const ActiveBranch &active = reads.branches[i];
        if (active.factor.empty())
            continue;
        const Doubts doubts =
            find_doubts(prepared.factors[i], prepared.signals[i].values, prepared.valid, threads);
        if (!doubts.any())
            continue;
        Planes albedo = load_factor(guides, active.factor, 0, height, width, threads);
        const int64_t pixels = flatten(albedo, doubts, active.branch->epsilon, threads);
        guides.replace(active.factor, std::move(albedo));
        prepared.factors[i] =
            load_factor(guides, active.factor, active.branch->epsilon, height, width, threads);
        if (pixels > 0)
            prepared.notes.push_back(text(active.factor, " does not explain the light in ", pixels,
                                          " pixels: it was filtered undivided there"));
    }
}

/// Where a split frame has a color too, its parts must add up to it. A color that is 0 everywhere says
/// nothing.
void compare_parts(const Frame &frame, std::map<std::string, Planes> &parts, Prepared &prepared,
                   Threads &threads) {
    if (!frame.has("color") || parts.size() < 2)
        return;
    const Planes color = load_radiance(frame.input("color"), threads);
    const float *values = color.row(0, 0);
    const size_t count = size_t(color.channels()) * color.height() * color.width();
    if (all_within(values, count, 0, 0)) {
        prepared.notes.push_back("color is 0 in every pixel: diffuse + specular is taken for it");
        return;
    }
    if (const int64_t pixels =
            make_parts_of(color, parts.at("diffuse"), parts.at("specular"), threads, prepared.mended))
        prepared.notes.push_back(text("diffuse + specular is not color in ", pixels,
                                      " pixels: specular was taken for what diffuse leaves of color; give "
                                      "parts that add up, or color alone"));
}

void add_branches(const Frame &frame, const Reads &reads, const Guides &guides, Prepared &prepared,
                  Threads &threads) {
    std::map<std::string, Planes> parts;
    for (const ActiveBranch &active : reads.branches)
        for (const std::string &part : active.parts)
            parts.emplace(part, load_radiance(frame.input(part), threads));
    if (reads.split)
        compare_parts(frame, parts, prepared, threads);
    for (auto &[name, radiance] : parts)
        sanitise_radiance(radiance, name, prepared.valid, threads, prepared.mended);
    for (const ActiveBranch &active : reads.branches) {
        const int index = int(prepared.factors.size());
        prepared.factors.push_back(load_factor(guides, active.factor, active.branch->epsilon, frame.height(),
                                               frame.width(), threads));
        Planes radiance = std::move(parts.at(active.parts[0]));
        for (size_t i = 1; i < active.parts.size(); ++i)
            add(radiance, parts.at(active.parts[i]), threads);
        prepared.signals.push_back({active.radiance, index, !active.factor.empty(), std::move(radiance)});
    }
}

/// Where the parts are not filtered apart after all, what is asked of them rides along.
void add_parts(const Frame &frame, const Reads &reads, Prepared &prepared, Threads &threads) {
    for (const char *part : {"diffuse", "specular"}) {
        if (reads.split || frame.outputs().count(part) == 0)
            continue;
        std::vector<uint8_t> unused(prepared.valid.size());
        Mended counted_with_color;
        Planes values = load_radiance(frame.input(part), threads);
        sanitise_radiance(values, part, unused, threads, counted_with_color);
        prepared.signals.push_back({part, 0, prepared.signals[0].demodulated, std::move(values)});
    }
}

Planes load_alpha(const Guides &guides, int height, int width, Threads &threads) {
    Planes alpha(1, height, width);
    for_rows(threads, height, [&](int y) { guides.load_row("alpha", y, 0, width, alpha.row(0, y)); });
    return alpha;
}

/// Layers ride along with the beauty: what is wrong with them masks nothing.
Planes load_layer(const Layer &layer, const std::string &part, Prepared &prepared, Threads &threads) {
    Planes values = load_radiance(layer.parts.at(part), threads);
    const float *first = values.row(0, 0);
    const int64_t unknown =
        std::count_if(first, first + prepared.valid.size(), [](float v) { return std::isnan(v); });
    tally(prepared.mended, layer.name, fault::rebuilt, unknown);
    if (unknown > 0)
        fill_unknown(values, Missing::mean, 0, threads);
    return values;
}

void add_layers(const Frame &frame, const Reads &reads, Prepared &prepared, Threads &threads) {
    for (const Layer &layer : frame.layers()) {
        // the beauty's own factor, so that layers add up to it
        const auto add_layer = [&](size_t branch, Planes values) {
            prepared.signals.push_back(
                {layer.name, int(branch), prepared.signals[branch].demodulated, std::move(values)});
        };
        if (reads.split) {
            for (size_t i = 0; i < reads.branches.size(); ++i)
                add_layer(i, load_layer(layer, reads.branches[i].radiance, prepared, threads));
            continue;
        }
        auto part = layer.parts.begin();
        Planes values = load_layer(layer, part->first, prepared, threads);
        if (++part != layer.parts.end())
            add(values, load_layer(layer, part->first, prepared, threads), threads);
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

float brightest_shown(float exposure) { return float(brightest / double(exposure)); }

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
                            sum += luminance(std::max(part->row(0, y)[x], 0.0f),
                                             std::max(part->row(1, y)[x], 0.0f),
                                             std::max(part->row(2, y)[x], 0.0f));
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

Prepared prepare(const Frame &frame, const Reads &reads, Guides &guides, float exposure, float exposure_key,
                 Threads &threads) {
    Prepared prepared;
    prepared.mended = guides.mended();
    prepared.notes = guides.notes();
    prepared.depth_scale = guides.depth_scale();
    prepared.valid.assign(size_t(frame.width()) * size_t(frame.height()), 1);
    const auto start = std::chrono::steady_clock::now();
    add_branches(frame, reads, guides, prepared, threads);
    if (std::none_of(prepared.valid.begin(), prepared.valid.end(), [](uint8_t valid) { return valid != 0; }))
        prepared.notes.push_back("no pixel's radiance is finite: the picture is black");
    if (reads.has("alpha")) {
        const auto unsplit = std::find_if(reads.branches.begin(), reads.branches.end(),
                                          [](const ActiveBranch &active) { return active.branch->unsplit; });
        prepared.signals.push_back({"alpha", int(unsplit - reads.branches.begin()), false,
                                    load_alpha(guides, frame.height(), frame.width(), threads)});
    }
    add_parts(frame, reads, prepared, threads);
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
    const float most = float(std::min(brightest / std::min(double(prepared.exposure), 1.0), 1e32));
    const float layers_least = float(std::max(-darkest_layer / double(prepared.exposure), -double(most)));
    for (size_t i = 0; i < prepared.signals.size(); ++i) {
        const bool layer = i >= reads.branches.size();
        cap(prepared.signals[i], layer ? layers_least : -most, most, threads, prepared.mended);
    }
    flatten_factors(frame, reads, guides, prepared, threads);
    return prepared;
}

} // namespace pathfold::core
