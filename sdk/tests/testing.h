// Helpers that several tests share.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "error.h"
#include "pathfold/pathfold.h"

namespace pathfold::core {

/// Expects `body` to throw an Error of that status whose message holds every one of `words`.
template <typename Body, typename... Words>
void expect_error(pathfold_status status, const Body &body, const Words &...words) {
    try {
        body();
        ADD_FAILURE() << "no error";
    } catch (const Error &error) {
        EXPECT_EQ(error.status(), status) << error.what();
        for (const std::string &word : {std::string(words)...})
            EXPECT_NE(std::string(error.what()).find(word), std::string::npos)
                << "\"" << word << "\" is not in: " << error.what();
    }
}

/// A packed float image of our own.
struct Pixels {
    int height, width, channels;
    std::vector<float> values;

    Pixels(int h, int w, int c, float value = 0)
        : height(h), width(w), channels(c), values(size_t(h) * w * c, value) {}

    float &at(int y, int x, int c) { return values[(size_t(y) * width + x) * channels + c]; }
    float at(int y, int x, int c) const { return values[(size_t(y) * width + x) * channels + c]; }
    pathfold_image image() const {
        return pathfold_packed(const_cast<float *>(values.data()), PATHFOLD_FLOAT32, 1, height, width,
                               channels);
    }
};

/// Noise like a rendering's: mostly dark, some bright.
inline Pixels noise(int height, int width, int channels, unsigned seed, float scale = 1) {
    Pixels pixels(height, width, channels);
    std::mt19937 random(seed);
    std::exponential_distribution<float> draw(1);
    for (float &value : pixels.values)
        value = scale * draw(random) * draw(random);
    return pixels;
}

inline std::string model_folder(const std::string &name) { return std::string(TEST_MODELS) + "/" + name; }

inline std::string read_text(const std::filesystem::path &path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
}

/// A copy of a test model that a test may spoil.
class SpoiltModel {
public:
    explicit SpoiltModel(const std::string &name) {
        const auto *test = testing::UnitTest::GetInstance()->current_test_info();
        folder_ =
            std::filesystem::path(TEST_SCRATCH) / (std::string(test->test_suite_name()) + "." + test->name());
        std::filesystem::remove_all(folder_);
        std::filesystem::create_directories(folder_);
        for (const auto &entry : std::filesystem::directory_iterator(model_folder(name)))
            std::filesystem::copy(entry.path(), folder_);
    }

    std::string path() const { return folder_.string(); }
    std::string read(const std::string &file) const { return read_text(folder_ / file); }
    void write(const std::string &file, const std::string &bytes) const {
        std::ofstream(folder_ / file, std::ios::binary) << bytes;
    }
    /// Replaces text of the manifest, which must be there.
    void edit(const std::string &from, const std::string &to) const {
        std::string manifest = read("manifest.json");
        const size_t at = manifest.find(from);
        ASSERT_NE(at, std::string::npos) << from;
        write("manifest.json", manifest.replace(at, from.size(), to));
    }

private:
    std::filesystem::path folder_;
};

} // namespace pathfold::core
