#include "reads.h"

#include "testing.h"

namespace pathfold::core {
namespace {

using Names = std::vector<std::string>;

Manifest manifest_of(const std::string &model) {
    return Manifest::parse(read_text(model_folder(model) + "/manifest.json"));
}

/// A frame whose buffers all show the same pixels.
struct Given {
    Pixels pixels = Pixels(4, 5, 3);
    std::vector<float> samples = std::vector<float>(size_t(4) * 4 * 5 * 36);
    Frame frame;

    explicit Given(const Names &names) {
        for (const std::string &name : names)
            add(name);
    }
    void add(const std::string &name) {
        const pathfold_image image = name.rfind("samples.", 0) == 0
                                         ? pathfold_packed(samples.data(), PATHFOLD_FLOAT32, 4, 4, 5,
                                                           name == "samples.descriptor" ? 36 : 1)
                                         : pixels.image();
        frame.set_input(name, &image);
    }
    void check(const Manifest &manifest) const {
        check_reads(frame, manifest, decide_reads(frame, manifest, {}));
    }
};

Names names_of(const std::set<std::string> &names) { return {names.begin(), names.end()}; }

} // namespace

TEST(Reads, RequiredBuffers) {
    Given given({"color"});
    given.check(manifest_of("split-5"));
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { given.check(manifest_of("samples-5")); }, "samples.descriptor",
        "given: color");
    Given({"diffuse", "specular"}).check(manifest_of("split-5")); // their sum is the color
}

TEST(Reads, OutputsApartFromGuides) {
    Given given({"color"});
    const Pixels albedo(4, 5, 3);
    const pathfold_image image = given.pixels.image(), guide = albedo.image();
    given.frame.set_input("albedo", &guide);
    given.frame.set_output("color", &image); // in place
    given.check(manifest_of("split-5"));
    given.frame.set_output("color", &guide);
    given.check(manifest_of("single-3")); // does not read it
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { given.check(manifest_of("split-5")); },
        "lies over the buffer albedo");
}

TEST(Reads, OutputsBetweenTheGuidesOfAStruct) {
    const Pixels pixels(4, 5, 8); // color, albedo, normal's first part
    const auto member = [&](int offset) {
        pathfold_image image = pixels.image();
        image.data = const_cast<float *>(&pixels.values[size_t(offset)]);
        image.channels = 3;
        return image;
    };
    const pathfold_image color = member(0), albedo = member(3), late = member(2);
    Frame frame;
    frame.set_input("color", &color);
    frame.set_input("albedo", &albedo);
    frame.set_output("color", &color);
    const auto check = [&] {
        check_reads(frame, manifest_of("split-5"), decide_reads(frame, manifest_of("split-5"), {}));
    };
    check();
    frame.set_output("color", &late);
    expect_error(PATHFOLD_INVALID_ARGUMENT, check, "lies over the buffer albedo");
}

TEST(Reads, PartsOnlyOfASplitFrame) {
    Given given({"color"});
    const Pixels out(4, 5, 3);
    const pathfold_image output = out.image();
    given.frame.set_output("diffuse", &output);
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { given.check(manifest_of("split-5")); }, "output diffuse",
        "not split");
}

TEST(Reads, WhatAModelDoesNotReadIsUnread) {
    Given given({"color", "albedo", "normal"});
    EXPECT_EQ(decide_reads(given.frame, manifest_of("single-3"), {}).unread, (Names{"albedo", "normal"}));
    EXPECT_EQ(decide_reads(given.frame, manifest_of("split-5"), {}).unread, Names{});
}

