#include "radiance.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN(), largest = std::numeric_limits<float>::max();
constexpr float out_of_gamut = 2;      // spectral colours reach about 1.1 in BT.709
constexpr double rounding = 1.0 / 256; // of the parts' magnitudes: halves, and codecs that lose little

/// The least that a component may be beside the pixel's largest: below it is no colour, but negative light.
float least_component(const Planes &radiance, int y, int x) {
    float most = 0;
    for (int c = 0; c < radiance.channels(); ++c)
        most = std::max(most, radiance.row(c, y)[x]);
    return -out_of_gamut * most;
}

bool add_up(const Planes &color, const Planes &diffuse, const Planes &specular, int y, int x) {
    const float least_diffuse = least_component(diffuse, y, x),
                least_specular = least_component(specular, y, x);
    for (int c = 0; c < color.channels(); ++c) {
        const double whole = color.row(c, y)[x], one = diffuse.row(c, y)[x], other = specular.row(c, y)[x];
        const double slack = rounding * (std::abs(whole) + std::abs(one) + std::abs(other));
        const bool light = one >= least_diffuse && other >= least_specular; // what is none becomes 0 later
        if (!light || !(std::abs(one + other - whole) <= slack))
            return false;
    }
    return true;
}

} // namespace

Planes load_radiance(const ImageView &view, Threads &threads) {
    Planes planes(view.channels(), view.height(), view.width());
    for_rows(threads, view.height(), [&](int y) {
        const int channels = view.channels(), width = view.width();
        std::vector<float> pixels(size_t(width) * size_t(channels));
        view.load_row(0, y, 0, width, pixels.data());
        if (!all_within(pixels.data(), pixels.size(), -largest, largest))
            for (int x = 0; x < width; ++x)
                if (float *pixel = pixels.data() + size_t(x) * channels;
                    !all_within(pixel, size_t(channels), -largest, largest))
                    std::fill_n(pixel, channels, nan);
        for (int c = 0; c < channels; ++c)
            for (int x = 0; x < width; ++x)
                planes.row(c, y)[x] = pixels[size_t(x) * channels + c];
    });
    return planes;
}

void sanitise_radiance(Planes &radiance, const std::string &buffer, std::vector<uint8_t> &valid,
                       Threads &threads, Mended &mended) {
    const int channels = radiance.channels(), width = radiance.width();
    std::atomic<int64_t> masked{0}, negative{0};
    for_rows(threads, radiance.height(), [&](int y) {
        bool usual = true;
        for (int c = 0; c < channels; ++c)
            usual = usual && all_within(radiance.row(c, y), size_t(width), 0, largest);
        for (int x = 0; x < width && !usual; ++x) {
            const bool known = !std::isnan(radiance.row(0, y)[x]);
            const float least = least_component(radiance, y, x);
            bool below = false;
            for (int c = 0; c < channels; ++c)
                if (float &value = radiance.row(c, y)[x]; !known || value < least)
                    value = 0, below = true;
            valid[size_t(y) * width + x] &= uint8_t(known);
            masked += !known;
            negative += known && below;
        }
    });
    tally(mended, buffer, fault::rebuilt, masked);
    tally(mended, buffer, fault::negative, negative);
}

int64_t make_parts_of(const Planes &color, Planes &diffuse, Planes &specular, Threads &threads,
                      Mended &mended) {
    std::atomic<int64_t> pixels{0};
    for_rows(threads, color.height(), [&](int y) {
        for (int x = 0; x < color.width(); ++x) {
            if (std::isnan(color.row(0, y)[x]) || add_up(color, diffuse, specular, y, x))
                continue;
            ++pixels;
            for (int c = 0; c < color.channels(); ++c) {
                const float whole = color.row(c, y)[x];
                float &part = diffuse.row(c, y)[x];
                part = std::isnan(part) ? 0 : std::clamp(part, std::min(whole, 0.0f), std::max(whole, 0.0f));
                specular.row(c, y)[x] = whole - part;
            }
        }
    });
    tally(mended, "diffuse + specular", fault::apart, pixels);
    return pixels;
}

} // namespace pathfold::core
