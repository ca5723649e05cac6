#include "denoiser.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>

#include "buffers.h"
#include "error.h"

namespace pathfold::core {
namespace {

constexpr int64_t mebibyte = int64_t(1) << 20;
constexpr int64_t default_logits_bytes = 256 * mebibyte;
constexpr int64_t default_input_bytes = 512 * mebibyte;
constexpr int64_t default_window_pixels = 640 * 1024;  // 544 x 960 and its overlap: bounds the network's part
constexpr int64_t pyramid_window_pixels = 1280 * 1024; // its network is lighter and its overlap larger
constexpr int64_t cleaner_floats = 14; // a pixel: the factor's pyramid, filtered and cleaned factor

/// Pixels that a tile's window may have.
int64_t window_pixels(const Settings &settings, const Manifest &manifest, int64_t input_floats) {
    int64_t logits_floats = 0;
    for (const auto &[name, shape] : manifest.outputs())
        logits_floats += floats_per_pixel(shape, 1);
    const int64_t logits_bytes = logits_floats * int64_t(sizeof(float));
    if (std::any_of(manifest.branches.begin(), manifest.branches.end(),
                    [](const Branch &b) { return b.clean; }))
        input_floats += cleaner_floats;
    const int64_t input_bytes = input_floats * int64_t(sizeof(float));
    if (settings.memory_mb == 0)
        return std::min({manifest.pyramid ? pyramid_window_pixels : default_window_pixels,
                         default_logits_bytes / logits_bytes, default_input_bytes / input_bytes});
    // A network's own working memory is about that of its inputs.
    return settings.memory_mb * mebibyte / (logits_bytes + 2 * input_bytes);
}

/// How many of what is predicted at half resolution belong to the finest level.
size_t finest_logits(const Rect &window) {
    return size_t(PyramidLogits::channels) * Pyramid::rounded_up(window.height) *
           Pyramid::rounded_up(window.width);
}

} // namespace

/// One frame on its way through the stages.
class Denoiser::Run {
public:
    Run(Denoiser &denoiser, const Frame &frame, const Reads &reads, const Settings &settings)
        : denoiser_(denoiser), frame_(frame), reads_(reads), settings_(settings), model_(*denoiser.model_),
          manifest_(model_.manifest()), threads_(denoiser.threads_),
          prepared_(prepare(frame, reads, settings.exposure, manifest_.exposure_key, threads_)),
          packer_(frame, reads, prepared_, model_, threads_, denoiser.tensors_),
          results_(prepared_.signals.size()), work_(reads.branches.size()), left_out_(reads.branches.size()) {
        if (reads.without_paths)
            report_.left_out.push_back(
                {"paths",
                 text("approximately: from ", manifest_.without_paths,
                      " samples per pixel on the model's RelL2 without them is at most 1.02 times that "
                      "with them, in the mean")});
        else if (leaves_out("paths") && frame.has("samples.descriptor") && manifest_.without_paths == 0)
            report_.notes.push_back("paths are not left out: the model's manifest does not say from how many "
                                    "samples per pixel on it does as well without");
        report_.times.prepare = watch_.lap();
    }

    std::string go() {
        plan();
        for (size_t i = 0; i < tiles_.size(); ++i)
            denoise(tiles_[i], i);
        tell_progress(1);
        finish_report();
        return report_.json(frame_, reads_, model_, prepared_);
    }

private:
    /// Tiles, and the pixels of their windows.
    struct Work {
        size_t tiles = 0;
        double pixels = 0;

        void add(const Tile &tile) { ++tiles, pixels += double(tile.window.width) * tile.window.height; }
    };

