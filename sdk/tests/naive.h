// What the SDK does, written again as plainly as can be, in double: what tests compare with.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "testing.h"

namespace pathfold::core {

/// Softmax over the taps inside the image whose values are finite; logits [tap][y][x], and where there is one
/// more plane, what each pixel adds to the logits of the taps that fall on it.
inline Pixels naive_gather(const Pixels &image, const std::vector<float> &logits, int size) {
    const int radius = size / 2, height = image.height, width = image.width;
    const size_t pixels = size_t(height) * width, kernels = pixels * size * size;
    const auto shift = [&](int y, int x) {
        return logits.size() > kernels ? double(logits[kernels + size_t(y) * width + x]) : 0.0;
    };
    Pixels result(height, width, image.channels);
    const auto finite = [&](int y, int x) {
        for (int c = 0; c < image.channels; ++c)
            if (!std::isfinite(image.at(y, x, c)))
                return false;
        return true;
    };
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            std::vector<std::pair<double, std::pair<int, int>>> taps;
            for (int t = 0; t < size * size; ++t) {
                const int v = y + t / size - radius, u = x + t % size - radius;
                if (v >= 0 && v < height && u >= 0 && u < width && finite(v, u))
                    taps.push_back({logits[(size_t(t) * height + y) * width + x] + shift(v, u), {v, u}});
            }
            if (taps.empty())
                continue;
            const double largest = std::max_element(taps.begin(), taps.end())->first;
            double sum = 0;
            std::vector<double> total(size_t(image.channels));
            for (const auto &[logit, at] : taps) {
                const double weight = std::exp(logit - largest);
                sum += weight;
                for (int c = 0; c < image.channels; ++c)
                    total[size_t(c)] += weight * image.at(at.first, at.second, c);
            }
            for (int c = 0; c < image.channels; ++c)
                result.at(y, x, c) = float(total[size_t(c)] / sum);
        }
    return result;
}

/// Expects equal pixels, up to `tolerance` relative to the largest value of the channel's own pixel or 1e-3
/// of the image's mean, whichever is larger.
inline void expect_near(const Pixels &given, const Pixels &right, double tolerance) {
    ASSERT_EQ(given.values.size(), right.values.size());
    double mean = 0;
    for (float value : right.values)
        mean += std::abs(double(value)) / double(right.values.size());
    double worst = 0;
    for (size_t i = 0; i < right.values.size(); ++i) {
        const double scale = std::max(std::abs(double(right.values[i])), 1e-3 * mean + 1e-30);
        worst = std::max(worst, std::abs(double(given.values[i]) - right.values[i]) / scale);
        ASSERT_TRUE(std::isfinite(given.values[i])) << "value " << i;
    }
    EXPECT_LE(worst, tolerance);
}

} // namespace pathfold::core
