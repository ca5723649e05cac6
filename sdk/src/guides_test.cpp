#include "guides.h"

#include <cmath>
#include <limits>

#include "naive.h"
#include "scene.h"
#include "testing.h"

namespace pathfold::core {
namespace {

constexpr int height = 20, width = 24;
constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();

/// A frame for the test model "split-5", which reads every guide, and what is made of it.
struct Given {
    std::map<std::string, Pixels> buffers = {{"color", noise(height, width, 3, 1)}};
    Frame frame;
    Threads threads;

    Pixels &add(const std::string &name, const Pixels &pixels) {
        return buffers.insert_or_assign(name, pixels).first->second;
    }
    Pixels &add(const std::string &name, int channels = 3, float scale = 1) {
        Pixels pixels = noise(height, width, channels, unsigned(buffers.size()) + 1);
        for (float &value : pixels.values)
            value = scale * std::min(value, 1.0f);
        return add(name, pixels);
    }
    Guides look(const std::vector<std::string> &required = {}) {
        for (const auto &[name, pixels] : buffers) {
            const pathfold_image image = pixels.image();
            frame.set_input(name, &image);
        }
        const Manifest manifest = Manifest::parse(read_text(model_folder("split-5") + "/manifest.json"));
        return Guides(frame, decide_reads(frame, manifest, {}), required, threads);
    }
    static Pixels read(const Guides &guides, const std::string &name, int channels = 3) {
        Pixels pixels(height, width, channels);
        for (int y = 0; y < height; ++y)
            guides.load_row(name, y, 0, width, &pixels.at(y, 0, 0));
        return pixels;
    }
};

using Names = std::set<std::string>;
using Notes = std::vector<std::string>;

/// A unit vector per pixel, camera space, some pixels a background of 0.
Pixels unit_normals() {
    Pixels normal = noise(height, width, 3, 9);
    for (int i = 0; i < height * width; ++i) {
        float *n = normal.values.data() + 3 * i, length = 0;
        for (int c = 0; c < 3; ++c)
            n[c] = std::sin(7 * n[c] + float(c)), length += n[c] * n[c];
        for (int c = 0; c < 3; ++c)
            n[c] = i % 5 == 0 ? 0 : n[c] / std::sqrt(length);
    }
    return normal;
}

} // namespace

TEST(Guides, HealthyOnesAreReadAsTheyAre) {
    Given given;
    for (const char *name : {"albedo", "variance"})
        given.add(name);
    given.add("normal", unit_normals());
    given.add("depth", 1, 50);
    const Guides guides = given.look();
    for (const auto &[name, channels] :
         std::map<std::string, int>{{"albedo", 3}, {"normal", 3}, {"depth", 1}})
        EXPECT_EQ(Given::read(guides, name, channels).values, given.buffers.at(name).values) << name;
    EXPECT_TRUE(guides.mended().empty());
    EXPECT_TRUE(guides.notes().empty());
    EXPECT_TRUE(guides.silent().empty());
}

TEST(Guides, AreBroughtIntoTheirRange) {
    Given given;
    Pixels &albedo = given.add("albedo"), &normal = given.add("normal");
    albedo.at(3, 4, 1) = 50, albedo.at(5, 6, 2) = -1, albedo.at(7, 8, 0) = 1.0005f;
    normal.at(1, 1, 0) = -0.5f, normal.at(2, 2, 0) = 3e38f, normal.at(3, 3, 2) = -7, normal.at(4, 4, 1) = nan;
    const Guides guides = given.look();
    const Pixels a = Given::read(guides, "albedo"), n = Given::read(guides, "normal");
    EXPECT_EQ(a.at(3, 4, 1), 1);
    EXPECT_EQ(a.at(5, 6, 2), 0);
    EXPECT_EQ(a.at(7, 8, 0), 1); // by rounding: not told
    EXPECT_EQ(n.at(1, 1, 0), -0.5f);
    EXPECT_EQ(n.at(2, 2, 0), 1);
    EXPECT_EQ(n.at(3, 3, 2), -1);
    EXPECT_EQ(n.at(4, 4, 1), 0);
    EXPECT_EQ(guides.mended(), (Mended{{"albedo", {{fault::above, 1}, {fault::negative, 1}}},
                                       {"normal", {{fault::beyond, 2}, {fault::none, 1}}}}));
}

TEST(Guides, ADemodulatorIsOfItsNeighbours) {
    for (const char *name : {"albedo", "alpha"}) {
        Given given;
        const int channels = find_buffer(name)->channels;
        Pixels &values = given.add(name, Pixels(height, width, channels, 0.25f));
        values.at(0, 0, 0) = 0.5f;
        values.at(9, 9, 0) = nan, values.at(10, 9, channels - 1) = infinity, values.at(11, 9, 0) = -infinity;
        values.at(9, 10, 0) = 0.75f;
        const Guides guides = given.look();
        const Pixels read = Given::read(guides, name, channels);
        EXPECT_FLOAT_EQ(read.at(9, 9, 0), channels == 3 ? (7 * 0.25f + 0.75f) / 8 : (6 * 0.25f + 0.75f) / 7);
        EXPECT_EQ(read.at(9, 10, 0), 0.75f);
        EXPECT_EQ(guides.mended(), (Mended{{name, {{fault::rebuilt, 3}}}}));
    }
}

TEST(Guides, AnUnknownVarianceIsTheLargestAround) {
    for (float unknown : {nan, infinity, -infinity, 2e36f}) {
        Given given;
        Pixels &variance = given.add("variance");
        variance.at(9, 9, 1) = unknown;
        variance.at(8, 10, 1) = 17;
        const Guides guides = given.look();
        const Pixels read = Given::read(guides, "variance");
        EXPECT_EQ(read.at(9, 9, 1), 17) << unknown;
        EXPECT_EQ(read.at(9, 9, 0), variance.at(9, 9, 0));
        EXPECT_EQ(guides.mended(), (Mended{{"variance", {{fault::unknown, 1}}}}));
    }
}

TEST(Guides, AVarianceThatIsHardlyKnownIsNone) {
    Given given;
    Pixels &variance = given.add("variance");
    for (int i = 0; i < height * width / 2; ++i)
        variance.values[size_t(i) * 3] = infinity;
    EXPECT_EQ(given.look().silent(), Names());
    variance.values.back() = nan;
    const Guides guides = given.look();
    EXPECT_EQ(guides.silent(), Names{"variance"});
    EXPECT_EQ(guides.notes(), Notes{"variance is not finite in 241 of 480 pixels: not used"});
}

TEST(Guides, EveryWayToWriteAMissIsOne) {
    for (float miss : {0.0f, -1.0f, nan, infinity, 1e10f, 3.4e38f}) {
        Given given;
        Pixels &depth = given.add("depth", Pixels(height, width, 1, 4));
        for (int x = 0; x < width; ++x)
            depth.at(0, x, 0) = miss;
        const Guides guides = given.look();
        const Pixels read = Given::read(guides, "depth", 1);
        EXPECT_EQ(read.at(0, 5, 0), 0) << miss;
        EXPECT_EQ(read.at(1, 5, 0), 4) << miss;
        EXPECT_FLOAT_EQ(guides.depth_scale(), 0.25f) << miss;
        EXPECT_EQ(guides.mended().empty(), miss == 0) << miss;
    }
}

TEST(Guides, WhatIsTheSameEverywhereSaysNothing) {
    for (const char *name : {"albedo", "normal", "depth", "variance"})
        for (float value : {0.0f, 0.5f, 1.0f, -1.0f, nan, infinity}) {
            Given given;
            Pixels &constant = given.add(name, Pixels(height, width, find_buffer(name)->channels, value));
            EXPECT_EQ(given.look().silent(), Names{name}) << value;
            EXPECT_EQ(given.look().notes().size(), 1u);
            EXPECT_TRUE(given.look().mended().empty()); // it is not read
            constant.at(height - 1, width - 1, 0) = 0.25f;
            const bool one_known = !std::isfinite(value) && meaning_of(name).missing != Missing::zero;
            EXPECT_EQ(given.look().silent().empty(), !one_known) << name << " " << value;
            EXPECT_TRUE(given.look({name}).silent().empty()); // a model insists on it
        }
    Given given;
    Pixels &normal = given.add("normal", Pixels(height, width, 3));
    EXPECT_EQ(given.look().notes(), Notes{"normal is 0 in every pixel: not used"});
    for (int i = 0; i < height * width; ++i)
        normal.values[size_t(i) * 3 + 2] = 0.5f;
    EXPECT_EQ(given.look().notes(), Notes{"normal is (0, 0, 0.5) in every pixel: not used"});
    Given clay; // constant where it is known
    clay.add("albedo", Pixels(height, width, 3, 0.8f)).at(3, 3, 0) = nan;
    EXPECT_EQ(clay.look().silent(), Names{"albedo"});
}

TEST(Guides, EncodedNormalsAreDecoded) {
    for (float background : {0.0f, 0.5f}) {
        Given given;
        const Pixels right = unit_normals();
        Pixels &normal = given.add("normal", right);
        for (int i = 0; i < height * width; ++i)
            for (int c = 0; c < 3; ++c)
                if (float &value = normal.values[size_t(i) * 3 + c]; true)
                    value = i % 5 == 0 ? background : 0.5f * value + 0.5f;
        const Guides guides = given.look();
        const Pixels read = Given::read(guides, "normal");
        for (size_t i = 0; i < read.values.size(); ++i)
            EXPECT_NEAR(read.values[i], right.values[i], 1e-6);
        EXPECT_EQ(guides.notes(), Notes{"normal is stored as 0.5 n + 0.5: decoded"});
    }
}

TEST(Guides, EncodedMeansOfNormalsAreDecoded) {
    Given given;
    Pixels &normal = given.add("normal", unit_normals());
    for (size_t i = 0; i < normal.values.size() / 2; ++i) // of two that differ: much shorter than one
        normal.values[i] = 0.5f * (normal.values[i] + normal.values[i + 3]);
    for (float &value : normal.values)
        value = 0.5f * value + 0.5f;
    EXPECT_EQ(given.look().notes(), Notes{"normal is stored as 0.5 n + 0.5: decoded"});
}

TEST(Guides, NormalsThatFaceOneWayAreNotEncoded) {
    Pixels normal = unit_normals(); // all in the positive octant
    for (float &value : normal.values)
        value = std::abs(value);
    Given given;
    given.add("normal", normal);
    EXPECT_EQ(given.look().notes(), Notes());
    EXPECT_EQ(Given::read(given.look(), "normal").values, normal.values);
}

TEST(Guides, AConstantGuideIsNone) {
    for (const char *name : {"albedo", "normal", "depth", "diffuse.variance", "diffuse.albedo"})
        for (float value : {0.0f, 1.0f}) {
            Scene scene = Scene::full(40, 44), without = scene;
            Pixels &guide = scene.buffers.at(name);
            guide = Pixels(40, 44, guide.channels, value);
            without.buffers.erase(name);
            without.denoise("split-5");
            for (int tile : {0, 16}) {
                without.settings.tile = scene.settings.tile = tile;
                without.denoise("split-5");
                scene.denoise("split-5");
                for (const auto &[output, pixels] : without.results)
                    EXPECT_EQ(scene.results.at(output).values, pixels.values) << name << " " << output;
                EXPECT_EQ(scene.report["notes"],
                          Json::array({text(name, " is ", value, " in every pixel: not used")}));
                EXPECT_EQ(scene.report["inputs"]["unused"][0], name);
            }
        }
}

TEST(Guides, WhatIsReadInsteadOfASilentOneIsSetRight) {
    Scene scene = Scene::full(40, 44), without = scene;
    for (Scene *one : {&scene, &without}) {
        one->buffers.emplace("color", sum(scene.buffers.at("diffuse"), scene.buffers.at("specular")));
        one->buffers.emplace("variance", scene.buffers.at("specular.variance"));
        one->buffers.at("variance").values[7] = nan;
    }
    scene.buffers.at("diffuse.albedo") = Pixels(40, 44, 3, 1.0f); // so variance is read after all
    without.buffers.erase("diffuse.albedo");
    EXPECT_EQ(scene.denoise("split-5").values, without.denoise("split-5").values);
    EXPECT_EQ(scene.report["sanitised"], without.report["sanitised"]);
    EXPECT_EQ(scene.report["repaired"], 0);
}

TEST(Guides, WithoutASplitItsPartsRideAlong) {
    Scene scene = Scene::full(40, 44);
    scene.buffers.at("diffuse.albedo") = Pixels(40, 44, 3);
    const Pixels color = scene.denoise("split-5");
    EXPECT_EQ(scene.report["split"], false);
    expect_near(sum(scene.results.at("diffuse"), scene.results.at("specular")), color, 1e-5);
}

} // namespace pathfold::core
