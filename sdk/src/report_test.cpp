#include "report.h"

#include <cmath>
#include <limits>
#include <random>

#include "naive.h"
#include "needs.h"
#include "scene.h"
#include "testing.h"

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();

/// Black on the left, specular black everywhere, alpha constant.
Scene half_lit() {
    Scene scene = Scene::full(64, 64);
    scene.buffers.at("specular") = Pixels(64, 64, 3);
    scene.buffers.at("alpha") = Pixels(64, 64, 1, 1);
    Pixels &diffuse = scene.buffers.at("diffuse");
    for (int y = 0; y < 64; ++y)
        for (int x = 0; x < 40; ++x)
            for (int c = 0; c < 3; ++c)
                diffuse.at(y, x, c) = 0;
    scene.settings.tile = 16;
    return scene;
}

std::vector<std::string> left_out(const Scene &scene) {
    std::vector<std::string> whats;
    for (const Json &line : scene.report["left_out"])
        whats.push_back(line["what"]);
    return whats;
}

using Whats = std::vector<std::string>;

/// The report of a run on a frame of 8 x 8 pixels, in two tiles, that did as `fill` says.
template <typename Fill>
Json made_up(const Settings &settings, const Fill &fill) {
    const Pixels color = noise(8, 8, 3, 1);
    const pathfold_image image = color.image();
    Frame frame;
    frame.set_input("color", &image);
    frame.set_input("normal", &image);
    const Model model(model_folder("single-3"), "cpu", 1);
    const Reads reads = decide_reads(frame, model.manifest(), settings);
    Prepared prepared;
    prepared.mended = {{"normal", {{fault::none, 2}}}};
    Plan plan;
    plan.tiles = {{{0, 0, 8, 4}, {0, 0, 8, 8}}, {{0, 4, 8, 4}, {0, 0, 8, 8}}};
    plan.window_bytes = int64_t(3) << 20;
    Report report(reads.branches.size());
    fill(report, plan.tiles);
    return Json::parse(report.json(frame, reads, model, settings, prepared, plan));
}

} // namespace

TEST(Report, SavedTimeIsByWhatRan) {
    const Json report = made_up({}, [](Report &report, const std::vector<Tile> &tiles) {
        report.times.pack = 1, report.times.network = 5, report.times.reconstruct = 2, report.times.write = 9;
        report.repaired = 3, report.samples_dropped = 4;
        report.done[0].add(tiles[0]);
        report.left_out[0]["branches"].add(tiles[1]);
    });
    const Json line = {{"what", "branch color in 1 of 2 tiles"},
                       {"why", "color is constant there: filtering changes nothing"},
                       {"saved_ms", 8.0}}; // of as many pixels: without writing, which takes place anyway
    EXPECT_EQ(report["left_out"], Json::array({line}));
    EXPECT_EQ(report["branches"], Json({"color"}));
    EXPECT_EQ(report["ms"]["total"], 17.0);
    const Json sanitised = {{"normal", {{fault::none, 2}}}, {"samples", {{fault::dropped, 4}}}};
    EXPECT_EQ(report["sanitised"], sanitised);
    EXPECT_EQ(report["repaired"], 3);
    EXPECT_EQ(report["tile"], Json({8, 4}));
    EXPECT_EQ(report["inputs"]["used"], Json({"color"}));
    EXPECT_EQ(report["inputs"]["unused"], Json({"normal"}));
}

TEST(Report, ATileThatHoldsMoreThanMemoryIsTold) {
    const auto nothing = [](Report &, const std::vector<Tile> &) {};
    for (auto [tile, memory, told] : {std::tuple(4, 2, 1u), {4, 3, 0u}, {4, 0, 0u}, {0, 2, 0u}}) {
        Settings settings;
        settings.tile = tile, settings.memory_mb = memory;
        EXPECT_EQ(made_up(settings, nothing)["notes"].size(), told) << tile << " " << memory;
    }
}

TEST(Report, WhereNothingRanNothingIsKnown) {
    const Json report = made_up({}, [](Report &report, const std::vector<Tile> &tiles) {
        for (const Tile &tile : tiles)
            report.left_out[0]["tiles"].add(tile);
    });
    EXPECT_EQ(report["left_out"][0]["what"], "all tiles");
    EXPECT_FALSE(report["left_out"][0].contains("saved_ms"));
    EXPECT_EQ(report["branches"], Json::array());
}

TEST(Report, NotesSayWhatIsUnusual) {
    Settings settings;
    settings.samples_per_pixel = 100;
    const auto nothing = [](Report &, const std::vector<Tile> &) {};
    EXPECT_EQ(made_up({}, nothing)["notes"], Json::array());
    const Json notes = made_up(settings, nothing)["notes"];
    ASSERT_EQ(notes.size(), 1u);
    EXPECT_EQ(notes[0], "100 samples per pixel; the model was trained on 1 to 64");
}

TEST(Report, WhatIsNotNeededIsLeftOut) {
    Scene scene = half_lit();
    scene.settings.leave_out = parse_leave_out("none");
    const Pixels all = scene.denoise("split-5");
    EXPECT_EQ(left_out(scene), Whats());
    EXPECT_EQ(scene.report["branches"], Json({"diffuse", "specular"}));
    for (const auto &[names, whats] :
         std::map<std::string, Whats>{{"all", {"branch specular", "8 of 16 tiles"}},
                                      {"branches", {"branch diffuse in 8 of 16 tiles", "branch specular"}},
                                      {"tiles", {"8 of 16 tiles"}}}) {
        scene.settings.leave_out = parse_leave_out(names);
        expect_near(scene.denoise("split-5"), all, 1e-5);
        EXPECT_EQ(left_out(scene), whats) << names;
        EXPECT_NEAR(scene.results.at("alpha").at(5, 5, 0), 1, 1e-6);
        for (const Json &line : scene.report["left_out"])
            EXPECT_GT(line["saved_ms"], 0) << line;
    }
}