    void plan();
    bool leaves_out(const char *what) const { return settings_.leaves_out(what); }
    std::vector<std::string> find_needs(const Tile &tile) const;
    void denoise(const Tile &tile, size_t index);
    void embed();
    void filter(const Tile &tile, int branch);
    void predict(const Tile &tile, int branch);
    template <typename Row>
    void copy_row(int branch, int x, int y, int width, const Rect &window, const Row &row) const;
    void fill_pyramid(const Tile &tile, int branch, int planes);
    void clean_factor(const Tile &tile, int branch);
    void fill_neighbourhood(const Tile &tile, int branch, int planes);
    const float *output(const std::string &name) const {
        return denoiser_.logits_.data() + offsets_.at(name);
    }
    template <typename Fill>
    void set_results(const Tile &tile, int branch, const Fill &fill);
    void take_results(const Tile &tile, int branch);
    void copy_noisy(const Tile &tile, int branch);
    void write(const Tile &tile);
    void write(const Tile &tile, const ImageView &output, const std::vector<size_t> &signals);
    void tell_progress(float done);
    void report_branches();
    void report_tiles(const std::string &what, const std::string &why);
    void report_inputs();
    void finish_report();
    double saved_ms(double pixels) const;
    std::string tiles_text(size_t tiles) const;

