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

TEST(Frame, LayersCanBeTakenAway) {
    Frame frame;
    const Pixels color(4, 5, 3), result(4, 5, 3);
    const pathfold_image image = color.image(), output = result.image();
    frame.set_input("color", &image);
    frame.set_layer("key", "diffuse", &image); // wrongly
    frame.set_layer("key", "diffuse", nullptr);
    frame.set_layer("key", "color", &image);
    frame.check();
    frame.set_layer_output("ghost", &output); // of no layer
    expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { frame.check(); }, "ghost");
    frame.set_layer_output("ghost", nullptr);
    frame.set_layer("nobody", "color", nullptr);
    frame.check();
    EXPECT_EQ(frame.layers().size(), 1u);
}

TEST(Frame, EachValueOfAnOutputHasItsOwnBytes) {
    const Pixels color(4, 5, 3), alpha(4, 5, 1), result(4, 5, 4);
    const auto make = [&](pathfold_image rgb, pathfold_image a, bool layer) {
        Frame frame;
        const pathfold_image image = color.image(), one = alpha.image();
        frame.set_input("color", &image);
        frame.set_input("alpha", &one);
        frame.set_layer("key", "color", &image);
        frame.set_output("alpha", &a);
        if (layer)
            frame.set_layer_output("key", &rgb);
        else
            frame.set_output("color", &rgb);
        frame.check();
        frame.check_data();
    };
    for (bool layer : {false, true}) {
        pathfold_image rgb = result.image(), a = result.image();
        rgb.channels = 3;
        a.channels = 1;
        const auto refused = [&](const char *words) {
            expect_error(PATHFOLD_INVALID_ARGUMENT, [&] { make(rgb, a, layer); }, words);
        };
        refused("lies over output");
        a.data = const_cast<float *>(&result.values[3]); // the A of RGBA
        make(rgb, a, layer);
        a.data = const_cast<float *>(&result.values[2]);
        refused("lies over output");
        a.data = const_cast<float *>(alpha.values.data());
        for (auto stride :
             {&pathfold_image::row_stride, &pathfold_image::pixel_stride, &pathfold_image::channel_stride}) {
            pathfold_image kept = rgb;
            rgb.*stride = 0;
            refused("over one another");
            rgb.*stride = 2;
            refused("over one another");
            rgb = kept;
        }
        rgb.pixel_stride = 8;
        refused("over one another");
    }
}

} // namespace pathfold::core
