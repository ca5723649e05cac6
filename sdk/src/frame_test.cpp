#include "frame.h"

#include "testing.h"

namespace pathfold::core {
namespace {

const Manifest &split_manifest() {
    static const Manifest manifest = Manifest::parse(read_text(model_folder("split-5") + "/manifest.json"));
    return manifest;
}

const Manifest &samples_manifest() {
    static const Manifest manifest = Manifest::parse(read_text(model_folder("samples-5") + "/manifest.json"));
    return manifest;
}

} // namespace

TEST(Frame, UnknownNames) {
    Frame frame;
    const Pixels pixels(4, 4, 3);
    const pathfold_image image = pixels.image();
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.set_input("colour", &image); }, "colour", "buffers are",
        "diffuse.albedo");
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.set_output("normal", &image); }, "normal", "outputs are");
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { frame.set_layer("color", "color", &image); }, "color");
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { frame.set_layer("key", "albedo", &image); }, "parts are");
}

TEST(Frame, ChannelsAndSizes) {
    Frame frame;
    const Pixels color(4, 5, 3), depth(4, 5, 3), albedo(4, 6, 3);
    pathfold_image image = color.image();
    frame.set_input("color", &image);
    image = depth.image();
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.set_input("depth", &image); }, "depth", "4 x 5 x 3",
        "1 channel");
    image = albedo.image();
    frame.set_input("albedo", &image);
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(split_manifest()); }, "albedo", "4 x 6 x 3",
        "4 x 5 x 3");
}

TEST(Frame, RequiredBuffers) {
    Frame frame;
    const Pixels color(4, 5, 3);
    const pathfold_image image = color.image();
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(split_manifest()); }, "no color", "none");
    frame.set_input("color", &image);
    frame.check(split_manifest());
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(samples_manifest()); }, "samples.descriptor",
        "given: color");
    frame.clear();
    frame.set_input("diffuse", &image);
    frame.set_input("specular", &image);
    frame.check(split_manifest()); // their sum is the color
}

TEST(Frame, SampleCountsAgree) {
    Frame frame;
    const Pixels color(4, 5, 3);
    std::vector<float> values(3 * 4 * 5 * 36);
    const pathfold_image image = color.image();
    const pathfold_image three = pathfold_packed(values.data(), PATHFOLD_FLOAT32, 3, 4, 5, 36);
    const pathfold_image two = pathfold_packed(values.data(), PATHFOLD_FLOAT32, 2, 4, 5, 1);
    frame.set_input("color", &image);
    frame.set_input("samples.descriptor", &three);
    frame.set_input("samples.density", &two);
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(samples_manifest()); }, "there are 3 samples per pixel",
        "but 2");
}

TEST(Frame, LayersAreWholeOrInTwoParts) {
    Frame frame;
    const Pixels color(4, 5, 3);
    const pathfold_image image = color.image();
    frame.set_input("color", &image);
    frame.set_layer("key", "diffuse", &image);
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(split_manifest()); }, "key",
        "color, or as diffuse and specular");
}

TEST(Frame, OutputsApartFromGuides) {
    Frame frame;
    const Pixels color(4, 5, 3), albedo(4, 5, 3);
    const pathfold_image image = color.image(), guide = albedo.image();
    frame.set_input("color", &image);
    frame.set_input("albedo", &guide);
    frame.set_output("color", &image); // in place
    frame.check(split_manifest());
    frame.set_output("color", &guide);
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(split_manifest()); }, "lies over the buffer albedo");
}

TEST(Frame, PartsOnlyOfASplitFrame) {
    Frame frame;
    const Pixels color(4, 5, 3), out(4, 5, 3);
    const pathfold_image image = color.image(), output = out.image();
    frame.set_input("color", &image);
    frame.set_output("diffuse", &output);
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(split_manifest()); }, "output diffuse", "not split");
}

} // namespace pathfold::core
