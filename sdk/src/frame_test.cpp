#include "frame.h"

#include "testing.h"

namespace pathfold::core {
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
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(); }, "albedo", "4 x 6 x 3", "4 x 5 x 3");
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
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(); }, "there are 3 samples per pixel", "but 2");
}

TEST(Frame, LayersAreWholeOrInTwoParts) {
    Frame frame;
    const Pixels color(4, 5, 3);
    const pathfold_image image = color.image();
    frame.set_input("color", &image);
    frame.set_layer("key", "diffuse", &image);
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(); }, "key", "color, or as diffuse and specular");
}

} // namespace pathfold::core
