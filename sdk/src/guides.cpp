#include "guides.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>

#include <oneapi/tbb/combinable.h>

#include "error.h"

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float rounding = 1.001f; // a value that is above 1 by less is not worth a word

bool is_variance(const std::string &buffer) {
    return buffer == "variance" || (buffer.size() > 9 && buffer.substr(buffer.size() - 9) == ".variance");
}

/// Pixels by what is wrong with them.
struct Faults {
    int64_t unknown = 0, negative = 0, above = 0;

    void operator+=(const Faults &other) {
        unknown += other.unknown, negative += other.negative, above += other.above;
    }
};

/// Brings interleaved pixels into their range; what is not known becomes 0 or, where neighbours stand for it,
/// NaN.
Faults set_right(float *pixels, int count, int channels, const Meaning &meaning) {
    Faults faults;
    const Range range = meaning.range;
    if (all_within(pixels, size_t(count) * channels, range.least, range.most))
        return faults;
    for (int i = 0; i < count; ++i) {
        bool unknown = false, negative = false, above = false;
        for (float *value = pixels + size_t(i) * channels, *end = value + channels; value != end; ++value) {
            if (!std::isfinite(*value) || (meaning.open && *value > range.most)) {
                *value = meaning.missing == Missing::zero ? 0 : nan;
                unknown = true;
                continue;
            }
            negative |= *value < range.least && range.least == 0;
            above |= std::abs(*value) > rounding * range.most;
            *value = std::clamp(*value, range.least, range.most);
        }
        faults.unknown += unknown;
        faults.negative += negative;
        faults.above += above && !unknown && !negative;
    }
    return faults;
}

/// Whether pixels hold values other than `first`; what is NaN says nothing.
bool differ(const float *pixels, int count, int channels, const std::vector<float> &first) {
    const auto other = [&](size_t i) { return !std::isnan(pixels[i]) & (pixels[i] != first[i % channels]); };
    for (size_t i = 0; i < size_t(channels); ++i)
        if (other(i))
            return true;
    uint32_t changes = 0;
    const size_t all = size_t(count) * channels;
    for (size_t i = channels; i < all; ++i) // as vectors
        changes |= uint32_t(pixels[i] != pixels[i - channels]);
    if (changes == 0)
        return false;
    for (size_t i = 0; i < all; ++i)
        if (other(i))
            return true;
    return false;
}

/// Counts that tell normals from those stored as 0.5 n + 0.5.
struct Encoding {
    int64_t signed_pixels = 0, hits = 0, plain = 0, near = 0, longer = 0;

    void add(const float *pixels, int count) {
        constexpr float slack = 0.01f, nearly = 0.9f * 0.9f, above = 1.1f * 1.1f, too_long = 1.05f * 1.05f;
        for (int i = 0; i < count; ++i) {
            const float x = pixels[3 * i], y = pixels[3 * i + 1], z = pixels[3 * i + 2];
            const float u = 2 * x - 1, v = 2 * y - 1, w = 2 * z - 1;
            const float square = x * x + y * y + z * z, decoded = u * u + v * v + w * w;
            signed_pixels += std::min({x, y, z}) < -slack;
            const bool hit = square > slack && decoded > slack;
            hits += hit;
            plain += hit && square > nearly && square < above;
            near += hit && decoded > nearly;
            longer += hit && decoded > too_long;
        }
    }
    void operator+=(const Encoding &other) {
        signed_pixels += other.signed_pixels, hits += other.hits;
        plain += other.plain, near += other.near, longer += other.longer;
    }
    /// As they stand nearly none is negative and not all are unit vectors; decoded, none is longer than one,
    /// as no mean of unit vectors is, and some are as long.
    bool holds(int64_t pixels) const {
        return signed_pixels * 1000 <= pixels && hits > 0 && longer * 100 <= hits && near * 5 >= hits &&
               plain * 10 < hits * 9;
    }
};

