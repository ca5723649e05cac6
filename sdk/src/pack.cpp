#include "pack.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>

#include <oneapi/tbb/combinable.h>

#include "buffers.h"
#include "descriptor.h"

namespace pathfold::core {
namespace {

bool is_scalar(const std::string &input) { return input_shape(input).size() == 1; }

/// On the bits, so that it runs as vectors.
bool all_finite(const float *values, int count) {
    constexpr uint32_t exponent = 0x7f800000;
    uint32_t bad = 0;
    for (int i = 0; i < count; ++i) {
        uint32_t bits;
        std::memcpy(&bits, values + i, sizeof bits);
        bad |= uint32_t((bits & exponent) == exponent);
    }
    return bad == 0;
}

bool is_samples(const std::string &input) { return input.rfind("samples.", 0) == 0; }

} // namespace

Packer::Packer(const Frame &frame, const Reads &reads, const Guides &guides, const Prepared &prepared,
               const Model &model, Threads &threads, TensorMemory &memory)
    : frame_(frame), reads_(reads), guides_(guides), prepared_(prepared), model_(model), threads_(threads),
      samples_(std::max<int64_t>(1, reads.samples)), memory_(memory) {
    for (const ActiveBranch &active : reads.branches)
        for (const auto &[name, shape] : model.graph(active.branch->graph).inputs)
            names_.insert(name);
    if (model.manifest().embedding_channels > 0)
        for (const auto &[name, shape] : model.graph("embedding").inputs)
            embedded_.insert(name);
}

int Packer::channels_of(const std::string &input) const {
    return int(input == "embedding" ? model_.manifest().embedding_channels : input_shape(input)[1].size);
}

bool Packer::in_core(int x, int y) const {
    const Rect &core = tile_.core;
    return x >= core.x && x < core.x + core.width && y >= core.y && y < core.y + core.height;
}

Tensor Packer::tensor(const std::string &name, std::vector<int64_t> shape) {
    size_t size = 1;
    for (int64_t edge : shape)
        size *= size_t(edge);
    std::vector<float> &memory = memory_[name];
    memory.resize(std::max(size, memory.size()));
    return {name, std::move(shape), memory.data()};
}

std::vector<Tensor> Packer::samples(const Rect &area, int64_t first, int64_t count) {
    tile_ = {area, area};
    std::vector<Tensor> tensors;
    for (const std::string &name : embedded_) {
        if (is_scalar(name)) {
            tensors.push_back(tensor(name, {1}));
            *tensors.back().data = scalar(name, 0);
        } else {
            tensors.push_back(tensor(name, {count, channels_of(name), area.height, area.width}));
        }
    }
    pack_samples(embedded_, first, count);
    return tensors;
}

void Packer::start(const Tile &tile, const Embedding &embedding) {
    tile_ = tile;
    bool samples = false;
    for (const std::string &name : names_) {
        const Tensor packed = tensor(name, shape_of(name));
        samples = samples || is_samples(name);
        if (name == "embedding")
            embedding.copy(tile.window, packed.data);
        if (find_guide(name) != nullptr)
            pack_guide(name, name);
    }
    if (samples)
        pack_samples(names_, 0, samples_);
}

/// Of a network's input for the tile at hand.
std::vector<int64_t> Packer::shape_of(const std::string &input) const {
    if (is_scalar(input))
        return {1};
    const int64_t height = tile_.window.height, width = tile_.window.width;
    if (input == "embedding")
        return {1, channels_of(input), Embedding::cells(tile_.window.height),
                Embedding::cells(tile_.window.width)};
    return {is_samples(input) ? samples_ : 1, channels_of(input), height, width};
}

std::vector<Tensor> Packer::inputs(int branch) {
    const ActiveBranch &active = reads_.branches[size_t(branch)];
    std::vector<Tensor> tensors;
    for (const auto &[name, shape] : model_.graph(active.branch->graph).inputs) {
        if (name == "radiance")
            pack_radiance(branch);
        if (name == "variance")
            pack_guide(name, active.variance);
        tensors.push_back(tensor(name, shape_of(name)));
        if (is_scalar(name))
            *tensors.back().data = scalar(name, branch);
    }
    return tensors;
}

float Packer::scalar(const std::string &input, int branch) const {
    const std::string buffer = input.substr(0, input.find(".present"));
    if (input == "exposure")
        return prepared_.exposure;
    if (input == "depth_scale")
        return prepared_.depth_scale;
    if (buffer == "split")
        return reads_.split ? 1.0f : 0.0f;
    if (buffer == "paths")
        return reads_.has("samples.descriptor") ? 1.0f : 0.0f;
    if (buffer == "variance") // a single sample tells nothing of it
        return reads_.has(reads_.branches[size_t(branch)].variance) && reads_.samples_behind != 1 ? 1.0f
                                                                                                  : 0.0f;
    return reads_.has(buffer) ? 1.0f : 0.0f;
}

/// Networks take logarithms of radiance: they are shown what is not negative.
void Packer::pack_radiance(int branch) {
    const Planes &values = prepared_.signals[size_t(branch)].values;
    const Rect &window = tile_.window;
    const float most = brightest_shown(prepared_.exposure);
    float *out = memory_["radiance"].data();
    for (int c = 0; c < values.channels(); ++c)
        for (int y = 0; y < window.height; ++y, out += window.width) {
            const float *row = values.row(c, window.y + y) + window.x;
            std::transform(row, row + window.width, out,
                           [=](float value) { return std::min(std::max(value, 0.0f), most); });
        }
}

/// A buffer that the frame lacks is fed as zeros.
void Packer::pack_guide(const std::string &input, const std::string &buffer) {
    const Rect &window = tile_.window;
    const int channels = channels_of(input);
    const size_t plane = size_t(window.width) * window.height;
    float *out = memory_[input].data();
    if (!reads_.has(buffer)) {
        std::fill_n(out, size_t(channels) * plane, 0.0f);
        return;
    }
    for_rows(threads_, window.height, [&](int y) {
        std::vector<float> pixels(size_t(window.width) * channels);
        guides_.load_row(buffer, window.y + y, window.x, window.width, pixels.data());
        for (int c = 0; c < channels; ++c)
            for (int x = 0; x < window.width; ++x)
                out[size_t(c) * plane + size_t(y) * window.width + x] = pixels[size_t(x) * channels + c];
    });
}

void Packer::pack_samples(const Names &names, int64_t first, int64_t count) {
    std::atomic<int64_t> dropped{0};
    oneapi::tbb::combinable<std::vector<float>> scratch;
    for_rows(threads_, int(count) * tile_.window.height, [&](int row) {
        const int64_t slot = row / tile_.window.height;
        dropped += pack_sample_row(names, first + slot, slot, row % tile_.window.height, scratch.local());
    });
    dropped_ += dropped;
}

/// One row of a sample, to its place `slot` in the tensors. Returns how many of its pixels were dropped.
int64_t Packer::pack_sample_row(const Names &names, int64_t sample, int64_t slot, int row,
                                std::vector<float> &scratch) {
    const Rect &window = tile_.window;
    const size_t plane = size_t(window.width) * window.height;
    const auto read = [&](const char *name, int channels, float absent, float *out) {
        if (reads_.has(name))
            frame_.input(name).load_row(sample, window.y + row, window.x, window.width, out);
        else
            std::fill_n(out, size_t(window.width) * channels, absent);
    };
    const int channels = find_buffer("samples.descriptor")->channels;
    scratch.resize(size_t(window.width) * (channels + 2));
    float *descriptor = scratch.data(), *density = descriptor + size_t(window.width) * channels;
    float *valid = density + window.width;
    read("samples.descriptor", channels, 0.0f, descriptor);
    if (reads_.has("samples.descriptor"))
        add_vertices(descriptor, window.width,
                     pathfold_descriptor_vertices(frame_.input("samples.descriptor").channels()));
    read("samples.density", 1, 0.0f, density);
    // Without any samples there is one that says nothing.
    read("samples.valid", 1, reads_.samples > 0 ? 1.0f : 0.0f, valid);

    int64_t dropped = 0;
    for (int x = 0; x < window.width; ++x) {
        float *values = descriptor + size_t(x) * channels;
        const bool finite =
            std::isfinite(density[x]) && std::isfinite(valid[x]) && all_finite(values, channels);
        valid[x] = finite && valid[x] > 0.5f ? 1.0f : 0.0f;
        if (valid[x] == 0) {
            clear_descriptor(values);
            density[x] = 0;
        }
        dropped += !finite && in_core(window.x + x, window.y + row);
    }
    const auto write = [&](const char *name, int count, const float *in) {
        if (names.count(name) == 0)
            return;
        float *out = memory_[name].data() + size_t(slot) * count * plane + size_t(row) * window.width;
        constexpr int block = 16; // pixels that stay in the first cache while their channels are spread
        for (int begin = 0; begin < window.width; begin += block)
            for (int c = 0; c < count; ++c)
                for (int x = begin; x < std::min(begin + block, window.width); ++x)
                    out[size_t(c) * plane + x] = in[size_t(x) * count + c];
    };
    write("samples.descriptor", channels, descriptor);
    write("samples.density", 1, density);
    write("samples.valid", 1, valid);
    return dropped;
}

} // namespace pathfold::core