    Denoiser &denoiser_;
    const Frame &frame_;
    const Reads &reads_;
    const Settings &settings_;
    const Model &model_;
    const Manifest &manifest_;
    Threads &threads_;
    Stopwatch watch_;
    Prepared prepared_;
    Packer packer_;
    std::vector<Tile> tiles_;
    std::vector<Planes> results_; // of the tile at hand, per signal
    std::vector<float> gathered_;
    Planes cleaned_; // of the window at hand, what a branch's radiance is divided and multiplied by; empty:
                     // what it was divided by
    float told_ = 0; // the progress
    bool embedded_ = false;                             // the frame's samples, where the model does so
    std::map<std::string, size_t> offsets_;             // of the network's outputs in logits_
    std::vector<char> idle_;                            // per branch: in the whole frame
    std::vector<Work> work_;                            // per branch: done
    std::vector<std::map<std::string, Work>> left_out_; // per branch: not done, by what it was left out for
    Report report_;
};

void Denoiser::Run::plan() {
    const int64_t pixels = window_pixels(settings_, manifest_, packer_.floats_per_pixel());
    if (settings_.tile % manifest_.tile_alignment != 0)
        fail(PATHFOLD_INVALID_ARGUMENT, "tile is ", settings_.tile, "; it must be a multiple of ",
             manifest_.tile_alignment, " for the model ", manifest_.name);
    tiles_ = plan_tiles(frame_.width(), frame_.height(), manifest_.tile_alignment, manifest_.tile_overlap,
                        pixels, settings_.tile);
    if (tiles_.empty())
        fail(PATHFOLD_INVALID_ARGUMENT, "memory_mb is ", settings_.memory_mb,
             ", too little for the smallest tile with its overlap of ", manifest_.tile_overlap,
             " pixels; give more, or 0 to have it chosen");
    watch_.lap();
    const Rect whole{0, 0, frame_.width(), frame_.height()};
    for (size_t i = 0; i < work_.size(); ++i)
        idle_.push_back(leaves_out("branches") && is_idle(prepared_, int(i), {whole, whole}, 0));
    report_.times.needs += watch_.lap();
    report_.tiles = tiles_.size();
    report_.tile_width = tiles_[0].core.width;
    report_.tile_height = tiles_[0].core.height;
}

/// For each branch what it is left out of the tile for; empty where it has to run.
std::vector<std::string> Denoiser::Run::find_needs(const Tile &tile) const {
    const size_t branches = work_.size();
    std::vector<std::string> causes(branches);
    std::vector<char> idle(branches);
    bool all_idle = true;
    for (size_t i = 0; i < branches; ++i) {
        idle[i] = idle_[i] || ((leaves_out("branches") || leaves_out("tiles")) &&
                               is_idle(prepared_, int(i), tile, manifest_.reach()));
        all_idle = all_idle && idle[i];
    }
    for (size_t i = 0; i < branches; ++i)
        if (idle_[i] && leaves_out("branches"))
            causes[i] = "branches";
        else if (all_idle && leaves_out("tiles"))
            causes[i] = "tiles";
        else if (idle[i] && leaves_out("branches"))
            causes[i] = "branches";
    if (leaves_out("converged") && std::count(causes.begin(), causes.end(), "") > 0 &&
        is_converged(frame_, reads_, prepared_, tile.core))
        std::replace(causes.begin(), causes.end(), std::string(), std::string("converged"));
    return causes;
}

void Denoiser::Run::denoise(const Tile &tile, size_t index) {
    bool packed = false;
    const size_t branches = work_.size();
    watch_.lap();
    const std::vector<std::string> causes = find_needs(tile);
    report_.times.needs += watch_.lap();
    for (size_t branch = 0; branch < branches; ++branch) {
        tell_progress(float(index * branches + branch) / float(tiles_.size() * branches));
        watch_.lap();
        if (!causes[branch].empty()) {
            copy_noisy(tile, int(branch));
            left_out_[branch][causes[branch]].add(tile);
            report_.times.write += watch_.lap();
            continue;
        }
        if (!packed) {
            if (!embedded_ && manifest_.embedding_channels > 0)
                embed();
            packer_.start(tile, denoiser_.embedding_);
        }
        packed = true;
        filter(tile, int(branch));
        work_[branch].add(tile);
    }
    watch_.lap();
    write(tile);
    report_.times.write += watch_.lap();
}

/// Brings the frame's first samples, as many as the model wants, through its embedding, in parts that stay in
/// the caches.
void Denoiser::Run::embed() {
    constexpr int64_t part = 16 * 1024; // samples, for each thread
    Embedding &embedding = denoiser_.embedding_;
    const int width = frame_.width(), height = frame_.height();
    embedding.reset(manifest_.embedding_channels, height, width);
    embedded_ = true;
    if (!reads_.has("samples.descriptor"))
        return;
    const Session &session = model_.session("embedding");
    const int64_t spp = std::min(reads_.samples, manifest_.embedded_samples),
                  most = part * std::min(model_.threads(), 16);
    const int step = Embedding::alignment;
    const int rows = int(std::max<int64_t>(1, most / (width * spp * step))) * step;
    const int64_t count = std::clamp<int64_t>(most / (int64_t(width) * rows), 1, spp);
    for (int y = 0; y < height; y += rows) {
        const Rect strip{0, y, width, std::min(rows, height - y)};
        const std::vector<int64_t> shape{1, manifest_.embedding_channels, Embedding::cells(strip.height),
                                         Embedding::cells(width)};
        std::vector<float> sums(size_t(shape[1] * shape[2] * shape[3]));
        tell_progress(told_); // it may cancel; tiles that need no network came before
        for (int64_t first = 0; first < spp; first += count) {
            session.run(packer_.samples(strip, first, std::min(count, spp - first)),
                        {{"embedding", shape, sums.data()}});
            embedding.add(strip, sums.data());
        }
    }
    report_.times.embedding += watch_.lap();
}

void Denoiser::Run::filter(const Tile &tile, int branch) {
    predict(tile, branch);
    int planes = 0;
    for (const Signal &signal : prepared_.signals)
        planes += signal.branch == branch ? signal.values.channels() : 0;
    gathered_.resize(std::max(gathered_.size(), size_t(planes) * tile.core.width * tile.core.height));
    if (manifest_.pyramid) {
        clean_factor(tile, branch);
        fill_pyramid(tile, branch, planes);
        const PyramidLogits logits{output("trust"),
                                   {output("logits.2"), output("logits.2") + finest_logits(tile.window),
                                    output("logits.4"), output("logits.8"), output("logits.16")}};
        const Rect core{tile.core.x - tile.window.x, tile.core.y - tile.window.y, tile.core.width,
                        tile.core.height};
        denoiser_.pyramid_.apply(threads_, logits, core, gathered_.data());
    } else {
        fill_neighbourhood(tile, branch, planes);
        const size_t width = size_t(tile.window.width), plane = width * tile.window.height;
        const size_t corner = size_t(tile.core.y - tile.window.y) * width + (tile.core.x - tile.window.x);
        gather(threads_, {output("logits") + corner, plane, width}, denoiser_.neighbourhood_,
               gathered_.data());
    }
    take_results(tile, branch);
    report_.times.reconstruct += watch_.lap();
}

void Denoiser::Run::predict(const Tile &tile, int branch) {
    const std::vector<Tensor> inputs = packer_.inputs(branch);
    const Branch &active = *reads_.branches[size_t(branch)].branch;
    std::vector<Tensor> outputs;
    size_t total = 0;
    for (const auto &[name, shape] : model_.graph(active.graph).outputs) {
        Tensor tensor{name, sizes_of(shape, tile.window, 1), nullptr};
        size_t count = 1;
        for (int64_t size : tensor.shape)
            count *= size_t(size);
        offsets_[name] = total;
        outputs.push_back(std::move(tensor));
        total += count;
    }
    std::vector<float> &logits = denoiser_.logits_;
    logits.resize(std::max(logits.size(), total + std::max(gather_slack, pyramid_slack)));
    for (Tensor &tensor : outputs)
        tensor.data = logits.data() + offsets_.at(tensor.name);
    report_.times.pack += watch_.lap();
    model_.session(active.graph).run(inputs, outputs);
    report_.times.network += watch_.lap();
}

/// What a row of the branch's signals holds while it is filtered: `row(plane)` says where it goes.
template <typename Row>
void Denoiser::Run::copy_row(int branch, int x, int y, int width, const Rect &window, const Row &row) const {
    const bool clean = cleaned_.channels() > 0;
    const Planes &factor = clean ? cleaned_ : prepared_.factors[size_t(branch)];
    const int from_x = clean ? x - window.x : x, from_y = clean ? y - window.y : y;
    int plane = 0;
    for (const Signal &signal : prepared_.signals) {
        if (signal.branch != branch)
            continue;
        for (int c = 0; c < signal.values.channels(); ++c, ++plane) {
            const float *values = signal.values.row(c, y) + x;
            if (signal.demodulated)
                std::transform(values, values + width,
                               factor.row(std::min(c, factor.channels() - 1), from_y) + from_x, row(plane),
                               std::divides<float>());
            else
                std::copy_n(values, width, row(plane));
        }
    }
}

void Denoiser::Run::fill_pyramid(const Tile &tile, int branch, int planes) {
    Pyramid &source = denoiser_.pyramid_;
    const Rect &window = tile.window;
    source.reset(planes, window.height, window.width);
    for_rows(threads_, window.height, [&](int row) {
        const int y = window.y + row;
        copy_row(branch, window.x, y, window.width, window,
                 [&](int plane) { return source.row(plane, row); });
        std::copy_n(prepared_.valid.data() + size_t(y) * frame_.width() + window.x, window.width,
                    source.valid_row(row));
    });
}

/// The branch's factor for the window, filtered by the pyramid `cleaning`, which has no trust.
void Denoiser::Run::clean_factor(const Tile &tile, int branch) {
    const Planes &factor = prepared_.factors[size_t(branch)];
    const int planes = factor.channels(), width = tile.window.width, height = tile.window.height;
    cleaned_ = Planes();
    if (!reads_.branches[size_t(branch)].branch->clean || planes == 0)
        return;
    Pyramid &source = denoiser_.cleaner_;
    const Rect &window = tile.window;
    source.reset(planes, window.height, window.width, Pyramid::factor_levels);
    for_rows(threads_, window.height, [&](int row) {
        const uint8_t *valid = prepared_.valid.data() + size_t(window.y + row) * frame_.width() + window.x;
        std::copy_n(valid, window.width, source.valid_row(row));
        for (int c = 0; c < planes; ++c)
            std::transform(valid, valid + window.width, factor.row(c, window.y + row) + window.x,
                           source.row(c, row),
                           [](uint8_t is_valid, float value) { return is_valid != 0 ? value : 0; });
    });
    const size_t plane = size_t(width) * height;
    std::vector<float> filtered(plane * size_t(planes)), known(plane);
    const float *half = output("cleaning.2");
    const PyramidLogits logits{nullptr, {half, half + finest_logits(window), output("cleaning.4")}};
    source.apply(threads_, logits, {0, 0, width, height}, filtered.data(), known.data());
    cleaned_ = Planes(planes, height, width);
    for_rows(threads_, height, [&](int y) {
        const size_t row = size_t(y) * width;
        for (int c = 0; c < planes; ++c) {
            const float *noisy = factor.row(c, window.y + y) + window.x;
            const float *clean = filtered.data() + plane * size_t(c) + row;
            float *to = cleaned_.row(c, y);
            for (int x = 0; x < width; ++x)
                to[x] = known[row + x] > 0 ? clean[x] : noisy[x];
        }
    });
}

void Denoiser::Run::fill_neighbourhood(const Tile &tile, int branch, int planes) {
    Neighbourhood &source = denoiser_.neighbourhood_;
    const int radius = manifest_.kernel_size / 2;
    const Rect area = grown(tile.core, radius, frame_.width(), frame_.height());
    source.reset(planes, tile.core.height, tile.core.width, radius, manifest_.trust);
    const size_t window_width = size_t(tile.window.width);
    const float *trust =
        output("logits") + (manifest_.logit_channels() - 1) * window_width * tile.window.height;
    for_rows(threads_, area.height, [&](int row) {
        const int y = area.y + row, to_y = y - tile.core.y, to_x = area.x - tile.core.x + radius;
        copy_row(branch, area.x, y, area.width, tile.window,
                 [&](int plane) { return source.row(plane, to_y) + to_x; });
        const uint8_t *valid = prepared_.valid.data() + size_t(y) * frame_.width() + area.x;
        const float *shifts = trust + size_t(y - tile.window.y) * window_width + (area.x - tile.window.x);
        for (int x = 0; x < area.width; ++x)
            if (valid[x] != 0)
                source.shift_row(to_y)[to_x + x] = manifest_.trust ? shifts[x] : 0;
    });
    source.finish();
}

/// Calls fill(signal, channel, row of the tile, where its result goes) for what the branch filters.
template <typename Fill>
void Denoiser::Run::set_results(const Tile &tile, int branch, const Fill &fill) {
    for (size_t i = 0; i < prepared_.signals.size(); ++i) {
        const Signal &signal = prepared_.signals[i];
        if (signal.branch != branch)
            continue;
        results_[i] = Planes(signal.values.channels(), tile.core.height, tile.core.width);
        for (int c = 0; c < signal.values.channels(); ++c)
            for (int y = 0; y < tile.core.height; ++y)
                fill(signal, c, y, results_[i].row(c, y));
    }
}

void Denoiser::Run::take_results(const Tile &tile, int branch) {
    const bool clean = cleaned_.channels() > 0;
    const Planes &factor = clean ? cleaned_ : prepared_.factors[size_t(branch)];
    const float *from = gathered_.data();
    set_results(tile, branch, [&](const Signal &signal, int c, int y, float *to) {
        std::copy_n(from, tile.core.width, to);
        from += tile.core.width;
        if (!signal.demodulated)
            return;
        const int plane = std::min(c, factor.channels() - 1);
        const float *row =
            clean ? factor.row(plane, tile.core.y - tile.window.y + y) + (tile.core.x - tile.window.x)
                  : factor.row(plane, tile.core.y + y) + tile.core.x;
        std::transform(to, to + tile.core.width, row, to, std::multiplies<float>());
    });
}

void Denoiser::Run::copy_noisy(const Tile &tile, int branch) {
    set_results(tile, branch, [&](const Signal &signal, int c, int y, float *to) {
        std::copy_n(signal.values.row(c, tile.core.y + y) + tile.core.x, tile.core.width, to);
    });
}

void Denoiser::Run::write(const Tile &tile) {
    const auto signals_of = [&](const std::string &name) {
        std::vector<size_t> found;
        for (size_t i = 0; i < prepared_.signals.size(); ++i)
            if (prepared_.signals[i].name == name)
                found.push_back(i);
        return found;
    };
    for (const auto &[name, view] : frame_.outputs()) {
        std::vector<size_t> signals = signals_of(name);
        if (name == "color") {
            signals.clear();
            for (size_t i = 0; i < reads_.branches.size(); ++i)
                signals.push_back(i);
        }
        write(tile, view, signals);
    }
    for (const Layer &layer : frame_.layers())
        if (!layer.output.empty())
            write(tile, layer.output, signals_of(layer.name));
}

/// Writes the sum of some signals; where the network's kernels are not finite, the noisy pixel stays.
void Denoiser::Run::write(const Tile &tile, const ImageView &output, const std::vector<size_t> &signals) {
    std::atomic<int64_t> repaired{0};
    const bool keeps_sign = prepared_.signals[signals[0]].keeps_sign;
    for_rows(threads_, tile.core.height, [&](int y) {
        const int channels = output.channels(), width = tile.core.width;
        std::vector<float> pixels(size_t(width) * channels);
        for (int c = 0; c < channels; ++c)
            for (int x = 0; x < width; ++x) {
                float value = 0, noisy = 0;
                for (size_t i : signals) {
                    value += results_[i].row(c, y)[x];
                    noisy += prepared_.signals[i].values.row(c, tile.core.y + y)[tile.core.x + x];
                }
                if (!std::isfinite(value))
                    value = noisy, ++repaired;
                pixels[size_t(x) * channels + c] = keeps_sign ? value : std::max(value, 0.0f);
            }
        output.store_row(tile.core.y + y, tile.core.x, width, pixels.data());
    });
    report_.counts.repaired += repaired;
}

void Denoiser::Run::tell_progress(float done) {
    told_ = done;
    if (settings_.progress && !settings_.progress(done))
        fail(PATHFOLD_CANCELLED, "cancelled by the progress callback");
}

/// What the work on so many pixels of windows would have taken, by what it took in this run; -1: not known.
double Denoiser::Run::saved_ms(double pixels) const {
    double done = 0;
    for (const Work &work : work_)
        done += work.pixels;
    const Times &times = report_.times;
    return done > 0 ? pixels * (times.pack + times.network + times.reconstruct) / done : -1;
}

std::string Denoiser::Run::tiles_text(size_t tiles) const {
    return tiles == tiles_.size() ? "all tiles" : text(tiles, " of ", tiles_.size(), " tiles");
}

void Denoiser::Run::report_branches() {
    for (size_t i = 0; i < work_.size(); ++i) {
        const ActiveBranch &active = reads_.branches[i];
        const Work &idle = left_out_[i]["branches"];
        if (work_[i].tiles > 0)
            report_.branches.push_back(active.branch->name);
        if (idle.tiles == 0)
            continue;
        const std::string where = idle.tiles == tiles_.size() ? "" : " in " + tiles_text(idle.tiles);
        report_.left_out.push_back({"branch " + active.branch->name + where,
                                    active.radiance + " is constant there: filtering changes nothing",
                                    saved_ms(idle.pixels)});
    }
}

void Denoiser::Run::report_tiles(const std::string &cause, const std::string &why) {
    size_t tiles = 0;
    double pixels = 0;
    for (auto &branch : left_out_) {
        tiles = std::max(tiles, branch[cause].tiles);
        pixels += branch[cause].pixels;
    }
    if (tiles > 0)
        report_.left_out.push_back({tiles_text(tiles), why, saved_ms(pixels)});
}

void Denoiser::Run::report_inputs() {
    const double value_ms = prepared_.load_ms / prepared_.loaded;
    const auto saved = [&](const ImageView &view, int channels) {
        return value_ms * double(view.samples()) * channels * frame_.width() * frame_.height();
    };
    if (!reads_.has("samples.descriptor"))
        return;
    const ImageView &view = frame_.input("samples.descriptor");
    if (const int64_t most = manifest_.embedded_samples; most < view.samples())
        report_.notes.push_back(
            text("of ", view.samples(), " samples' paths the model looks at the first ", most));
    if (const int vertices = vertices_of(view.channels()); vertices < descriptor_vertices)
        report_.left_out.push_back({text("path vertices from ", vertices + 1, " on"),
                                    "no path of the frame has them: they are not given",
                                    saved(view, 5 * (descriptor_vertices - vertices))});
}

void Denoiser::Run::finish_report() {
    report_branches();
    report_tiles("tiles", "everything in them is constant: filtering changes nothing");
    report_tiles("converged",
                 text("approximately: their expected RelL2 is at most ", converged_error, " already"));
    report_inputs();
    const int64_t samples = reads_.samples_behind;
    if (samples > 0 && (samples < manifest_.min_samples || samples > manifest_.max_samples))
        report_.notes.push_back(text(samples, " samples per pixel; the model was trained on ",
                                     manifest_.min_samples, " to ", manifest_.max_samples));
    report_.counts += prepared_.counts;
    report_.counts += packer_.counts();
}

Denoiser::Denoiser(std::shared_ptr<const Model> model)
    : model_(std::move(model)), threads_(model_->threads()) {}

std::string Denoiser::run(const Frame &frame, const Settings &settings) {
    frame.check();
    const Reads reads = decide_reads(frame, model_->manifest(), settings);
    check_reads(frame, model_->manifest(), reads);
    return Run(*this, frame, reads, settings).go();
}

} // namespace pathfold::core