/// What one pass over a buffer finds.
struct Look {
    Faults faults;
    Encoding encoding;
    bool varies = false;
    std::vector<double> logs; ///< of depths, per row
    std::vector<int64_t> hits;
};

/// A background of 0 stays one.
void decode_normals(float *pixels, int count) {
    for (float *n = pixels, *end = n + size_t(count) * 3; n != end; n += 3)
        if (n[0] != 0 || n[1] != 0 || n[2] != 0)
            for (int c = 0; c < 3; ++c)
                n[c] = 2 * n[c] - 1;
}

/// The first known value of each channel, NaN where there is none.
std::vector<float> first_known(const ImageView &view, const Meaning &meaning) {
    std::vector<float> first(size_t(view.channels()), nan), row(size_t(view.width()) * view.channels());
    for (int y = 0; y < view.height(); ++y) {
        view.load_row(0, y, 0, view.width(), row.data());
        set_right(row.data(), view.width(), view.channels(), meaning);
        for (size_t i = 0; i < row.size(); ++i)
            if (float &value = first[i % first.size()]; std::isnan(value))
                value = row[i];
        if (std::none_of(first.begin(), first.end(), [](float value) { return std::isnan(value); }))
            break;
    }
    return first;
}

void add_depths(const float *row, int width, double &logs, int64_t &hits) {
    for (int x = 0; x < width; ++x)
        if (row[x] > 0)
            logs += std::log(double(row[x])), ++hits;
}

/// exp(-mean(ln depth)) over what is no miss, a normal float; 1 where there is none.
float find_depth_scale(const Look &look) {
    double logs = 0;
    int64_t hits = 0;
    for (size_t y = 0; y < look.logs.size(); ++y)
        logs += look.logs[y], hits += look.hits[y];
    return hits > 0 ? float(std::clamp(std::exp(-logs / double(hits)), 1e-37, 1e37)) : 1.0f;
}

Look look_at(const ImageView &view, const std::string &buffer, const std::vector<float> &first,
             Threads &threads) {
    struct Part {
        Faults faults;
        Encoding encoding;
        std::vector<float> row;
    };
    const int width = view.width(), channels = view.channels();
    const Meaning meaning = meaning_of(buffer);
    const bool depth = buffer == "depth", normal = buffer == "normal";
    const int64_t few = int64_t(width) * view.height() / 1000;
    std::atomic<bool> varies{false};
    std::atomic<int64_t> signed_pixels{0};
    oneapi::tbb::combinable<Part> parts;
    Look look;
    look.logs.resize(depth ? size_t(view.height()) : 0);
    look.hits.resize(look.logs.size());
    for_rows(threads, view.height(), [&](int y) {
        Part &part = parts.local();
        part.row.resize(size_t(width) * channels);
        view.load_row(0, y, 0, width, part.row.data());
        part.faults += set_right(part.row.data(), width, channels, meaning);
        if (!varies.load(std::memory_order_relaxed) && differ(part.row.data(), width, channels, first))
            varies = true;
        if (normal && signed_pixels.load(std::memory_order_relaxed) <= few) { // else they are not encoded
            Encoding encoding;
            encoding.add(part.row.data(), width);
            signed_pixels += encoding.signed_pixels;
            part.encoding += encoding;
        }
        if (depth)
            add_depths(part.row.data(), width, look.logs[size_t(y)], look.hits[size_t(y)]);
    });
    parts.combine_each([&](const Part &part) { look.faults += part.faults, look.encoding += part.encoding; });
    look.varies = varies;
    return look;
}

std::string value_text(const std::vector<float> &value) {
    if (std::all_of(value.begin(), value.end(), [&](float one) { return one == value[0]; }))
        return text(value[0]);
    return text("(", value[0], ", ", value[1], ", ", value[2], ")");
}