TEST(Reads, WhatSaysNothingIsAsIfNotGiven) {
    const Manifest manifest = manifest_of("split-5");
    Given given({"color", "diffuse", "specular", "diffuse.albedo", "normal", "diffuse.variance"});
    const Reads all = decide_reads(given.frame, manifest, {});
    EXPECT_TRUE(all.split);
    Reads reads = without(given.frame, {"normal"}, all, manifest, {});
    EXPECT_TRUE(reads.split);
    EXPECT_FALSE(reads.has("normal"));
    EXPECT_EQ(reads.unread, Names{"normal"});
    reads = without(given.frame, {"diffuse.albedo"}, all, manifest, {}); // which the split takes
    EXPECT_FALSE(reads.split);
    EXPECT_EQ(reads.unread, (Names{"diffuse", "diffuse.albedo", "diffuse.variance", "specular"}));
}

TEST(Reads, ASplitFrameIsReadInParts) {
    const Manifest manifest = manifest_of("split-5");
    Given given({"color", "variance", "diffuse", "diffuse.variance"});
    Reads reads = decide_reads(given.frame, manifest, {});
    EXPECT_FALSE(reads.split);
    EXPECT_EQ(names_of(reads.buffers), (Names{"color", "variance"}));
    EXPECT_EQ(reads.unread, (Names{"diffuse", "diffuse.variance"}));
    for (const char *name : {"specular", "diffuse.albedo"})
        given.add(name);
    reads = decide_reads(given.frame, manifest, {});
    EXPECT_TRUE(reads.split);
    EXPECT_EQ(names_of(reads.buffers),
              (Names{"color", "diffuse", "diffuse.albedo", "diffuse.variance", "specular"}));
    EXPECT_EQ(reads.unread, Names{"variance"}); // color is what the parts are compared with
    ASSERT_EQ(reads.branches.size(), 2u);
    EXPECT_EQ(reads.branches[0].factor, "diffuse.albedo");
    EXPECT_EQ(reads.branches[1].factor, "");

    const pathfold_image image = given.pixels.image();
    given.frame.set_layer("key", "color", &image); // comes whole, so the frame is not split
    given.frame.set_input("color", nullptr);
    reads = decide_reads(given.frame, manifest, {});
    EXPECT_FALSE(reads.split);
    EXPECT_EQ(reads.branches[0].parts, (Names{"diffuse", "specular"}));
    EXPECT_EQ(names_of(reads.buffers), (Names{"diffuse", "specular", "variance"}));
    EXPECT_EQ(reads.unread, (Names{"diffuse.albedo", "diffuse.variance"}));
}

TEST(Reads, ConvergenceReadsTheVariance) {
    Given given({"color", "variance"});
    EXPECT_FALSE(decide_reads(given.frame, manifest_of("single-3"), {}).has("variance"));
    Settings settings;
    settings.leave_out = parse_leave_out("converged");
    EXPECT_TRUE(decide_reads(given.frame, manifest_of("single-3"), settings).has("variance"));
}

TEST(Reads, PathsWhereTheManifestSaysSo) {
    Given given({"color"});
    Manifest manifest = manifest_of("single-3");
    manifest.uses = {"samples.descriptor"};
    manifest.without_paths = 4;
    Settings settings;
    settings.leave_out = parse_leave_out("paths");
    const auto without = [&] { return decide_reads(given.frame, manifest, settings).without_paths; };
    EXPECT_FALSE(without()); // there are none
    given.add("samples.descriptor");
    EXPECT_TRUE(without());
    const Reads reads = decide_reads(given.frame, manifest, settings);
    EXPECT_EQ(reads.unread, Names{"samples.descriptor"});
    EXPECT_EQ(reads.samples, 0);
    EXPECT_EQ(reads.samples_behind, 4);
    manifest.without_paths = 5;
    EXPECT_FALSE(without());
    manifest.without_paths = 4;
    settings.leave_out = parse_leave_out("all");
    EXPECT_FALSE(without());
    EXPECT_EQ(decide_reads(given.frame, manifest, settings).samples, 4);
    settings.leave_out = parse_leave_out("paths");
    manifest.requires_ = {"samples.descriptor"};
    EXPECT_FALSE(without());
}

} // namespace pathfold::core
