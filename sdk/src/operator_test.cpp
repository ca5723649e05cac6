#include "operator.h"

#include "testing.h"

namespace pathfold::core {

TEST(Operator, EachSaysWhatGraphsMustGive) {
    Reconstruction options;
    options.name = "gather", options.size = 5, options.trust = true;
    std::unique_ptr<Operator> how = make_operator(options);
    EXPECT_EQ(shape_text(how->outputs().at("logits")), "[1, 26, H, W]");
    EXPECT_EQ(how->reach(), 2);
    EXPECT_EQ(how->least_overlap(), 2);
    options.trust = false;
    how = make_operator(options);
    EXPECT_EQ(shape_text(how->outputs().at("logits")), "[1, 25, H, W]");
    EXPECT_EQ(how->least_overlap(), 0);

    options.name = "pyramid";
    how = make_operator(options);
    EXPECT_EQ(how->outputs().size(), 5u);
    EXPECT_EQ(shape_text(how->outputs().at("logits.16")), "[1, 25, H/16, W/16]");
    const int reach = how->reach();
    options.clean = true;
    how = make_operator(options);
    EXPECT_EQ(shape_text(how->outputs().at("cleaning.2")), "[1, 150, H/2, W/2]");
    EXPECT_GT(how->reach(), reach);
    EXPECT_EQ(how->alignment(), 16);
}

TEST(Operator, APredictionHasRoomForItsShapes) {
    const std::map<std::string, Shape> shapes = {{"a", {{1, ""}, {2, ""}, {-1, "H"}, {-1, "W"}}},
                                                 {"b", {{-1, "S"}, {3, ""}, {-1, "H/4"}, {-1, "W/4"}}}};
    Prediction prediction;
    const std::vector<Tensor> tensors = prediction.reset(shapes, {0, 0, 17, 5}, 2);
    ASSERT_EQ(tensors.size(), 2u);
    EXPECT_EQ(tensors[0].shape, (std::vector<int64_t>{1, 2, 5, 17}));
    EXPECT_EQ(tensors[1].shape, (std::vector<int64_t>{2, 3, 4, 8}));
    EXPECT_EQ(prediction.at("b") - prediction.at("a"), 2 * 5 * 17);
    EXPECT_EQ(tensors[1].data, prediction.at("b"));
    EXPECT_EQ(floats_per_pixel(shapes.at("a"), 2), 2);
    EXPECT_EQ(floats_per_pixel(shapes.at("b"), 2), 1); // 6 / 16, rounded up
}

} // namespace pathfold::core