/// Why a buffer says nothing; empty where it does.
std::string find_silence(const Look &look, const std::string &buffer, const std::vector<float> &first,
                         int64_t pixels) {
    if (std::any_of(first.begin(), first.end(), [](float value) { return std::isnan(value); }))
        return "is not finite in any pixel";
    if (is_variance(buffer) && look.faults.unknown * 2 > pixels)
        return text("is not finite in ", look.faults.unknown, " of ", pixels, " pixels");
    return look.varies ? "" : "is " + value_text(first) + " in every pixel";
}

const char *unknown_fault(const std::string &buffer) {
    if (is_variance(buffer))
        return fault::unknown;
    return buffer == "depth" ? fault::miss : buffer == "normal" ? fault::none : fault::rebuilt;
}

} // namespace

Guides::Guides(const Frame &frame, const Reads &reads, const std::vector<std::string> &required,
               Threads &threads)
    : frame_(frame) {
    look_at_all(reads, required, threads);
}

void Guides::look_at_all(const Reads &reads, const std::vector<std::string> &required, Threads &threads) {
    for (const std::string &buffer : reads.buffers)
        if ((find_guide(buffer) != nullptr || is_variance(buffer) || buffer == "alpha") &&
            looked_at_.insert(buffer).second)
            look(buffer, std::count(required.begin(), required.end(), buffer) > 0, threads);
}

void Guides::look(const std::string &buffer, bool required, Threads &threads) {
    const ImageView &view = frame_.input(buffer);
    const int64_t pixels = int64_t(view.width()) * view.height();
    const Meaning meaning = meaning_of(buffer);
    const std::vector<float> first = first_known(view, meaning);
    const Look found = look_at(view, buffer, first, threads);
    const std::string silence = find_silence(found, buffer, first, pixels);
    if (!silence.empty() && !required && buffer != "alpha") { // which is filtered, not looked at
        silent_.insert(buffer);
        notes_.push_back(buffer + " " + silence + ": not used");
        return;
    }
    tally(mended_, buffer, unknown_fault(buffer), found.faults.unknown);
    tally(mended_, buffer, fault::negative, found.faults.negative);
    tally(mended_, buffer, buffer == "normal" ? fault::beyond : fault::above, found.faults.above);
    if (found.faults.unknown > 0 && meaning.missing != Missing::zero)
        rebuild(buffer, threads);
    if (buffer == "depth")
        depth_scale_ = find_depth_scale(found);
    if (buffer == "normal" && found.encoding.holds(pixels)) {
        encoded_ = true;
        notes_.push_back("normal is stored as 0.5 n + 0.5: decoded");
    }
}

void Guides::rebuild(const std::string &buffer, Threads &threads) {
    const ImageView &view = frame_.input(buffer);
    const Meaning meaning = meaning_of(buffer);
    Planes planes(view.channels(), view.height(), view.width());
    for_rows(threads, view.height(), [&](int y) {
        const int channels = view.channels(), width = view.width();
        std::vector<float> row(size_t(width) * channels);
        view.load_row(0, y, 0, width, row.data());
        set_right(row.data(), width, channels, meaning);
        for (int c = 0; c < channels; ++c)
            for (int x = 0; x < width; ++x)
                planes.row(c, y)[x] = row[size_t(x) * channels + c];
    });
    fill_unknown(planes, meaning.missing, 1.0f, threads);
    rebuilt_.insert_or_assign(buffer, std::move(planes));
}

void Guides::load_row(const std::string &buffer, int y, int x, int count, float *out) const {
    if (const auto found = rebuilt_.find(buffer); found != rebuilt_.end()) {
        const Planes &planes = found->second;
        const int channels = planes.channels();
        for (int c = 0; c < channels; ++c)
            for (int i = 0; i < count; ++i)
                out[size_t(i) * channels + c] = planes.row(c, y)[x + i];
        return;
    }
    const ImageView &view = frame_.input(buffer);
    view.load_row(0, y, x, count, out);
    set_right(out, count, view.channels(), meaning_of(buffer));
    if (encoded_ && buffer == "normal")
        decode_normals(out, count);
}

} // namespace pathfold::core