TEST(Report, ABlackFrameRunsNothing) {
    Scene scene = Scene::color(32, 32);
    scene.buffers.at("color") = Pixels(32, 32, 3);
    EXPECT_EQ(scene.denoise("single-3").values, scene.buffers.at("color").values);
    EXPECT_EQ(left_out(scene), Whats{"branch color"});
    EXPECT_FALSE(scene.report["left_out"][0].contains("saved_ms")); // nothing ran that could tell
    EXPECT_EQ(scene.report["ms"]["network"], 0.0);
}

TEST(Report, InputsThatAreNotReadDoNotMatter) {
    Scene scene = Scene::color(32, 32);
    const Pixels alone = scene.denoise("single-3");
    scene.buffers.emplace("normal", Pixels(32, 32, 3, nan));
    EXPECT_EQ(scene.denoise("single-3").values, alone.values);
    EXPECT_EQ(scene.report["sanitised"], Json::object());
    EXPECT_EQ(scene.report["inputs"]["unused"], Json({"normal"}));
}

TEST(Report, ConvergedTilesAreCopiedWhereAsked) {
    // Every pixel is within its deviation of a smooth truth: of little noise on the left.
    Scene scene = Scene::color(32, 64);
    Pixels truth(32, 64, 3), variance(32, 64, 3);
    std::mt19937 random(3);
    std::normal_distribution<float> normal;
    for (int y = 0; y < 32; ++y)
        for (int x = 0; x < 64; ++x)
            for (int c = 0; c < 3; ++c) {
                truth.at(y, x, c) = 1 + 0.02f * float(x + y * c);
                const float deviation = truth.at(y, x, c) * (x < 32 ? 0.008f : 0.1f);
                variance.at(y, x, c) = deviation * deviation;
                scene.buffers.at("color").at(y, x, c) = truth.at(y, x, c) + deviation * normal(random);
            }
    scene.buffers.emplace("variance", variance);
    scene.settings.tile = 16;
    const Pixels exact = scene.denoise("split-5");
    scene.settings.leave_out = parse_leave_out("all,converged");
    EXPECT_EQ(scene.denoise("split-5").values, exact.values); // the number of samples is not known
    scene.settings.samples_per_pixel = 15;
    EXPECT_EQ(scene.denoise("split-5").values, exact.values);
    scene.settings.samples_per_pixel = 16;
    const Pixels &copied = scene.denoise("split-5");
    EXPECT_EQ(left_out(scene), Whats{"4 of 8 tiles"});
    double error = 0;
    for (int y = 0; y < 32; ++y)
        for (int x = 0; x < 64; ++x)
            for (int c = 0; c < 3; ++c) {
                const float value = copied.at(y, x, c), exposed = 0.5f * truth.at(y, x, c);
                EXPECT_EQ(value, (x < 32 ? scene.buffers.at("color") : exact).at(y, x, c));
                const double off = x < 32 ? 0.5f * (value - truth.at(y, x, c)) : 0;
                error += off * off / (exposed * exposed + 0.01);
            }
    EXPECT_LT(error / (32 * 32 * 3), converged_error); // the bound that the report states

    scene.settings.leave_out = parse_leave_out("all"); // never by itself
    EXPECT_EQ(scene.denoise("split-5").values, exact.values);
    scene.settings.leave_out = parse_leave_out("converged");
    scene.buffers.at("variance").at(3, 3, 0) = nan; // one that is not known
    scene.denoise("split-5");
    EXPECT_EQ(left_out(scene), Whats{"3 of 8 tiles"});
}

TEST(Report, VerticesThatNoPathHasNeedNotBeGiven) {
    const int height = 20, width = 24, count = 2, vertices = 2;
    const size_t pixels = size_t(count) * height * width;
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    std::vector<float> whole, part, density(pixels, -3.0f);
    for (size_t i = 0; i < pixels; ++i)
        for (int channel = 0; channel < 36; ++channel) {
            const bool logs = channel < 24; // 6 of the path, 3 of each vertex; then tags, then roughness
            const int vertex = channel < 6 ? 0 : logs ? (channel - 6) / 3 : (channel - 24) % 6;
            whole.push_back(vertex < vertices ? normal(random) : logs ? -100.0f : 0.0f);
            if (vertex < vertices)
                part.push_back(whole.back());
        }
    ASSERT_EQ(part.size(), pixels * (6 + 5 * vertices));
    const Pixels color = noise(height, width, 3, 1);
    Pixels results[2] = {Pixels(height, width, 3), Pixels(height, width, 3)};
    Denoiser denoiser(std::make_shared<const Model>(model_folder("samples-5"), "cpu", 1));
    Json report;
    for (int i = 0; i < 2; ++i) {
        std::vector<float> &given = i == 0 ? whole : part;
        const pathfold_image images[] = {
            color.image(),
            pathfold_packed(given.data(), PATHFOLD_FLOAT32, count, height, width,
                            int64_t(given.size() / pixels)),
            pathfold_packed(density.data(), PATHFOLD_FLOAT32, count, height, width, 1), results[i].image()};
        Frame frame;
        frame.set_input("color", &images[0]);
        frame.set_input("samples.descriptor", &images[1]);
        frame.set_input("samples.density", &images[2]);
        frame.set_output("color", &images[3]);
        report = Json::parse(denoiser.run(frame, {}));
        EXPECT_EQ(report["left_out"].size(), size_t(i));
    }
    EXPECT_EQ(results[0].values, results[1].values);
    EXPECT_EQ(report["left_out"][0]["what"], "path vertices from 3 on");
}

} // namespace pathfold::core
