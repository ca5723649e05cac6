#pragma once

#include <map>
#include <string>
#include <vector>

#include "image.h"

namespace pathfold::core {

/// Radiance to be filtered with the beauty's kernels: "color", or "diffuse" and "specular".
struct Layer {
    std::string name;
    std::map<std::string, ImageView> parts;
    ImageView output;

    bool split() const { return parts.count("color") == 0; }
};

/// What the caller gave for one frame.
class Frame {
public:
    void set_input(const std::string &name, const pathfold_image *image);
    void set_output(const std::string &name, const pathfold_image *image);
    void set_layer(const std::string &layer, const std::string &part, const pathfold_image *image);
    void set_layer_output(const std::string &layer, const pathfold_image *image);
    void clear();

    /// Throws invalid-argument unless there is radiance, and the sizes of everything agree.
    void check() const;

    /// Throws invalid-argument unless all pixels are there, and each value of an output has bytes of its own.
    void check_data() const;

    bool has(const std::string &name) const { return inputs_.count(name) > 0; }
    const ImageView &input(const std::string &name) const { return inputs_.at(name); }
    const std::map<std::string, ImageView> &inputs() const { return inputs_; }
    const std::map<std::string, ImageView> &outputs() const { return outputs_; }
    const std::vector<Layer> &layers() const { return layers_; }

    int width() const { return inputs_.begin()->second.width(); }
    int height() const { return inputs_.begin()->second.height(); }
    int64_t samples() const; ///< per pixel, 0 where no samples were given

    std::vector<std::string> input_names() const;

private:
    void check_color() const;
    void check_sizes() const;
    void check_outputs() const;
    Layer &layer(const std::string &name);
    void drop_empty_layers();

    std::map<std::string, ImageView> inputs_, outputs_;
    std::vector<Layer> layers_;
};

} // namespace pathfold::core
