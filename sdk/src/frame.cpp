#include "frame.h"

#include <algorithm>
#include <set>
#include <utility>

#include "buffers.h"
#include "error.h"

namespace pathfold::core {
namespace {

const std::set<std::string> output_names = {"color", "diffuse", "specular", "alpha"};
const std::set<std::string> layer_parts = {"color", "diffuse", "specular"};

void expect_channels(const ImageView &view, int channels, const std::string &name) {
    if (view.channels() != channels)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": the image is ", view.size_text(), "; ", name, " has ",
             channels, channels == 1 ? " channel" : " channels");
}

} // namespace

void Frame::set_input(const std::string &name, const pathfold_image *image) {
    const BufferKind *kind = find_buffer(name);
    if (kind == nullptr)
        fail(PATHFOLD_INVALID_ARGUMENT, "there is no buffer named \"", name,
             "\"; buffers are: ", buffer_names());
    if (image == nullptr) {
        inputs_.erase(name);
        return;
    }
    const ImageView view(*image, name);
    if (name == "samples.descriptor" && pathfold_descriptor_vertices(view.channels()) == 0) {
        const int none = pathfold_descriptor_layout(0).channels, one = pathfold_descriptor_layout(1).channels;
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": the image is ", view.size_text(), "; ", name, " has ", none,
             " channels and ", one - none, " for each of 1 to ", PATHFOLD_MAX_VERTICES, " vertices, ",
             kind->channels, " in all");
    }
    if (name != "samples.descriptor")
        expect_channels(view, kind->channels, name);
    if (!kind->per_sample && view.samples() != 1)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ": samples is ", view.samples(), "; a pixel buffer has 1");
    inputs_[name] = view;
}

void Frame::set_output(const std::string &name, const pathfold_image *image) {
    if (output_names.count(name) == 0)
        fail(PATHFOLD_INVALID_ARGUMENT, "there is no output named \"", name,
             "\"; outputs are: ", list(output_names));
    if (image == nullptr) {
        outputs_.erase(name);
        return;
    }
    const ImageView view(*image, "output " + name);
    view.expect_data("output " + name);
    expect_channels(view, find_buffer(name)->channels, "output " + name);
    outputs_[name] = view;
}

Layer &Frame::layer(const std::string &name) {
    for (Layer &layer : layers_)
        if (layer.name == name)
            return layer;
    layers_.push_back({name, {}, {}});
    return layers_.back();
}

void Frame::set_layer(const std::string &name, const std::string &part, const pathfold_image *image) {
    if (name.empty() || output_names.count(name) > 0)
        fail(PATHFOLD_INVALID_ARGUMENT, "a layer cannot be named \"", name,
             "\"; that is empty or the name of an output");
    if (layer_parts.count(part) == 0)
        fail(PATHFOLD_INVALID_ARGUMENT, "the layer ", name, " has no part named \"", part,
             "\"; parts are: ", list(layer_parts));
    if (image == nullptr) {
        layer(name).parts.erase(part);
        return drop_empty_layers();
    }
    const ImageView view(*image, name + "." + part);
    if (view.samples() != 1)
        fail(PATHFOLD_INVALID_ARGUMENT, name, ".", part, ": samples is ", view.samples(), "; a layer has 1");
    layer(name).parts[part] = view;
}

void Frame::set_layer_output(const std::string &name, const pathfold_image *image) {
    const ImageView view = image != nullptr ? ImageView(*image, "output " + name) : ImageView();
    if (image != nullptr)
        view.expect_data("output " + name);
    layer(name).output = view;
    drop_empty_layers();
}

void Frame::drop_empty_layers() {
    const auto is_empty = [](const Layer &layer) { return layer.parts.empty() && layer.output.empty(); };
    layers_.erase(std::remove_if(layers_.begin(), layers_.end(), is_empty), layers_.end());
}

void Frame::clear() {
    inputs_.clear();
    outputs_.clear();
    layers_.clear();
}

int64_t Frame::samples() const {
    for (const auto &[name, view] : inputs_)
        if (find_buffer(name)->per_sample)
            return view.samples();
    return 0;
}

std::vector<std::string> Frame::input_names() const {
    std::vector<std::string> names;
    for (const auto &[name, view] : inputs_)
        names.push_back(name);
    return names;
}

void Frame::check() const {
    check_color();
    check_sizes();
}

void Frame::check_data() const {
    for (const auto &[name, view] : inputs_)
        view.expect_data(name);
    for (const Layer &layer : layers_)
        for (const auto &[part, view] : layer.parts)
            view.expect_data(layer.name + "." + part);
    check_outputs();
}

void Frame::check_outputs() const {
    std::vector<std::pair<std::string, const ImageView *>> all;
    for (const auto &[name, view] : outputs_)
        all.emplace_back(name, &view);
    for (const Layer &layer : layers_)
        if (!layer.output.empty())
            all.emplace_back(layer.name, &layer.output);
    for (size_t i = 0; i < all.size(); ++i) {
        if (all[i].second->overlaps_itself())
            fail(PATHFOLD_INVALID_ARGUMENT, "output ", all[i].first,
                 ": its strides lay several values over one another; give each memory of its own");
        for (size_t j = 0; j < i; ++j)
            if (all[i].second->overlaps(*all[j].second))
                fail(PATHFOLD_INVALID_ARGUMENT, "output ", all[i].first, " lies over output ", all[j].first,
                     "; give it memory of its own");
    }
}

void Frame::check_color() const {
    if (!has("color") && !(has("diffuse") && has("specular")))
        fail(PATHFOLD_INVALID_ARGUMENT,
             "the frame has no color (nor diffuse and specular, whose sum it is); "
             "given: ",
             list(input_names()));
}

void Frame::check_sizes() const {
    const std::string first = has("color") ? "color" : "diffuse";
    const ImageView &right = input(first);
    const auto expect = [&](const ImageView &view, const std::string &name) {
        if (view.width() != right.width() || view.height() != right.height())
            fail(PATHFOLD_INVALID_ARGUMENT, name, ": the image is ", view.size_text(), ", but ", first,
                 " is ", right.size_text(),
                 " (height x width x channels); all buffers must have the same size");
    };
    for (const auto &[name, view] : inputs_) {
        expect(view, name);
        if (find_buffer(name)->per_sample && view.samples() != samples())
            fail(PATHFOLD_INVALID_ARGUMENT, name, ": there are ", view.samples(), " samples per pixel, but ",
                 samples(), " in another buffer; all samples buffers must have as many");
    }
    for (const auto &[name, view] : outputs_)
        expect(view, "output " + name);
    for (const Layer &layer : layers_) {
        const bool whole = layer.parts.size() == 1 && !layer.split();
        const bool both = layer.parts.size() == 2 && layer.split();
        if (!whole && !both)
            fail(PATHFOLD_INVALID_ARGUMENT, "the layer ", layer.name,
                 " must be given as color, or as diffuse and specular");
        for (const auto &[part, view] : layer.parts) {
            expect(view, layer.name + "." + part);
            if (view.channels() != layer.parts.begin()->second.channels())
                fail(PATHFOLD_INVALID_ARGUMENT, "the layer ", layer.name,
                     ": diffuse and specular must have as many channels");
        }
        if (!layer.output.empty()) {
            expect(layer.output, "output " + layer.name);
            expect_channels(layer.output, layer.parts.begin()->second.channels(), "output " + layer.name);
        }
    }
}

} // namespace pathfold::core
